"""All mistakes of a tree of plain values that is to be of a type; the library names the first alone."""

import difflib
import types
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import Enum
from itertools import islice
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import msgspec

from stream.decoding import converted
from stream.errors import BadInput

_MOST = 20


def near_name(name: str, known: Iterable[str]) -> str:
    """A question after the known name that `name` may be a mistyping of; empty where there is none."""
    near = similar_names(name, known)
    return f", did you mean {near[0]}?" if near else ""


def similar_names(name: str, known: Iterable[str], most: int = 1) -> list[str]:
    """Known names that `name` may be a mistyping of, the nearest first; upper and lower case are alike.

    >>> similar_names("fog-1", ["FOG-1", "FOG-12", "ring"], most=2)
    ['FOG-1', 'FOG-12']
    """
    folded = {each.casefold(): each for each in known}
    return [folded[each] for each in difflib.get_close_matches(name.casefold(), folded, n=most)]


@contextmanager
def collected(found: list[str]) -> Iterator[None]:
    """Keep what a BadInput within says among other mistakes.

    >>> found: list[str] = []
    >>> with collected(found):
    ...     raise BadInput("a is 1", "b is 2")
    >>> found
    ['a is 1', 'b is 2']
    """
    try:
        yield
    except BadInput as error:
        found.extend(map(str, error.args))


def listed(mistakes: Iterable[str]) -> str:
    """Mistakes as one text; empty where there is none.

    >>> listed(["a is 1"]), listed(["a is 1", "b is 2"])
    ('a is 1', '2 mistakes: a is 1; b is 2')
    """
    found = list(islice(mistakes, _MOST + 1))
    if len(found) < 2:
        return "".join(found)
    count = f"{len(found)}" if len(found) <= _MOST else f"more than {_MOST}"
    return f"{count} mistakes: {'; '.join(found[:_MOST])}"


def mistakes(value: Any, kind: Any, at: str = "$") -> Iterator[str]:
    """Each unknown key, missing key and wrong value, with its place.

    >>> class Line(msgspec.Struct, forbid_unknown_fields=True):
    ...     port: str
    ...     baud: int = 9600
    >>> for each in mistakes({"L1": {"prot": "x", "baud": "9600"}}, dict[str, Line]):
    ...     print(each)
    Object contains unknown field `prot` - at `$.L1`, did you mean port?
    Object missing required field `port` - at `$.L1`
    Expected `int`, got `str` - at `$.L1.baud`
    """
    is_well = True
    for each in _within(value, kind, at):
        is_well = False
        yield each
    if is_well:
        try:
            converted(value, kind, is_toml=True)
        except msgspec.ValidationError as error:
            text = str(error)
            text = text.replace("`$", f"`{at}") if "`$" in text else text if at == "$" else f"{text} - at `{at}`"
            choices = _choices(kind) if isinstance(value, str) and text.startswith("Invalid enum value") else []
            yield text + (near_name(value, choices) or f"; there are {', '.join(choices)}" if choices else "")


def _choices(kind: Any) -> list[str]:
    """The words that a value may be; empty where it may be anything else.

    >>> _choices(Literal["unit", "lot"] | None), _choices(str)
    (['unit', 'lot'], [])
    """
    if get_origin(kind) is Literal:
        return [str(each) for each in get_args(kind)]
    if get_origin(kind) in {Annotated, Union, types.UnionType}:
        return [each for inner in get_args(kind) for each in _choices(inner)]
    return [str(each.value) for each in kind] if isinstance(kind, type) and issubclass(kind, Enum) else []


def _within(value: Any, kind: Any, at: str) -> Iterator[str]:
    """Mistakes of the parts of a value; those of tables of several kinds are not looked for."""
    while get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    origin, inner = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        if isinstance(value, dict):
            yield from _of_table(value, kind, at)
    elif isinstance(origin, type) and issubclass(origin, Mapping):
        if isinstance(value, dict):
            for key, each in value.items():
                yield from mistakes(each, inner[1], f"{at}.{key}")
    elif isinstance(origin, type) and issubclass(origin, Sequence):
        is_alike = origin is not tuple or inner[1:] == (Ellipsis,)
        if isinstance(value, list) and is_alike:
            for number, each in enumerate(value):
                yield from mistakes(each, inner[0], f"{at}[{number}]")
    elif origin in {Union, types.UnionType}:
        several = [each for each in inner if each is not type(None)]
        if len(several) == 1 and value is not None:
            yield from mistakes(value, several[0], at)


def _of_table(value: dict[str, Any], kind: type[msgspec.Struct], at: str) -> Iterator[str]:
    fields = {field.encode_name: field for field in msgspec.structs.fields(kind)}
    config = kind.__struct_config__
    unknown = [key for key in value if key not in {*fields, config.tag_field}] if config.forbid_unknown_fields else []
    for key in unknown:
        near = near_name(key, fields) or f"; there are {', '.join(fields)}"
        yield f"Object contains unknown field `{key}`{_place(at)}{near}"
    for key, field in fields.items():
        if key in value:
            yield from mistakes(value[key], field.type, f"{at}.{key}")
        elif field.required:
            yield f"Object missing required field `{key}`{_place(at)}"


def _place(at: str) -> str:
    """A place as the library writes it; the whole is not named."""
    return "" if at == "$" else f" - at `{at}`"
