"""Login by OpenID Connect: the authorization code flow with PKCE, bound to one browser by a cookie."""

import hmac
import secrets
import threading
import time
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from analytics.serve.doors.login_file import DONE_PATH, LoginFile, OidcSettings
from analytics.serve.doors.oidc.oidc_problem import OidcProblem
from analytics.serve.doors.oidc.oidc_provider import OidcProvider
from analytics.serve.doors.oidc.oidc_token import verified_claims
from analytics.serve.doors.rate_limit import RateLimit
from analytics.serve.doors.roles import Role
from analytics.serve.doors.users_file import is_name
from analytics.serve.problems import TooMany

PATIENCE_S = 600.0
_MOST_PENDING = 10_000


class Entered(NamedTuple):
    """Who has logged in: name, role, the provider's own name of them, the page they wanted, and the ID token."""

    name: str
    role: Role
    subject: str
    target: str
    id_token: str


class Begun(NamedTuple):
    """A login that has begun: where the browser goes, and the cookie that it keeps meanwhile."""

    url: str
    cookie: str


@dataclass(frozen=True)
class _Pending:
    """A login that has begun and not ended."""

    cookie: str
    nonce: str
    verifier: str
    target: str
    began_s: float


@dataclass
class OidcLogin:
    """Logins by one provider; each of them ends once, within 10 minutes, in the browser in which it began.

    Parameters
    ----------
    oidc: The provider, and the roles of its claims.
    file: The file of logins.
    site: How browsers reach this server, as ``https://bench7.plant``.
    """

    oidc: OidcSettings
    file: LoginFile
    site: str
    starts: RateLimit = field(default_factory=lambda: RateLimit(120, 0.5))
    _pending: OrderedDict[str, _Pending] = field(default_factory=OrderedDict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        """Read the client's secret."""
        self.provider = OidcProvider(self.oidc, self.file, f"{self.site}{DONE_PATH}")

    def begin(self, target: str, address: str) -> Begun:
        """Begin a login that leads to a page of this server."""
        if (wait_s := self.starts.wait_s(address)) > 0.0:
            raise TooMany("too many logins have begun from this address", wait_s)
        state, cookie = secrets.token_urlsafe(32), secrets.token_urlsafe(32)
        pending = _Pending(cookie, secrets.token_urlsafe(32), secrets.token_urlsafe(48), target, time.monotonic())
        url = self.provider.login_url(state, pending.nonce, pending.verifier)
        with self._lock:
            self._pending[state] = pending
            while len(self._pending) > _MOST_PENDING:
                self._pending.popitem(last=False)
        return Begun(url, cookie)

    def end(self, answer: Mapping[str, str], cookie: str) -> Entered:
        """Who has logged in, by the provider's answer in the browser's address; OidcProblem says why nobody."""
        pending = self._taken(answer.get("state", ""), cookie)
        metadata = self.provider.metadata()
        issuer = answer.get("iss")
        if issuer != self.oidc.issuer and (issuer or metadata.authorization_response_iss_parameter_supported):
            raise OidcProblem("token", f"the answer is of the issuer {issuer!r}, not {self.oidc.issuer!r}")
        if "error" in answer or not answer.get("code"):
            raise OidcProblem("denied", f"the provider answers {answer.get('error', 'without a code')!r}")
        tokens = self.provider.tokens(answer["code"], pending.verifier)
        claims = verified_claims(self.provider, self.oidc, tokens, pending.nonce)
        subject, name = str(claims["sub"]), claims.get(self.oidc.name_claim)
        if not isinstance(name, str) or not is_name(name):
            raise OidcProblem(
                "no_name", f"subject {subject!r}: the claim {self.oidc.name_claim} is {name!r}, which is no user's name"
            )
        role = self.oidc.role(claims)
        if role is None:
            raise OidcProblem("no_role", f"{name}, subject {subject!r}: no role by {self.oidc.role_claim}",
                              name=name)  # fmt: skip
        return Entered(name, role, subject, pending.target, tokens.id_token)

    def _taken(self, state: str, cookie: str) -> _Pending:
        """The login of a state, which is then forgotten."""
        with self._lock:
            found = self._pending.pop(state, None)
        if found is None or time.monotonic() - found.began_s > PATIENCE_S:
            raise OidcProblem("stale", "no login with this state has begun within 10 minutes, or it has ended")
        if not hmac.compare_digest(found.cookie.encode(), cookie.encode(errors="surrogatepass")):
            raise OidcProblem("stale", "the login began in another browser")
        return found
