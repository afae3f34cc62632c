"""Losses on a CAN bus, told at once and then not again with every block."""

import threading
import time
from collections.abc import Callable


class Losses:
    """One kind of loss; used by any thread.

    Parameters
    ----------
    tell: Called with a sentence.
    what: What happened to so many frames: ``were lost``.
    every_s: Shortest interval between two sentences, seconds.

    Examples
    --------
    >>> losses = Losses(print, "were lost")
    >>> for count in (0, 3, 4, 0):
    ...     losses.note(count)
    3 frames were lost
    >>> losses.flush()
    4 frames were lost, 7 in all
    """

    def __init__(self, tell: Callable[[str], None], what: str, every_s: float = 10.0) -> None:
        self._tell = tell
        self._what = what
        self._every_s = every_s
        self._told_s = float("-inf")
        self._untold = self._total = 0
        self._lock = threading.Lock()

    def note(self, frames: int) -> None:
        """Note that so many more, or none, were lost."""
        with self._lock:
            self._untold += frames
            self._total += frames
            is_due = time.monotonic() - self._told_s > self._every_s
        if is_due:
            self.flush()

    def flush(self) -> None:
        """Tell what has not been told."""
        with self._lock:
            untold, self._untold = self._untold, 0
            if untold:
                self._told_s = time.monotonic()
        if untold:
            self._tell(f"{untold} frames {self._what}" + (f", {self._total} in all" if untold < self._total else ""))
