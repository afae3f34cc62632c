"""An interface that is away for a while: told once when it goes and once when it is back, asked for ever less often."""

import time
from collections.abc import Callable

_SETTLED_S = 2.0  # that long without a failure an interface is back, even where nobody sends


class Outage:
    """Follows one interface through failures.

    Parameters
    ----------
    tell: Called with a sentence.
    shortest_s, longest_s: First and longest pause before the interface is opened again, seconds.

    Examples
    --------
    >>> outage = Outage(print, 0.1, 5.0)
    >>> [outage.failed("it was unplugged") for _ in range(3)]
    it was unplugged
    [0.1, 0.2, 0.4]
    >>> outage.update(is_receiving=True)
    back after 0 s
    """

    def __init__(self, tell: Callable[[str], None], shortest_s: float, longest_s: float) -> None:
        self._tell = tell
        self._shortest_s = shortest_s
        self._longest_s = longest_s
        self._pause_s = shortest_s
        self._began_s: float | None = None
        self._failed_s = float("-inf")
        self._is_off = False
        self._told: set[str] = set()

    @property
    def is_over(self) -> bool:
        """Whether the interface is there, as far as is known."""
        return self._began_s is None

    def failed(self, why: str, *, is_off: bool = False) -> float:
        """Note a failure, and tell it unless it was told in this outage; seconds to wait before the next attempt."""
        now = time.monotonic()
        self._is_off = is_off
        if self._began_s is None:
            self._began_s = now
            if now - self._failed_s > _SETTLED_S:  # one that comes and goes is asked less often all the same
                self._pause_s = self._shortest_s
        self._failed_s = now
        if why not in self._told:
            self._told.add(why)
            self._tell(why)
        pause_s, self._pause_s = self._pause_s, min(self._longest_s, 2 * self._pause_s)
        return pause_s

    def update(self, *, is_receiving: bool) -> None:
        """Note that the interface was asked and did not fail; one that was off the bus is back with its first data."""
        if self._began_s is None:
            return
        now = time.monotonic()
        if is_receiving or (not self._is_off and now - self._failed_s > _SETTLED_S):
            self._tell(f"back after {now - self._began_s:.0f} s")
            self._began_s = None
            self._told.clear()
