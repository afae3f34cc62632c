"""Channels from the words of a run's steps: direction of the input axis, position, and commanded rate."""

import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from storage.sql.catalog import Catalog
from stream.batch import BoolArray, FloatArray, IntArray
from stream.channel_names import signal_axis

_OF_INPUT_AXIS = {"up": 1.0, "down": -1.0}
_HORIZONTAL = frozenset({"east_west", "east", "west", "north", "south", "horizontal"})
_FAR_NS = 2**62
_AXES = frozenset("XYZ")
_OTHERS_OF_GYRO = frozenset({"OA", "SA"})
_AXIS_WORD = re.compile(
    r"(?P<before>[+-]?)(?:axis_)?(?P<name>[xyz]|i|ia|ira|input|o|oa|ora|output|s|sa|sra|spin)(?:_axis)?(?P<after>[+-]?)"
)
_INPUT = frozenset({"i", "ia", "ira", "input"})


class Step(NamedTuple):
    """A step of one unit; an open one ends with the run."""

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


def position_numbers(catalog: Catalog) -> dict[str, float]:
    """A number for each position word anywhere in the store, in the order of the words."""
    rows = catalog.rows("select distinct position from steps where position is not null order by 1")
    return {str(word): float(number) for number, (word,) in enumerate(rows, 1)}


def turned_about(axis: str | None, signal: str) -> float | None:
    """Component of the turned axis along the input axis of a signal: 1, -1, 0; None where the word does not say.

    >>> [turned_about(word, "rate_z") for word in ("X", "Z", "-z", "fixture")]
    [0.0, 1.0, -1.0, None]
    >>> [turned_about(word, "rate") for word in ("IRA", "OA", "X")]
    [1.0, 0.0, None]
    """
    match = _AXIS_WORD.fullmatch((axis or "").strip().lower().replace(" ", "_"))
    if match is None:
        return None
    name = match["name"]
    if name in ("x", "y", "z"):
        own = signal_axis(signal)
        if own is None:
            return None
        along = float(name == own)
    else:
        along = float(name in _INPUT)
    return -along if along and "-" in match["before"] + match["after"] else along


def input_axis_up(position: str | None, signal: str) -> float | None:
    """Vertical component of the input axis in a position: 1, -1, 0 where it is horizontal, None where unknown.

    Known are the words of the procedures of the standards: ``IRA_up``, ``IRA_down``, ``IRA_east_west`` and the like,
    and ``X_up`` to ``Z_down`` for the signals of an axis, ``rate_x`` to ``rate_z``; with ``OA_up`` to ``SA_down``, the
    output or spin axis vertical, it is horizontal.

    >>> [input_axis_up(word, "rate") for word in ("IRA_up", "IRA_down", "IRA_east_west", "X_up", None)]
    [1.0, -1.0, 0.0, None, None]
    >>> input_axis_up("X_down", "rate_x"), input_axis_up("X_down", "rate_y"), input_axis_up("OA_up", "rate")
    (-1.0, 0.0, 0.0)
    """
    axis, _, towards = (position or "").partition("_")
    if axis in _OTHERS_OF_GYRO and towards in _OF_INPUT_AXIS:
        return 0.0
    if axis == "IRA":
        return 0.0 if towards in _HORIZONTAL else _OF_INPUT_AXIS.get(towards)
    own = signal_axis(signal)
    if own is None or axis not in _AXES or towards not in _OF_INPUT_AXIS:
        return None
    return _OF_INPUT_AXIS[towards] if axis.lower() == own else 0.0


def _held(steps: Sequence[Step], t_ns: IntArray, word: Callable[[Step], str | None]) -> IntArray:
    """Index of the step whose word holds at each time; -1 during a change.

    Between steps of one word it holds; before the first and after the last as well.

    >>> steps = [Step(10, 20, "IRA_up", None), Step(30, 40, "IRA_up", None), Step(50, 60, "IRA_down", None)]
    >>> _held(steps, np.array([0, 25, 45, 55, 99]), lambda step: step.position).tolist()
    [0, 0, -1, 2, 2]
    """
    held = np.full(len(t_ns), -1)
    named = [at for at, step in enumerate(steps) if word(step) is not None]
    for before, at, after in zip([None, *named], named, [*named[1:], None], strict=False):
        start_ns = steps[at].start_ns if before is not None else -_FAR_NS
        stays = after is not None and word(steps[after]) == word(steps[at])
        end_ns = _FAR_NS if after is None else steps[after].start_ns if stays else steps[at].end_ns
        held[(t_ns >= start_ns) & (t_ns <= end_ns)] = at
    return held


def by_position(steps: Sequence[Step], t_ns: IntArray, value: Callable[[str], float | None]) -> FloatArray:
    """A quantity that the position defines, at given times; NaN while the unit is moved or the word is unknown."""
    return _by_word(steps, t_ns, lambda step: step.position, value)


def by_axis(steps: Sequence[Step], t_ns: IntArray, signal: str) -> FloatArray:
    """Component of the turned axis along the input axis, at given times; NaN where no step says."""
    return _by_word(steps, t_ns, lambda step: step.axis, lambda word: turned_about(word, signal))


def _by_word(
    steps: Sequence[Step], t_ns: IntArray, word: Callable[[Step], str | None], value: Callable[[str], float | None]
) -> FloatArray:
    given = [None if (own := word(step)) is None else value(own) for step in steps]
    of_step = np.array([np.nan if each is None else each for each in given] + [np.nan])
    return np.asarray(of_step[_held(steps, t_ns, word)], dtype=np.float64)


def unknown_axes(steps: Sequence[Step], signal: str) -> set[str]:
    """Words of axes that do not define their direction relative to the input axis."""
    return {step.axis for step in steps if step.axis is not None and turned_about(step.axis, signal) is None}


def unknown_positions(steps: Sequence[Step], signal: str) -> set[str]:
    """Words of positions that do not define the direction of the input axis."""
    words = {step.position for step in steps if step.position is not None}
    return {word for word in words if input_axis_up(word, signal) is None}


def commanded_rate(steps: Sequence[Step], start_ns: IntArray, end_ns: IntArray) -> FloatArray:
    """Commanded rate of each block that lies wholly within one step, deg/s; else NaN."""
    rate = np.full(len(start_ns), np.nan)
    for step in steps:
        if step.rate_command_deg_per_s is not None:
            rate[(start_ns >= step.start_ns) & (end_ns <= step.end_ns + 1)] = step.rate_command_deg_per_s
    return rate


def step_rows(steps: Sequence[Step], t_ns: IntArray) -> dict[str, BoolArray]:
    """Times that lie in each step, by its number and words; without steps that contain none."""
    found = {}
    for number, step in enumerate(steps, 1):
        rows = (t_ns >= step.start_ns) & (t_ns < step.end_ns)
        if rows.any():
            rate = step.rate_command_deg_per_s
            words = [str(number), step.position or "", "" if rate is None else f"{rate:g} deg/s"]
            found[" ".join(word for word in words if word)] = rows
    return found
