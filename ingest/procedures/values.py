"""Values in a procedure: numbers, sums and products of parameters, and texts with parameters in braces."""

import math
import re
from collections.abc import Mapping
from typing import TypeAlias

from ingest.procedures.file import near_name
from stream.errors import BadInput

Scalar: TypeAlias = float | int | str
Variables: TypeAlias = Mapping[str, Scalar | tuple[Scalar, ...]]

_TERM = re.compile(
    r"\s*(?P<sign>-?)\s*(?:\$(?P<name>[a-z][a-z0-9_]*)|(?P<number>[0-9]+(?:\.[0-9]*)?(?:[eE][+-]?[0-9]+)?))"
)
_OPERATOR = re.compile(r"\s*([-+*/])")
_PLACE = re.compile(r"\{([^{}]*)\}")
_EXPECTED = "expected is a number, $name, or sums and products of them"
_NAME = re.compile(r"\$([a-z][a-z0-9_]*)")


def number_of(value: Scalar | bool, variables: Variables, where: str) -> float:
    """The number that a value stands for: itself, or sums and products of numbers and `$name`.

    Products go before sums; there are no brackets and functions. `where` is file and key, for messages.

    >>> number_of("$base + 0.5 * $step", {"base": 10.0, "step": 4.0}, "x.toml: $.step[0].rate_deg_per_s")
    12.0
    """
    if isinstance(value, bool):
        raise BadInput(f"{where}: a number is expected, not {str(value).lower()}")
    if isinstance(value, int | float):
        return _finite(float(value), str(value), where)
    total, product, position, operator = 0.0, 0.0, 0, "+"
    while True:
        factor, position = _factor(value, position, variables, where)
        if operator == "*":
            product *= factor
        elif operator == "/":
            if factor == 0.0:
                raise BadInput(f"{where}: {value!r} divides by zero")
            product /= factor
        else:
            total, product = total + product, factor if operator == "+" else -factor
        if (found := _OPERATOR.match(value, position)) is None:
            break
        operator, position = found[1], found.end()
    if value[position:].strip():
        raise BadInput(f"{where}: {value!r} cannot be read from {value[position:].strip()!r} on; {_EXPECTED}")
    return _finite(total + product, value, where)


def _factor(text: str, position: int, variables: Variables, where: str) -> tuple[float, int]:
    found = _TERM.match(text, position)
    if found is None:
        raise BadInput(f"{where}: {text!r} is no number; {_EXPECTED}")
    if found["name"] is None:
        number = float(found["number"])
    else:
        held = variable(found["name"], variables, where)
        if isinstance(held, str | tuple):
            raise BadInput(f"{where}: ${found['name']} is {held!r}, a number is expected")
        number = float(held)
    return (-number if found["sign"] else number), found.end()


def _finite(number: float, text: str, where: str) -> float:
    if not math.isfinite(number):
        raise BadInput(f"{where}: {text} is no finite number")
    return number + 0.0  # no minus zero, which would be printed as -0


def variable(name: str, variables: Variables, where: str) -> Scalar | tuple[Scalar, ...]:
    """The value of a parameter or of a loop's variable."""
    if name not in variables:
        known = ", ".join(f"${each}" for each in variables) or "none"
        near = near_name(name, variables)
        raise BadInput(f"{where}: ${name} is neither a parameter nor a loop's variable{near}; there is {known}")
    return variables[name]


def text_of(value: str, variables: Variables, where: str) -> str:
    """A text with its names in braces replaced by their values; ``$name`` alone is replaced too."""
    if (found := _NAME.fullmatch(value)) is not None:
        return shown(variable(found[1], variables, where))
    return _PLACE.sub(lambda place: shown(variable(place[1], variables, where)), value)


def shown(value: Scalar | tuple[Scalar, ...]) -> str:
    """A value as a text."""
    if isinstance(value, tuple):
        return ", ".join(shown(each) for each in value)
    return value if isinstance(value, str) else f"{value:.10g}"
