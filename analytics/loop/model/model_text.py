"""An error model as text: ``rate = bias + scale_factor*input_rate + warm_up(time_constant=1800)``."""

import ast
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from typing import Any, NamedTuple

from analytics.loop.effects.base import EffectKind
from analytics.loop.effects.monomial import PREFIX
from analytics.loop.effects.registry import effect, effects
from stream.channel_names import STANDARD_CHANNELS
from stream.errors import BadInput
from stream.mistakes import similar_names

BIAS = "bias"

_WRITTEN = {"scale_factor": "scale_factor*input_rate"}
_LONGEST = 10_000
_TERM = re.compile(r"(?P<name>[^()=]+?)\s*(?:\((?P<shape>.*)\))?", re.DOTALL)
_EXAMPLE = "write it like 'rate = bias + scale_factor*input_rate + warm_up(time_constant=1800)'"


class ParsedTerm(NamedTuple):
    """A term as it was written."""

    name: str
    shape: Mapping[str, Any]


def parse_model(text: str, channels: Collection[str] = ()) -> tuple[str | None, tuple[ParsedTerm, ...]]:
    """Signal and terms of a model's text; BadInput if it cannot be read, or a term is neither an effect nor a channel.

    >>> parse_model("bias + warm_up(time_constant=1800)")
    (None, (ParsedTerm(name='bias', shape={}), ParsedTerm(name='warm_up', shape={'time_constant': 1800})))
    >>> parse_model("rate = bias + temprature")
    Traceback (most recent call last):
    ...
    stream.errors.BadInput: error model: term 'temprature' is not known; did you mean temperature...
    """
    if len(text) > _LONGEST:
        raise BadInput(f"error model of {len(text):,} characters, {text[:60]!r}...: write at most {_LONGEST:,}")
    signal, equals, right = _split_signal(text)
    if equals and not signal:
        raise BadInput(f"error model {text!r}: no signal stands before '='; {_EXAMPLE}")
    terms = tuple(_parse_term(each, text, channels) for each in _split_terms(right))
    written = Counter(map(term_text, terms))
    if twice := sorted(term for term, times in written.items() if times > 1):
        raise BadInput(f"error model {text!r}: {', '.join(twice)} occurs twice; name each term once")
    return signal or None, terms


def term_text(term: ParsedTerm) -> str:
    """A term as text.

    >>> term_text(ParsedTerm("function_of_temperature", {"knots": [-20.0, 0.0, 40.5]}))
    'function_of_temperature(knots=[-20, 0, 40.5])'
    """
    name = _WRITTEN.get(term.name, term.name)
    if not term.shape:
        return name
    return f"{name}({', '.join(f'{key}={_value_text(value)}' for key, value in term.shape.items())})"


def _value_text(value: object) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value_text, value))}]"
    return f"{value:.15g}" if isinstance(value, float) else repr(value)


def _split_signal(text: str) -> tuple[str, str, str]:
    """Text before the first ``=`` outside parentheses, the sign, and the text after it."""
    depth = 0
    for at, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if letter == "=" and depth == 0:
            return text[:at].strip(), "=", text[at + 1 :]
    return "", "", text


def _split_terms(text: str) -> Iterator[str]:
    """Terms between the ``+`` signs outside parentheses."""
    depth, start = 0, 0
    for at, letter in enumerate(text):
        depth += (letter in "([") - (letter in ")]")
        if letter == "+" and depth == 0:
            yield text[start:at].strip()
            start = at + 1
    yield text[start:].strip()


def _parse_term(written: str, text: str, channels: Collection[str]) -> ParsedTerm:
    found = _TERM.fullmatch(written)
    if found is None:
        what = f"{written!r} is not a term" if written else "a term is missing beside a '+'"
        raise BadInput(f"error model {text!r}: {what}; {_EXAMPLE}")
    spaced = re.sub(r"\s*\*\s*", "*", found["name"].strip())
    name = next((own for own, form in _WRITTEN.items() if spaced == form), spaced)
    return _checked(_resolved(name, channels), _shape(found["shape"], written, text))


def _resolved(name: str, channels: Collection[str]) -> str:
    """Name of the effect of a term."""
    if name == BIAS or name in effects():
        return name
    bare = name.removeprefix(PREFIX)
    if bare in channels or bare in STANDARD_CHANNELS or name.startswith(PREFIX):
        return PREFIX + bare
    if re.fullmatch(r"scale_factor\*\w+", name):
        raise BadInput(
            f"error model: term {name!r} is not known; the scale factor is written {_WRITTEN['scale_factor']}, which "
            "follows from table_rate and the position of the unit where only these were recorded"
        )
    known = list(dict.fromkeys([BIAS, *(each for each in effects() if "*" not in each), *sorted(channels)]))
    near = similar_names(name, known, most=3)
    hint = f"did you mean {', '.join(near)}? A" if near else "a"
    raise BadInput(
        f"error model: term {name!r} is not known; {hint} term is {BIAS}, an effect or a channel: {', '.join(known)}"
    )


def _shape(written: str | None, term: str, text: str) -> dict[str, Any]:
    """Values of the shape parameters: ``time_constant=1800, knots=[0, 10]``."""
    if not written or not written.strip():
        return {}
    try:
        call = ast.parse(f"f({written})", mode="eval").body
        if not isinstance(call, ast.Call) or call.args or any(each.arg is None for each in call.keywords):
            raise ValueError
        return {str(each.arg): ast.literal_eval(each.value) for each in call.keywords}
    except (ValueError, SyntaxError) as error:
        raise BadInput(
            f"error model {text!r}: the parameters of {term!r} cannot be read; write them like (time_constant=1800)"
        ) from error


def _checked(name: str, shape: dict[str, Any]) -> ParsedTerm:
    """The term, if it has all shape parameters of the effect, or none."""
    if name == BIAS:
        expected, is_free = [], False
    else:
        expected = [parameter.name for parameter in effect(name).parameters]
        is_free = effect(name).kind is EffectKind.FUNCTION
    unknown = sorted(set(shape) - set(expected))
    if unknown and not is_free:
        has = f"it has {', '.join(expected)}" if expected else "it has none"
        raise BadInput(f"error model: {name} has no parameter {', '.join(unknown)}; {has}")
    if shape and (missing := [each for each in expected if each not in shape]):
        example = ", ".join(f"{each}=..." for each in expected)
        raise BadInput(f"error model: {name} needs {', '.join(missing)} as well; write {name}({example})")
    return ParsedTerm(name, shape)
