"""From what a CAN interface stamps its frames with to time at the station."""

from collections.abc import Callable

import numpy as np

from ingest.station_clock import StationClock
from stream.batch import FloatArray, IntArray

_SAME_CLOCK_S = 60.0  # a frame that is told to be older is stamped by another clock than the computer's
_AHEAD_S = 1.0  # no frame is received before it was sent


class ReceiveClock:
    """Receive times of one opened interface.

    Interfaces stamp in seconds since 1970, in seconds since they were switched on, or not at all. Which one it is
    shows with the first frames: a counter of the interface's own is set to the station's clock there once, so that
    intervals between frames stay those of the hardware; without a stamp a frame has the time at which it was read.
    Where the stamps leave the station's clock afterwards, because either was set anew, this is told and they are set
    to it again.

    Parameters
    ----------
    clock: The station's clock.
    tell: Called with a sentence when the stamps had to be set anew.

    Attributes
    ----------
    source: Where the receive times come from.

    Examples
    --------
    >>> clock = ReceiveClock(StationClock(start_ns=0, origin_s=1000.0), print)
    >>> clock.times_ns(np.array([7.0, 7.25]), read_s=1000.5).tolist(), clock.source
    ([250000000, 500000000], 'the interface, counted from its own start')
    """

    def __init__(self, clock: StationClock, tell: Callable[[str], None]) -> None:
        self._clock = clock
        self._tell = tell
        self._offset_s: float | None = None
        self.source = "no frame yet"

    def now_s(self) -> float:
        """The station's moment as one of the computer's clock, seconds since 1970, steps of that clock left out."""
        return self._clock.origin_s + (self._clock.now_ns() - self._clock.start_ns) / (1e9 * self._clock.speed)

    def times_ns(self, stamps_s: FloatArray, read_s: float) -> IntArray:
        """When frames were received, nanoseconds at the station.

        Parameters
        ----------
        stamps_s: shape (n,); stamps of the interface, seconds; 0 or not a number where it has none.
        read_s: When the last of them was read, see `now_s`.
        """
        is_stamped = np.isfinite(stamps_s) & (stamps_s > 0.0)
        moments_s = np.full(len(stamps_s), read_s)
        if is_stamped.any():
            stamped = stamps_s[is_stamped]
            moments_s[is_stamped] = stamped + self._offset_to(float(stamped[-1]), read_s)
        elif self._offset_s is None:
            self.source = "the computer, when a frame was read"
        elapsed_ns = (moments_s - self._clock.origin_s) * self._clock.speed * 1e9
        return self._clock.start_ns + np.rint(elapsed_ns).astype(np.int64)

    def _offset_to(self, stamp_s: float, read_s: float) -> float:
        """From stamps to the computer's clock, seconds."""
        if self._offset_s is None:
            is_of_day = -_AHEAD_S <= read_s - stamp_s <= _SAME_CLOCK_S
            self._offset_s = 0.0 if is_of_day else read_s - stamp_s
            self.source = "the interface, " + ("time of day" if is_of_day else "counted from its own start")
        behind_s = read_s - stamp_s - self._offset_s
        if not -_AHEAD_S <= behind_s <= _SAME_CLOCK_S:
            self._offset_s = read_s - stamp_s
            self._tell(
                f"its time stamps are {abs(behind_s):.3f} s {'behind' if behind_s > 0 else 'ahead of'} the station's "
                f"clock all at once; they are set to it again, and times jump here"
            )
        return self._offset_s
