"""Sessions of browsers: a random cookie, kept as its hash in memory."""

import hashlib
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from analytics.serve.doors.roles import Role

LONGEST_S = 12 * 3600.0
IDLE_S = 4 * 3600.0
_MOST = 10_000


@dataclass
class Session:
    """An open session.

    Parameters
    ----------
    fingerprint: That of the user when it was opened.
    longest_s: It ends after that, used or not.
    role: As the provider states it; None where the users file or a token states it.
    id_token: The provider's ID token, for the logout there.
    """

    name: str
    fingerprint: str
    began_s: float
    used_s: float
    longest_s: float = LONGEST_S
    role: Role | None = None
    id_token: str = field(default="", repr=False)
    csrf: str = field(default_factory=lambda: secrets.token_urlsafe(32))


class Sessions:
    """All open sessions; they end after their time, after 4 hours without a request, and with the process."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._open: dict[str, Session] = {}
        self._lock = threading.Lock()

    def begin(
        self, name: str, fingerprint: str, longest_s: float = LONGEST_S, role: Role | None = None, id_token: str = ""
    ) -> str:
        """Open a session; returns its cookie."""
        cookie, now_s = secrets.token_urlsafe(32), self._clock()
        with self._lock:
            for key in [key for key, each in self._open.items() if self._is_over(each, now_s)]:
                del self._open[key]
            while len(self._open) >= _MOST:
                del self._open[min(self._open, key=lambda key: self._open[key].used_s)]
            self._open[_key(cookie)] = Session(name, fingerprint, now_s, now_s, longest_s, role, id_token)
        return cookie

    def find(self, cookie: str) -> Session | None:
        """The open session of a cookie."""
        now_s = self._clock()
        with self._lock:
            found = self._open.get(_key(cookie))
            if found is None or self._is_over(found, now_s):
                return None
            found.used_s = now_s
            return found

    def end(self, cookie: str) -> Session | None:
        """End a session; the one that was open."""
        with self._lock:
            return self._open.pop(_key(cookie), None)

    def __len__(self) -> int:
        return len(self._open)

    @staticmethod
    def _is_over(session: Session, now_s: float) -> bool:
        return now_s - session.began_s > session.longest_s or now_s - session.used_s > IDLE_S


def _key(cookie: str) -> str:
    return hashlib.sha256(cookie.encode(errors="surrogatepass")).hexdigest()
