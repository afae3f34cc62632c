"""What happens at the doors, as lines of the server's log and as counts: who enters, and what is refused."""

import sys
import threading
from collections import Counter
from datetime import UTC, datetime
from typing import TextIO

from analytics.serve.doors.rate_limit import RateLimit
from stream.terminal.console import structured_log

_MOST_CHARACTERS = 500


class Watch:
    r"""Writes a line for each event; a flood of them is counted, and its lines limited.

    >>> watch = Watch(sys.stdout, RateLimit(1, 60.0, clock=lambda: 0.0), clock=lambda: "12:00")
    >>> watch.saw("refused", "10.0.0.1", "a\nb"); watch.saw("refused", "10.0.0.1", "c"); watch.counts["refused"]
    12:00 refused from 10.0.0.1: 'a\nb'
    2
    """

    def __init__(self, file: TextIO | None = None, limit: RateLimit | None = None, clock: object = None) -> None:
        self._file, self._clock = file, clock
        self._limit = limit or RateLimit(100, 6.0)
        self._lock = threading.Lock()
        self._left_out: Counter[str] = Counter()
        self.counts: Counter[str] = Counter()

    def saw(self, kind: str, address: str, detail: str) -> None:
        """Report an event; its detail may hold what an attacker sent."""
        with self._lock:
            self.counts[kind] += 1
            if self._limit.wait_s(kind) > 0.0:  # refusals must not hide who has entered
                self._left_out[kind] += 1
                return
            more = f" ({count} before it left out)" if (count := self._left_out.pop(kind, 0)) else ""
            now = self._clock() if callable(self._clock) else datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
            text = f"{kind} from {_plain(address)}: {_plain(detail)}{more}"
            if structured_log and self._file is None:
                structured_log[-1]("warning" if "refused" in kind else "info", kind.replace(" ", "_"), text)
            else:
                print(f"{now} {text}", file=self._file or sys.stderr, flush=True)

    def failed(self, text: str) -> None:
        """Report a fault of the program itself, with all its lines."""
        with self._lock:
            self.counts["failed"] += 1
            if self._limit.wait_s("failed") > 0.0:
                return
            if structured_log and self._file is None:
                structured_log[-1]("error", "failed", text)
            else:
                print(text, file=self._file or sys.stderr, flush=True)


def _plain(text: str) -> str:
    """A text in one line that no terminal takes for commands."""
    cut = text if len(text) <= _MOST_CHARACTERS else f"{text[:_MOST_CHARACTERS]}..."
    return cut if cut.isprintable() and cut.isascii() else ascii(cut)
