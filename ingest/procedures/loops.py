"""Loops of a procedure: the form of each item, and a loop's variables, round by round."""

from collections.abc import Iterable, Iterator

from ingest.procedures.file import Item
from ingest.procedures.series import series
from ingest.procedures.values import Scalar, Variables, number_of, variable
from stream.errors import BadInput

_ONLY_OF_STEPS = ("power", "off_s", "prompt")
_MOST_ROUNDS = 100_000


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
