"""A limit of bandwidth: a token bucket."""

import threading
import time
from collections.abc import Callable


class Bandwidth:
    """Lets bytes through at a rate; a second's worth may pass at once.

    Parameters
    ----------
    bytes_per_s : float or None
        The rate; None for no limit.
    clock, sleep : callables
        Seconds that never go back, and waiting.

    Examples
    --------
    >>> waited = []
    >>> limit = Bandwidth(1000, clock=lambda: sum(waited), sleep=waited.append)
    >>> limit.take(1000); limit.take(500)
    >>> waited
    [0.5]
    """

    def __init__(
        self, bytes_per_s: float | None = None, *, clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:  # fmt: skip
        self._rate, self._clock, self._sleep = bytes_per_s, clock, sleep
        self._tokens = bytes_per_s or 0.0
        self._at = clock()
        self._lock = threading.Lock()

    @property
    def most_at_once(self) -> int | None:
        """Bytes to ask for at once, so that a slow line is neither silent nor flooded; None for any number."""
        return None if self._rate is None else max(1024, int(self._rate / 4))

    def take(self, size: int) -> None:
        """Wait until `size` more bytes may pass."""
        if self._rate is None:
            return
        with self._lock:  # plants share it
            now = self._clock()
            self._tokens = min(self._rate, self._tokens + (now - self._at) * self._rate)
            self._at = now
            self._tokens -= size
            wait_s = -self._tokens / self._rate
        if wait_s > 0.0:
            self._sleep(wait_s)
