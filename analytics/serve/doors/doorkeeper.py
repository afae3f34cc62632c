"""Who sends a request: by token, by a program's token, or by the session of a browser."""

import hmac
from dataclasses import dataclass, field

from starlette.datastructures import Headers

from analytics.serve.doors.rate_limit import RateLimit
from analytics.serve.doors.roles import Person, Role
from analytics.serve.doors.sessions import LONGEST_S, Sessions
from analytics.serve.doors.users_file import UsersFile
from analytics.serve.problems import TooMany

_BY_TOKEN = "token"  # noqa: S105  the name of who holds it


@dataclass
class Doorkeeper:
    """Recognises people and programs.

    Parameters
    ----------
    token: The server's token; empty for none.
    token_role: What its holder may do.
    users: People and programs with names, if there is a file of them.
    cookie: Name of the session's cookie; with the port, since cookies do not know ports.
    is_secure: Whether browsers reach the server by TLS.
    """

    token: str
    token_role: Role
    users: UsersFile | None
    cookie: str
    is_secure: bool
    sessions: Sessions = field(default_factory=Sessions)
    wrong_logins: RateLimit = field(default_factory=lambda: RateLimit(10, 6.0))
    wrong_tokens: RateLimit = field(default_factory=lambda: RateLimit(60, 1.0))

    def identify(self, headers: Headers, cookies: dict[str, str], address: str) -> Person | None:
        """Who sends a request, None if nobody is known; TooMany after many wrong tokens from an address."""
        kind, _, given = headers.get("authorization", "").partition(" ")
        if kind.lower() == "bearer":
            return self._by_token(given.strip(), address)
        session = self.sessions.find(cookies.get(self.cookie, ""))
        if session is None:
            return None
        person = self._holder(session.name, session.fingerprint)
        return None if person is None else Person(person.name, person.role, session.csrf)

    def begin_by_token(self, token: str, address: str) -> str | None:
        """Open a session for the holder of a token; its cookie, None if the token is wrong."""
        self._check_tries(address)
        if self._is_token(token):
            return self.sessions.begin(_BY_TOKEN, "")
        self.wrong_logins.wait_s(address)
        return None

    def begin_by_password(self, name: str, password: str, address: str) -> str | None:
        """Open a session for a user; its cookie, None if name or password are wrong."""
        tried = (address, f"user {name}")  # a password must not be guessed from many addresses
        self._check_tries(*tried)
        user = None if self.users is None else self.users.with_password(name, password)
        if user is not None:
            return self.sessions.begin(name, user.fingerprint)
        for key in tried:
            self.wrong_logins.wait_s(key)
        return None

    def set_cookie(self, cookie: str) -> str:
        """The header that gives a browser its cookie; an empty one takes it away."""
        secure = "; Secure" if self.is_secure else ""
        age_s = round(LONGEST_S) if cookie else 0
        return f"{self.cookie}={cookie}; Path=/; Max-Age={age_s}; HttpOnly; SameSite=Strict{secure}"

    def _check_tries(self, *keys: str) -> None:
        if (wait_s := max(self.wrong_logins.left_s(key) for key in keys)) > 0.0:
            raise TooMany("too many logins have failed", wait_s)

    def _by_token(self, given: str, address: str) -> Person | None:
        if (wait_s := self.wrong_tokens.left_s(address)) > 0.0:
            raise TooMany("too many wrong tokens from this address", wait_s)
        if self._is_token(given):
            return Person(_BY_TOKEN, self.token_role)
        if self.users is not None and (found := self.users.with_token(given)) is not None:
            name, user = found
            return user.person(name)
        self.wrong_tokens.wait_s(address)
        return None

    def _is_token(self, given: str) -> bool:
        encoded = given.encode(errors="surrogatepass")
        return bool(self.token) and hmac.compare_digest(encoded, self.token.encode(errors="surrogatepass"))

    def _holder(self, name: str, fingerprint: str) -> Person | None:
        """Who a session is of; nobody if role or password have changed since, or the user is gone."""
        if not fingerprint:
            return Person(_BY_TOKEN, self.token_role)
        user = None if self.users is None else self.users.users().get(name)
        return user.person(name) if user is not None and user.fingerprint == fingerprint else None
