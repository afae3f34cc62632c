"""Who sends a request: by a proxy's certificate, by token, or by the session of a browser."""

import hmac
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from starlette.datastructures import Headers

from analytics.serve.doors.oidc.oidc_problem import OidcProblem
from analytics.serve.doors.proxy import Caller, Proxy
from analytics.serve.doors.rate_limit import RateLimit
from analytics.serve.doors.roles import Person, Role
from analytics.serve.doors.sessions import LONGEST_S, Session, Sessions
from analytics.serve.doors.users_file import UsersFile
from analytics.serve.doors.watch import Watch
from analytics.serve.problems import Forbidden, TooMany

if TYPE_CHECKING:  # its libraries are an extra
    from analytics.serve.doors.oidc.oidc_login import Entered, OidcLogin

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
    proxy: The proxy that names subjects of certificates, if there is one.
    oidc: Logins by a provider of OpenID Connect, if there is one.
    """

    token: str
    token_role: Role
    users: UsersFile | None
    cookie: str
    is_secure: bool
    proxy: Proxy | None = None
    oidc: "OidcLogin | None" = None
    watch: Watch = field(default_factory=Watch)
    sessions: Sessions = field(default_factory=Sessions)
    wrong_logins: RateLimit = field(default_factory=lambda: RateLimit(10, 6.0))
    wrong_tokens: RateLimit = field(default_factory=lambda: RateLimit(60, 1.0))
    _csrf_key: bytes = field(default_factory=lambda: secrets.token_bytes(32), repr=False)

    def identify(
        self, headers: Headers, cookies: dict[str, str], address: str, caller: Caller | None = None
    ) -> Person | None:
        """Who sends a request, None if nobody is known.

        TooMany after many wrong tokens from an address, Forbidden for a certificate that is nobody's.
        """
        kind, _, given = headers.get("authorization", "").partition(" ")
        if kind.lower() == "bearer":
            return self._by_token(given.strip(), address)
        if caller is not None and caller.subject:
            return self._by_certificate(caller.subject)
        session = self.sessions.find(cookies.get(self.cookie, ""))
        if session is None:
            return None
        person = self._holder(session)
        return None if person is None else replace(person, csrf=session.csrf)

    def begin_by_token(self, token: str, address: str) -> str | None:
        """Open a session for the holder of a token; its cookie, None if the token is wrong."""
        with self._try(address) as right:
            if self._is_token(token):
                right.append(_BY_TOKEN)
                self.watch.saw("login", address, f"the token, {self.token_role.word}")
                return self.sessions.begin(_BY_TOKEN, "")
        self.watch.saw("login refused", address, "wrong token")
        return None

    def begin_by_password(self, name: str, password: str, address: str) -> str | None:
        """Open a session for a user; its cookie, None if name or password are wrong."""
        # a password must not be guessed from many addresses
        with self._try(address, f"user {name}") as right:
            user = None if self.users is None else self.users.with_password(name, password)
            if user is not None:
                right.append(name)
                self.watch.saw("login", address, f"{name} by password, {user.role}")
                return self.sessions.begin(name, user.fingerprint)
        self.watch.saw("login refused", address, f"wrong password or name {name!r}")
        return None

    def begin_by_provider(self, entered: "Entered", address: str) -> str:
        """Open a session for whom a provider knows; its cookie. OidcProblem if another user has the name."""
        users = {} if self.users is None else self.users.users()
        if entered.name == _BY_TOKEN or entered.name in users:
            raise OidcProblem(
                "no_name", f"subject {entered.subject!r}: a user of this server has the name {entered.name}"
            )
        self.watch.saw("login", address, f"{entered.name} by OIDC, subject {entered.subject!r}, {entered.role.word}")
        assert self.oidc is not None
        longest_s = min(self.oidc.oidc.session_h * 3600.0, LONGEST_S)
        return self.sessions.begin(entered.name, "", longest_s, entered.role, entered.id_token)

    def set_cookie(self, cookie: str) -> str:
        """The header that gives a browser its cookie; an empty one takes it away."""
        return self._cookie_header(self.cookie, cookie, round(LONGEST_S), "Strict")

    @property
    def oidc_cookie(self) -> str:
        """Name of the cookie of a login that has begun."""
        return f"{self.cookie}_oidc"

    def set_oidc_cookie(self, cookie: str, age_s: int) -> str:
        """The header of the cookie of a login that has begun; it comes back from the provider's page, so Lax."""
        return self._cookie_header(self.oidc_cookie, cookie, age_s, "Lax")

    def _cookie_header(self, name: str, value: str, age_s: int, same_site: str) -> str:
        secure = "; Secure" if self.is_secure else ""
        return f"{name}={value}; Path=/; Max-Age={age_s if value else 0}; HttpOnly; SameSite={same_site}{secure}"

    @contextmanager
    def _try(self, *keys: str) -> Iterator[list[str]]:
        """Take a try of each key before it is known whether it is right, else many at once would all be let through.

        What is appended says that it was right, and the tries are given back.
        """
        taken: list[str] = []
        right: list[str] = []
        try:
            for key in keys:
                if (wait_s := self.wrong_logins.wait_s(key)) > 0.0:
                    right.append("")  # nothing was tried
                    self.watch.saw("login refused", keys[0], f"too many logins have failed ({key})")
                    raise TooMany("too many logins have failed", wait_s)
                taken.append(key)
            yield right
        finally:
            if right:
                for key in taken:
                    self.wrong_logins.give_back(key)

    def _by_token(self, given: str, address: str) -> Person | None:
        if (wait_s := self.wrong_tokens.left_s(address)) > 0.0:
            raise TooMany("too many wrong tokens from this address", wait_s)
        if self._is_token(given):
            return Person(_BY_TOKEN, self.token_role, is_named=False)
        if self.users is not None and (found := self.users.with_token(given)) is not None:
            name, user = found
            return user.person(name)
        self.wrong_tokens.wait_s(address)
        self.watch.saw("token refused", address, "a token that nobody has")
        return None

    def _by_certificate(self, subject: str) -> Person:
        found = None if self.users is None else self.users.with_certificate(subject)
        if found is None:
            raise Forbidden(
                f"the certificate {subject!r} is of no user; `gyrofleet users add NAME --certificate SUBJECT` adds one"
            )
        name, user = found
        # a browser sends its certificate for every site that asks: changes need a secret that no site knows
        csrf = hmac.digest(self._csrf_key, f"{name} {user.fingerprint}".encode(), "sha256").hex()
        return replace(user.person(name), csrf=csrf)

    def _is_token(self, given: str) -> bool:
        encoded = given.encode(errors="surrogatepass")
        return bool(self.token) and hmac.compare_digest(encoded, self.token.encode(errors="surrogatepass"))

    def _holder(self, session: Session) -> Person | None:
        """Who a session is of; nobody if role or password have changed since, or the user is gone."""
        if session.role is not None:
            return Person(session.name, session.role)
        if not session.fingerprint:
            return Person(_BY_TOKEN, self.token_role, is_named=False)
        user = None if self.users is None else self.users.users().get(session.name)
        return user.person(session.name) if user is not None and user.fingerprint == session.fingerprint else None
