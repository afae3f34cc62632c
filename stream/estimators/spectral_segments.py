"""The segments of Welch's method: slots fall into them, full ones are transformed, and neighbouring parts join.

Segment j of N slots holds the slots j N/2 .. j N/2 + N - 1 of the signal, in whatever parts it is worked on.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.fft
from numba import njit

from stream.batch import FloatArray, IntArray
from stream.estimators.kernel_part import kernel_part
from stream.estimators.spectral_lines import hann_window

START, ORIGIN, FILLED, SEGMENTS, PAIRS, FIRST, LAST = range(7)


class SegmentState(NamedTuple):
    """What is kept of segments of N slots.

    Attributes
    ----------
    places : ndarray of int64, shape (7,)
        Slot where the part starts; first slot of the segment that is being filled, and how much of it is; segments
        averaged, and how many of them follow their neighbour; first slots of the first and of the last one averaged.
    buffer : ndarray, shape (N,)
        The segment that is being filled; NaN for a slot that is missing or lies before the part.
    power : ndarray, shape (N/2 + 1,)
        Sum of the periodograms, not scaled.
    head : ndarray, shape (0,) or (n,) with N/2 <= n < N
        Of a part that goes on behind another: its first slots up to the end of the last segment across the seam.
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


def state_behind(earlier: SegmentState) -> SegmentState:
    """Empty state that goes on where `earlier` stands.

    Examples
    --------
    >>> state = empty_state(8)
    >>> take(state, 0, np.arange(5.0))
    >>> later = state_behind(state)
    >>> take(later, 5, np.arange(5.0))
    >>> later.head.tolist(), later.buffer[:6].tolist()
    ([0.0, 1.0, 2.0, 3.0, 4.0, nan, nan], [nan, 0.0, 1.0, 2.0, 3.0, 4.0])
    """
    size = len(earlier.buffer)
    half = size // 2
    state = empty_state(size)
    state.places[ORIGIN : FILLED + 1] = earlier.places[ORIGIN : FILLED + 1]
    start = int(earlier.places[ORIGIN] + earlier.places[FILLED])
    state.places[START] = start
    if start == 0:
        return state
    return state._replace(head=np.full((-(-start // half) + 1) * half - start, np.nan))


def take(state: SegmentState, first_slot: int, values: FloatArray) -> None:
    """Take in values on the slots from `first_slot` on; those that are not finite are missing."""
    places, buffer, _, head = state
    size = len(buffer)
    half = size // 2
    behind_start = first_slot - int(places[START])
    if behind_start < len(head):
        known = values[: len(head) - behind_start]
        head[behind_start : behind_start + len(known)] = known
    taken = 0
    while taken < len(values):
        start = _leap(state, first_slot + taken)
        count = min(size - start, len(values) - taken)
        buffer[int(places[FILLED]) : start] = np.nan
        buffer[start : start + count] = values[taken : taken + count]
        places[FILLED] = start + count
        taken += count
        if start + count == size:
            _close(state)
            buffer[:half] = buffer[half:]
            places[ORIGIN] += half
            places[FILLED] = half


def append(state: SegmentState, later: SegmentState) -> None:
    """Put what goes on behind `state` to it.

    The later head closes the segments across the seam; they are neither the earlier part's nor the later one's.
    """
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
        # what the later part is filling lies behind the seam altogether
        places[ORIGIN : FILLED + 1] = later.places[ORIGIN : FILLED + 1]
        state.buffer[:] = later.buffer


def _leap(state: SegmentState, slot: int) -> int:
    """Leave the segments behind that end before `slot`; its place in the one that is then being filled."""
    places = state.places
    half = len(state.buffer) // 2
    beyond = slot - int(places[ORIGIN]) - 2 * half
    if beyond >= 0:
        places[ORIGIN] += (beyond // half + 1) * half
        # no segment that reaches back to what was filled can be full any more
        places[FILLED] = 0
    return slot - int(places[ORIGIN])


def _close(state: SegmentState) -> None:
    places, buffer, power, _ = state
    windowed = np.empty(len(buffer))
    if not _window(buffer, hann_window(len(buffer)), windowed):
        return
    _add_power(scipy.fft.rfft(windowed), power)
    origin = int(places[ORIGIN])
    if not places[SEGMENTS]:
        places[FIRST] = origin
    places[SEGMENTS] += 1
    places[PAIRS] += int(places[LAST]) == origin - len(buffer) // 2
    places[LAST] = origin


@kernel_part("reassoc")
def _sums(values: FloatArray) -> tuple[float, float]:
    """The sum, and one that is 0 if all are finite, else NaN."""
    total = zero = 0.0
    for i in range(values.shape[0]):
        total += values[i]
        zero += values[i] * 0.0
    return total, zero


@njit(cache=True, nogil=True)
def _window(values: FloatArray, window: FloatArray, out: FloatArray) -> bool:
    """Write the values less their mean, times the window; False, and nothing written, if one is not finite."""
    total, zero = _sums(values)
    if zero != 0.0:
        return False
    mean = total / values.shape[0]
    for i in range(values.shape[0]):
        out[i] = (values[i] - mean) * window[i]
    return True


@njit(cache=True, nogil=True)
def less(values: FloatArray, reference: float) -> FloatArray:
    """The values less a reference; without NumPy's warnings, and the cost of turning them off."""
    out = np.empty_like(values)
    for i in range(values.shape[0]):
        out[i] = values[i] - reference
    return out


@njit(cache=True, nogil=True)
def _add_power(transform: npt.NDArray[np.complex128], power: FloatArray) -> None:
    """Add the squares of the absolute values."""
    for i in range(power.shape[0]):
        power[i] += transform[i].real * transform[i].real + transform[i].imag * transform[i].imag
