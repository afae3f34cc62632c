"""Lists by a rule: preferred numbers of GB/T 321, equal steps, equal ratios, temperature points."""

import math
from collections.abc import Callable
from typing import Literal

from stream.errors import BadInput

# GB/T 321-2005 table 1 (ISO 3): the rounded values between 1 and 10.
PREFERRED = {
    "R5": ("1", "1.6", "2.5", "4", "6.3"),
    "R10": ("1", "1.25", "1.6", "2", "2.5", "3.15", "4", "5", "6.3", "8"),
    "R20": (
        *("1", "1.12", "1.25", "1.4", "1.6", "1.8", "2", "2.24", "2.5", "2.8"),
        *("3.15", "3.55", "4", "4.5", "5", "5.6", "6.3", "7.1", "8", "9"),
    ),
}
Kind = Literal["R5", "R10", "R20", "log", "linear", "temperatures"]

# A preferred number nearer to the largest value than a step of R20 gives way to it ("evenly thinned out").
_NEAR = 10 ** (1 / 20)
_ALMOST = 1e-9
_LEAST_EXPONENT, _MOST_EXPONENT = -12, 12
_MOST_VALUES = 10_000
_LEAST_TEMPERATURE_DEG_C = 10.0  # of the preferred numbers, whose steps below are finer than a chamber is steady


def preferred_below(kind: str, most: float) -> list[float]:
    """Preferred numbers up to `most`, in falling order, over all decades in use."""
    top = min(math.floor(math.log10(most)) + 1, _MOST_EXPONENT)
    return [
        value
        for exponent in range(top, _LEAST_EXPONENT, -1)
        for digits in reversed(PREFERRED[kind])
        if (value := float(f"{digits}e{exponent}")) <= most * (1.0 + _ALMOST)
    ]


def preferred_series(
    kind: str, most: float, *, count: int | None = None, least: float | None = None, given: str = "series"
) -> list[float]:
    """The largest value `most`, preferred number or not, and preferred numbers of `kind` below it, in rising order.

    Exactly one of `count`, how many values, and `least`, the smallest, is given. `given` is the series' key, for
    messages. GJB 2426A-2004 5.8.1.3 and JJF 2014-2022 7.2.1.1 b: the R5 series of GB/T 321, suitably rounded and evenly
    thinned out, with the largest input rate.

    >>> preferred_series("R5", 300.0, count=5)
    [63.0, 100.0, 160.0, 250.0, 300.0]
    >>> preferred_series("R5", 255.0, least=40.0)
    [40.0, 63.0, 100.0, 160.0, 255.0]
    """
    if not 0.0 < most < math.inf:
        raise BadInput(f"{given}: max {most:g} is not positive; preferred numbers are")
    if (count is None) == (least is None):
        raise BadInput(f"{given}: give count (how many) or min (down to where), exactly one of them")
    below = [value for value in preferred_below(kind, most) if value * _NEAR < most]
    if count is not None:
        if not 1 <= count <= len(below) + 1:
            raise BadInput(f"{given}: count {count} is outside 1 to {len(below) + 1}")
        below = below[: count - 1]
    else:
        assert least is not None
        if not 0.0 < least <= most:
            raise BadInput(f"{given}: min {least:g} is not between 0 and max {most:g}")
        below = [value for value in below if value >= least * (1.0 - _ALMOST)]
    return [*reversed(below), most]


def temperature_points(least: float, most: float, room: float, apart: float, given: str = "series") -> list[float]:
    """Temperature points: both ends of the range of use and preferred numbers of R5 between them.

    Room temperature is measured separately; the points are at least `apart` from it and from each other, all in deg C.
    GJB 2426A-2004 5.8.5.3 and 5.12.4.3, JJF 2014-2022 7.2.5.1 b and 7.2.16.1 a: points by the R5 series of GB/T 321,
    suitably and evenly chosen over the range of use, with room temperature among them.

    >>> temperature_points(-40.0, 60.0, room=23.0, apart=10.0)
    [-40.0, -25.0, -10.0, 10.0, 40.0, 60.0]
    """
    if not least < most:
        raise BadInput(f"{given}: min {least:g} is not below max {most:g}")
    if not 0.0 < apart < math.inf:
        raise BadInput(f"{given}: apart {apart:g} deg C is not positive")
    taken = [each for each in (least, most) if abs(each - room) >= apart]
    for magnitude in preferred_below("R5", max(abs(least), abs(most))):
        if magnitude < _LEAST_TEMPERATURE_DEG_C:
            break
        for value in (magnitude, -magnitude):
            if least < value < most and all(abs(value - other) >= apart for other in (*taken, room)):
                taken.append(value)
    return sorted(taken)


def log_series(least: float, most: float, count: int, given: str = "series") -> list[float]:
    """`count` values in equal ratios from `least` to `most`."""
    if not 0.0 < least < most < math.inf or count < 2:
        raise BadInput(f"{given}: equal ratios need 0 < min < max and count of at least 2")
    ratio = math.log(most / least) / (count - 1)
    return [least, *(_rounded(least * math.exp(ratio * i)) for i in range(1, count - 1)), most]


def linear_series(least: float, most: float, count: int, given: str = "series") -> list[float]:
    """`count` values in equal steps from `least` to `most`."""
    if not least < most or count < 2:
        raise BadInput(f"{given}: equal steps need min < max and count of at least 2")
    return [least, *(_rounded(least + (most - least) * i / (count - 1)) for i in range(1, count - 1)), most]


def _rounded(value: float) -> float:
    """Six digits: a table cannot be set more finely."""
    return float(f"{value:.6g}")


_NEEDED = {"log": ("min", "max", "count"), "linear": ("min", "max", "count"), "temperatures": ("min", "max", "room")}
_TAKEN = {"log": (), "linear": (), "temperatures": ("apart",)}


def series(kind: Kind, numbers: dict[str, float], given: str = "series") -> list[float]:
    """The list of a `series` table of a procedure, in rising order.

    Its `numbers` are, for ``R5``, ``R10``, ``R20``, `max` with `count` or `min`; for ``log`` and ``linear`` `min`,
    `max` and `count`; for ``temperatures`` `min`, `max`, `room`, and `apart`, 10 deg C by default.

    >>> series("R5", {"max": 10.0, "count": 3.0})
    [4.0, 6.3, 10.0]
    """
    needed, taken = _NEEDED.get(kind, ("max",)), _TAKEN.get(kind, ("count", "min"))
    if missing := [name for name in needed if name not in numbers]:
        raise BadInput(f"{given}: kind {kind} needs {' and '.join(missing)}")
    if extra := [name for name in numbers if name not in needed and name not in taken]:
        raise BadInput(f"{given}: kind {kind} takes no {' and no '.join(extra)}, only {', '.join((*needed, *taken))}")
    count = None
    if (number := numbers.get("count")) is not None:
        if not number.is_integer() or not 1 <= number <= _MOST_VALUES:
            raise BadInput(f"{given}: count {number:g} is no whole number from 1 to {_MOST_VALUES}")
        count = int(number)
    if kind == "temperatures":
        return temperature_points(numbers["min"], numbers["max"], numbers["room"], numbers.get("apart", 10.0), given)
    if kind in {"log", "linear"}:
        assert count is not None
        make: Callable[..., list[float]] = log_series if kind == "log" else linear_series
        return make(numbers["min"], numbers["max"], count, given)
    return preferred_series(kind, numbers["max"], count=count, least=numbers.get("min"), given=given)
