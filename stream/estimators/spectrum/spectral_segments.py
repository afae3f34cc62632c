"""The segments of Welch's method: slots are assigned to them, full ones transformed, neighbouring parts joined.

Segment j of N slots holds the slots j N/2 .. j N/2 + N - 1 of the signal, whatever the parts.
"""

import threading
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from stream.batch import BoolArray, FloatArray, IntArray
from stream.compiled import kernel, kernel_part
from stream.estimators.spectrum.spectral_lines import hann_window

START, ORIGIN, FILLED, SEGMENTS, PAIRS, FIRST, LAST = range(7)

# several transforms in one call take half the time of as many calls; the results are identical
_AT_ONCE = 4


class _Rooms(threading.local):
    """Where a thread puts windowed segments and their transforms: new memory for each takes a third of their time."""

    def __init__(self) -> None:
        self._by_size: dict[int, tuple[FloatArray, npt.NDArray[np.complex128]]] = {}

    def of(self, size: int) -> tuple[FloatArray, npt.NDArray[np.complex128]]:
        """Rooms for segments of a size."""
        if size not in self._by_size:
            self._by_size[size] = np.empty((_AT_ONCE, size)), np.empty((_AT_ONCE, size // 2 + 1), np.complex128)
        return self._by_size[size]


_rooms = _Rooms()


class SegmentState(NamedTuple):
    """State of segments of N slots.

    places: shape (7,); slot where the part starts; first slot of the segment being filled, and how much of it is
    filled; segments averaged, and how many of them follow their neighbour; first slots of the first and of the last one
    averaged. buffer: shape (N,); the segment being filled; NaN for a slot that is missing or before the part. power:
    shape (N/2 + 1,); sum of the periodograms, not scaled. head: shape (0,) or (n,); first slots of a continuation, up
    to the end of the last segment across the seam.
    """

    places: IntArray
    buffer: FloatArray
    power: FloatArray
    head: FloatArray


def empty_state(size: int) -> SegmentState:
    """State before the first sample, for segments of `size` slots."""
    places = np.zeros(7, np.int64)
    places[FIRST] = places[LAST] = -size
    return SegmentState(places, np.full(size, np.nan), np.zeros(size // 2 + 1), np.empty(0))


def continuation(earlier: SegmentState) -> SegmentState:
    """Empty state that begins where `earlier` ends."""
    size = len(earlier.buffer)
    half = size // 2
    state = empty_state(size)
    state.places[ORIGIN : FILLED + 1] = earlier.places[ORIGIN : FILLED + 1]
    start = int(earlier.places[ORIGIN] + earlier.places[FILLED])
    state.places[START] = start
    if start == 0:
        return state
    return state._replace(head=np.full((-(-start // half) + 1) * half - start, np.nan))


def take(state: SegmentState, first_slot: int, values: FloatArray, reference: float = 0.0) -> None:
    """Take in values less a reference on the slots from `first_slot` on; those that are not finite are missing."""
    places, buffer, power, head = state
    size = len(buffer)
    half = size // 2
    behind_start = first_slot - int(places[START])
    if behind_start < len(head):
        _put(head, behind_start, behind_start, values[: len(head) - behind_start], reference)
    start = _leap(state, first_slot)
    ends = (start + len(values) - half) // half  # segments that become full
    taken = 0
    window = hann_window(size)
    while ends > 0:
        rows = min(ends, _AT_ONCE)
        room, transforms = _rooms.of(size)
        windowed = room[:rows]
        is_whole = np.empty(rows, np.bool_)
        taken += _fill(buffer, int(places[FILLED]), start, values[taken:], reference, window, windowed, is_whole)
        whole = windowed if is_whole.all() else windowed[is_whole]
        if len(whole):
            _add_powers(np.fft.rfft(whole, out=transforms[: len(whole)]), power)
            _count(places, half, is_whole)
        places[ORIGIN] += rows * half
        places[FILLED] = start = half
        ends -= rows
    _put(buffer, int(places[FILLED]), start, values[taken:], reference)
    places[FILLED] = start + len(values) - taken


def append(state: SegmentState, later: SegmentState) -> None:
    """Append the state of the part that follows; its head completes the segments across the seam."""
    start, end = int(later.places[START]), int(later.places[ORIGIN] + later.places[FILLED])
    known = min(len(later.head), end - start)
    if known > 0:
        take(state, start, later.head[:known])
    places = state.places
    if later.places[SEGMENTS]:
        places[PAIRS] += later.places[PAIRS] + (later.places[FIRST] - places[LAST] == len(state.buffer) // 2)
        if not places[SEGMENTS]:
            places[FIRST] = later.places[FIRST]
        places[LAST] = later.places[LAST]
        places[SEGMENTS] += later.places[SEGMENTS]
        with np.errstate(over="ignore", invalid="ignore"):
            state.power[:] += later.power
    if known == len(later.head):
        # the segment being filled lies entirely after the seam
        places[ORIGIN : FILLED + 1] = later.places[ORIGIN : FILLED + 1]
        state.buffer[:] = later.buffer


def _leap(state: SegmentState, slot: int) -> int:
    """Skip the segments that end before `slot`; returns its place in the segment then being filled."""
    places = state.places
    half = len(state.buffer) // 2
    beyond = slot - int(places[ORIGIN]) - 2 * half
    if beyond >= 0:
        places[ORIGIN] += (beyond // half + 1) * half
        # no segment that contains filled slots can become full any more
        places[FILLED] = 0
    return slot - int(places[ORIGIN])


def _count(places: IntArray, half: int, is_whole: BoolArray) -> None:
    for origin in (int(places[ORIGIN]) + half * np.flatnonzero(is_whole)).tolist():
        if not places[SEGMENTS]:
            places[FIRST] = origin
        places[SEGMENTS] += 1
        places[PAIRS] += int(places[LAST]) == origin - half
        places[LAST] = origin


@kernel
def _fill(
    buffer: FloatArray, filled: int, start: int, values: FloatArray, reference: float, window: FloatArray,
    windowed: FloatArray, is_whole: BoolArray,
) -> int:  # fmt: skip
    """Fill segment after segment and window them; returns how many values it took. Half the buffer is then filled."""
    size = buffer.shape[0]
    half = size // 2
    taken = 0
    for row in range(windowed.shape[0]):
        _put(buffer, filled, start, values[taken : taken + size - start], reference)
        taken += size - start
        is_whole[row] = _window(buffer, window, windowed[row])
        for i in range(half):
            buffer[i] = buffer[half + i]
        filled = start = half
    return taken


@kernel
def _put(buffer: FloatArray, filled: int, start: int, values: FloatArray, reference: float) -> None:
    """Write values less the reference, without NumPy's warnings; NaN between them and the filled slots."""
    buffer[filled:start] = np.nan
    for i in range(values.shape[0]):
        buffer[start + i] = values[i] - reference


@kernel_part("reassoc")
def _sums(values: FloatArray) -> tuple[float, float]:
    """The sum, and a number that is 0 if all values are finite, else NaN."""
    total = zero = 0.0
    for i in range(values.shape[0]):
        total += values[i]
        zero += values[i] * 0.0
    return total, zero


@kernel
def _window(values: FloatArray, window: FloatArray, out: FloatArray) -> bool:
    """Write the values less their mean, times the window; False, and nothing written, if one is not finite."""
    total, zero = _sums(values)
    if zero != 0.0:
        return False
    mean = total / values.shape[0]
    for i in range(values.shape[0]):
        out[i] = (values[i] - mean) * window[i]
    return True


@kernel
def _add_powers(transforms: npt.NDArray[np.complex128], power: FloatArray) -> None:
    """Add the squares of the absolute values, row after row."""
    for row in range(transforms.shape[0]):
        for i in range(power.shape[0]):
            power[i] += (
                transforms[row, i].real * transforms[row, i].real + transforms[row, i].imag * transforms[row, i].imag
            )
