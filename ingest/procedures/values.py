"""Values in a procedure: sums and products of parameters, texts with parameters in braces, the variables of loops."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import TypeAlias

from ingest.procedures.file import Item
from ingest.procedures.series import series
from stream.errors import BadInput
from stream.mistakes import near_name

Scalar: TypeAlias = float | int | str
Variables: TypeAlias = Mapping[str, Scalar | tuple[Scalar, ...]]

_TERM = re.compile(
    r"\s*(?P<sign>-?)\s*(?:\$(?P<name>[a-z][a-z0-9_]*)|(?P<number>[0-9]+(?:\.[0-9]*)?(?:[eE][+-]?[0-9]+)?))"
)
_OPERATOR = re.compile(r"\s*([-+*/])")
_PLACE = re.compile(r"\{([^{}]*)\}")
_EXPECTED = "expected is a number, $name, or sums and products of them"
_ONLY_OF_STEPS = ("power", "off_s", "prompt")
_MOST_ROUNDS = 100_000
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


def check_form(item: Item, where: str) -> None:
    """Check that an item is either a step, a loop, or the use of a procedure."""
    if item.over is not None and item.times is not None:
        raise BadInput(f"{where}: give `for` or `times`, not both")
    if (item.over is None) != (item.values is None and item.series is None):
        raise BadInput(f"{where}: a loop needs `for`, the variable's name, and `values` or `series`, what it goes over")
    if item.values is not None and item.series is not None:
        raise BadInput(f"{where}: give `values` or `series`, not both")
    if item.use is not None and item.items:
        raise BadInput(f"{where}: `use` brings steps of its own; put {where.rpartition('.')[2]}.step beside it")
    if item.overrides and item.use is None:
        raise BadInput(f"{where}.set: only what is used (`use`) can be given parameters")
    if item.items or item.use is not None:
        if given := [name for name in _ONLY_OF_STEPS if getattr(item, name) is not None]:
            raise BadInput(f"{where}.{given[0]}: belongs to a step, not to a loop; put it into a step of its own")
    elif item.over is not None or item.times is not None:
        raise BadInput(f"{where}: a loop without steps ([[step.step]])")
    elif item.name is None:
        raise BadInput(f"{where}: a step without a name")


def items_of(items: Iterable[Item], key: str = "$.step") -> Iterator[tuple[str, Item]]:
    """Every item with its key, including those in loops."""
    for i, item in enumerate(items):
        yield f"{key}[{i}]", item
        yield from items_of(item.items, f"{key}[{i}].step")


def rounds(item: Item, variables: Variables, where: str) -> Iterator[dict[str, Scalar]]:
    """A loop's variables, round by round; one round without any for an item that is no loop."""
    if item.times is not None:
        times = number_of(item.times, variables, f"{where}.times")
        if not times.is_integer() or not 1 <= times <= _MOST_ROUNDS:
            raise BadInput(f"{where}.times: {times:g} is no whole number from 1 to {_MOST_ROUNDS}")
        for repeat in range(1, int(times) + 1):
            yield {"repeat": repeat}
    elif item.over is None:
        yield {}
    elif item.series is not None:
        for value in _series(item, variables, f"{where}.series"):
            yield {item.over: value}
    else:
        yield from _values(item, variables, f"{where}.values")


def _series(item: Item, variables: Variables, where: str) -> Iterator[float]:
    asked = item.series
    assert asked is not None
    given = {name: getattr(asked, name) for name in ("min", "max", "count", "room", "apart")}
    numbers = {name: number_of(each, variables, f"{where}.{name}") for name, each in given.items() if each is not None}
    found = series(asked.kind, numbers, where)
    for value in found if asked.order == "rising" else reversed(found):
        yield value
        if asked.both_directions:
            yield -value


def _values(item: Item, variables: Variables, where: str) -> Iterator[dict[str, Scalar]]:
    assert item.over is not None
    listed = item.values
    if isinstance(listed, str):
        if not listed.startswith("$"):
            raise BadInput(f"{where}: {listed!r} is neither a list nor the name of one, as $rates")
        held = variable(listed[1:], variables, where)
        listed = held if isinstance(held, tuple) else (held,)
    assert listed is not None
    if not listed:
        raise BadInput(f"{where}: an empty list")
    for i, value in enumerate(listed):
        if not isinstance(value, dict):
            yield {item.over: bound_value(value, variables, f"{where}[{i}]")}
        elif item.over not in value:
            raise BadInput(f"{where}[{i}]: {item.over!r}, which the loop goes over, is missing")
        else:
            yield {name: bound_value(each, variables, f"{where}[{i}].{name}") for name, each in value.items()}


def bound_value(value: Scalar, variables: Variables, where: str) -> Scalar:
    """A value in a list or passed to a used procedure; a text with a ``$`` is an expression."""
    return number_of(value, variables, where) if isinstance(value, str) and "$" in value else value
