"""Channels that the words of a run's steps give: how the input axis lies, and the rate that was commanded."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from analytics.loop.blocks.signal_axes import signal_axis, turned_about
from storage.sql.catalog import Catalog
from stream.batch import BoolArray, FloatArray, IntArray

_OF_INPUT_AXIS = {"up": 1.0, "down": -1.0}
_HORIZONTAL = frozenset({"east_west", "east", "west", "north", "south", "horizontal"})
_FAR_NS = 2**62
_AXES = frozenset("XYZ")


class Step(NamedTuple):
    """A step of one unit as far as it matters here; an open one ends with the run."""

    start_ns: int
    end_ns: int
    position: str | None
    rate_command_deg_per_s: float | None
    axis: str | None = None


def read_steps(catalog: Catalog, unit: str) -> dict[str, list[Step]]:
    """Steps of a unit by run, in the order of time."""
    found: dict[str, list[Step]] = {}
    for run, start_ns, end_ns, position, rate, axis in catalog.rows(
        "select run, t_start_ns, coalesce(t_end_ns, 9223372036854775807), position, rate_command, axis "
        "from steps where unit = $unit order by run, t_start_ns",
        {"unit": unit},
    ):
        found.setdefault(str(run), []).append(Step(int(start_ns), int(end_ns), position, rate, axis))
    return found


def input_axis_up(position: str | None, signal: str) -> float | None:
    """Component upwards of the input axis in a position: 1, -1, 0 where it is horizontal, None where unknown.

    Known are the words of the procedures of the standards: ``IRA_up``, ``IRA_down``, ``IRA_east_west`` and the like,
    and ``X_up`` to ``Z_down`` for the signals of an axis, ``rate_x`` to ``rate_z``.

    Examples
    --------
    >>> [input_axis_up(word, "rate") for word in ("IRA_up", "IRA_down", "IRA_east_west", "X_up", None)]
    [1.0, -1.0, 0.0, None, None]
    >>> input_axis_up("X_down", "rate_x"), input_axis_up("X_down", "rate_y")
    (-1.0, 0.0)
    """
    axis, _, towards = (position or "").partition("_")
    if axis == "IRA":
        return 0.0 if towards in _HORIZONTAL else _OF_INPUT_AXIS.get(towards)
    own = signal_axis(signal)
    if own is None or axis not in _AXES or towards not in _OF_INPUT_AXIS:
        return None
    return _OF_INPUT_AXIS[towards] if axis.lower() == own else 0.0


def positions_at(steps: Sequence[Step], t_ns: IntArray) -> IntArray:
    """Which step's position the unit has at each moment, as the step's index; -1 where it is being moved.

    Between steps of one position it stays there; before the first and after the last as well.

    Examples
    --------
    >>> steps = [Step(10, 20, "IRA_up", None), Step(30, 40, "IRA_up", None), Step(50, 60, "IRA_down", None)]
    >>> positions_at(steps, np.array([0, 25, 45, 55, 99])).tolist()
    [0, 0, -1, 2, 2]
    """
    return _held(steps, t_ns, lambda step: step.position)


def _held(steps: Sequence[Step], t_ns: IntArray, word: Callable[[Step], str | None]) -> IntArray:
    held = np.full(len(t_ns), -1)
    named = [at for at, step in enumerate(steps) if word(step) is not None]
    for before, at, after in zip([None, *named], named, [*named[1:], None], strict=False):
        start_ns = steps[at].start_ns if before is not None else -_FAR_NS
        stays = after is not None and word(steps[after]) == word(steps[at])
        end_ns = _FAR_NS if after is None else steps[after].start_ns if stays else steps[at].end_ns
        held[(t_ns >= start_ns) & (t_ns <= end_ns)] = at
    return held


def by_position(steps: Sequence[Step], t_ns: IntArray, value: Callable[[str], float | None]) -> FloatArray:
    """A quantity that the position gives, at moments; NaN where the unit is being moved or the word says nothing."""
    given = [None if step.position is None else value(step.position) for step in steps]
    of_step = np.array([np.nan if each is None else each for each in given] + [np.nan])
    return np.asarray(of_step[positions_at(steps, t_ns)], dtype=np.float64)


def by_axis(steps: Sequence[Step], t_ns: IntArray, signal: str) -> FloatArray:
    """Component of the axis that turned along the input axis, at moments; NaN where no step tells."""
    told = [turned_about(step.axis, signal) for step in steps]
    of_step = np.array([np.nan if each is None else each for each in told] + [np.nan])
    return np.asarray(of_step[_held(steps, t_ns, lambda step: step.axis)], dtype=np.float64)


def unknown_axes(steps: Sequence[Step], signal: str) -> list[str]:
    """Words of axes that do not say how they lie to the input axis."""
    words = {step.axis for step in steps if step.axis is not None}
    return sorted(word for word in words if turned_about(word, signal) is None)


def unknown_positions(steps: Sequence[Step], signal: str) -> list[str]:
    """Words of positions that do not say how the input axis lies."""
    words = {step.position for step in steps if step.position is not None}
    return sorted(word for word in words if input_axis_up(word, signal) is None)


def commanded_rate(steps: Sequence[Step], start_ns: IntArray, end_ns: IntArray) -> FloatArray:
    """Rate that was commanded while each block lay wholly within one step, deg/s; else NaN."""
    rate = np.full(len(start_ns), np.nan)
    for step in steps:
        if step.rate_command_deg_per_s is not None:
            rate[(start_ns >= step.start_ns) & (end_ns <= step.end_ns + 1)] = step.rate_command_deg_per_s
    return rate


def step_rows(steps: Sequence[Step], t_ns: IntArray) -> dict[str, BoolArray]:
    """Moments that lie in each step, by its number and words; steps in which none lies are not there."""
    found = {}
    for number, step in enumerate(steps, 1):
        rows = (t_ns >= step.start_ns) & (t_ns < step.end_ns)
        if rows.any():
            rate = step.rate_command_deg_per_s
            words = [str(number), step.position or "", "" if rate is None else f"{rate:g} deg/s"]
            found[" ".join(word for word in words if word)] = rows
    return found


def position_numbers(catalog: Catalog) -> dict[str, float]:
    """A number for each word that stands for a position anywhere in the store, in the order of the words."""
    rows = catalog.rows("select distinct position from steps where position is not null order by 1")
    return {str(word): float(number) for number, (word,) in enumerate(rows, 1)}
