"""Limits of how often something may be tried: a bucket of tries for each address or person, filled steadily."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable

_MOST_KEYS = 10_000


class RateLimit:
    """At most `burst` tries at once, and one more every `every_s`, of each key.

    >>> limit = RateLimit(2, 10.0, clock=lambda: 0.0)
    >>> [limit.wait_s("a"), limit.wait_s("a"), limit.wait_s("a"), limit.wait_s("b")]
    [0.0, 0.0, 10.0, 0.0]
    """

    def __init__(self, burst: int, every_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._burst, self._every_s, self._clock = burst, every_s, clock
        self._full_at: OrderedDict[str, float] = OrderedDict()  # when each bucket is full again
        self._lock = threading.Lock()

    def wait_s(self, key: str) -> float:
        """Take a try; 0 if it may be, else after how many seconds there is one."""
        with self._lock:
            now_s = self._clock()
            wait_s = self._missing_s(key, now_s)
            if wait_s <= 0.0:
                self._full_at[key] = max(self._full_at.get(key, now_s), now_s) + self._every_s
                self._full_at.move_to_end(key)
                while len(self._full_at) > _MOST_KEYS:
                    self._full_at.popitem(last=False)
            return max(wait_s, 0.0)

    def give_back(self, key: str) -> None:
        """Give a try back that does not count."""
        with self._lock:
            if key in self._full_at:
                self._full_at[key] -= self._every_s

    def left_s(self, key: str) -> float:
        """As `wait_s`, without taking a try."""
        with self._lock:
            return max(self._missing_s(key, self._clock()), 0.0)

    def _missing_s(self, key: str, now_s: float) -> float:
        return self._full_at.get(key, now_s) - now_s - (self._burst - 1) * self._every_s
