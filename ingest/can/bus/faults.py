"""Reports of losses and outages of a CAN interface: at once, and then not with every block."""

import threading
import time
from collections.abc import Callable

_SETTLED_S = 2.0  # after that long without a failure an interface is back, even if nobody sends
_REPORT_EVERY_S = 10.0


class Losses:
    """One kind of loss, reported at once and then at most every 10 s; used by any thread.

    >>> losses = Losses(print, "were lost")
    >>> for count in (0, 3, 4, 0):
    ...     losses.add(count)
    3 frames were lost
    >>> losses.flush()
    4 frames were lost, 7 in all
    """

    def __init__(self, report: Callable[[str], None], what: str) -> None:
        self._report, self._what = report, what
        self._reported_s = float("-inf")
        self._unreported = self._total = 0
        self._lock = threading.Lock()

    def add(self, frames: int) -> None:
        """Count lost frames."""
        with self._lock:
            self._unreported += frames
            self._total += frames
            is_due = time.monotonic() - self._reported_s > _REPORT_EVERY_S
        if is_due:
            self.flush()

    def flush(self) -> None:
        """Report what has not been reported."""
        with self._lock:
            new, self._unreported = self._unreported, 0
            if new:
                self._reported_s = time.monotonic()
        if new:
            self._report(f"{new} frames {self._what}" + (f", {self._total} in all" if new < self._total else ""))


class Outage:
    """Failures of one interface: reported once when it goes and once when it is back.

    >>> outage = Outage(print, 0.1, 5.0)
    >>> [outage.failed("it was unplugged") for _ in range(3)]
    it was unplugged
    [0.1, 0.2, 0.4]
    >>> outage.update(is_receiving=True)
    back after 0 s
    """

    def __init__(self, report: Callable[[str], None], shortest_s: float, longest_s: float) -> None:
        self._report, self._shortest_s, self._longest_s = report, shortest_s, longest_s
        self._pause_s = shortest_s
        self._began_s: float | None = None
        self._failed_s = float("-inf")
        self._is_off = False
        self._reported: set[str] = set()

    @property
    def is_over(self) -> bool:
        """Whether the interface is there, as far as is known."""
        return self._began_s is None

    def failed(self, why: str, *, is_off: bool = False) -> float:
        """Report a failure, each reason once in an outage; seconds to wait before the next attempt."""
        now = time.monotonic()
        self._is_off = is_off
        if self._began_s is None:
            self._began_s = now
            if now - self._failed_s > _SETTLED_S:  # one that comes and goes is asked less often all the same
                self._pause_s = self._shortest_s
        self._failed_s = now
        if why not in self._reported:
            self._reported.add(why)
            self._report(why)
        pause_s, self._pause_s = self._pause_s, min(self._longest_s, 2 * self._pause_s)
        return pause_s

    def update(self, *, is_receiving: bool) -> None:
        """The interface did not fail; one that was off the bus is back with its first data."""
        if self._began_s is None:
            return
        now = time.monotonic()
        if is_receiving or (not self._is_off and now - self._failed_s > _SETTLED_S):
            self._report(f"back after {now - self._began_s:.0f} s")
            self._began_s = None
            self._reported.clear()
