"""A provider of OpenID Connect over HTTP: what it says of itself, its keys, tokens for codes."""

import threading
import time
from email.utils import parsedate_to_datetime
from typing import Any, NamedTuple
from urllib.parse import urlencode

import msgspec
import requests
from authlib.common.errors import AuthlibBaseError
from authlib.integrations.requests_client import OAuth2Session
from joserfc.errors import JoseError
from joserfc.jwk import KeySet

from analytics.serve.doors.login_file import LoginFile, OidcSettings, is_safe_url
from analytics.serve.doors.oidc.oidc_problem import OidcProblem
from stream.decoding import converted

_TIMEOUT_S = 5.0
_FRESH_S = 3600.0
_LEAST_WAIT_S = 5.0


class Metadata(msgspec.Struct, frozen=True):
    """What the provider says of itself; other fields are left alone."""

    issuer: str
    authorization_endpoint: str
    token_endpoint: str
    jwks_uri: str
    end_session_endpoint: str = ""
    token_endpoint_auth_methods_supported: tuple[str, ...] = ("client_secret_basic",)
    authorization_response_iss_parameter_supported: bool = False


class Tokens(NamedTuple):
    """An ID token, the access token beside it, and the provider's clock, seconds since 1970 if it says it."""

    id_token: str
    access_token: str
    clock_s: float | None


class OidcProvider:
    """One provider; safe in threads, which wait for each other while it is asked for its metadata or keys."""

    def __init__(self, oidc: OidcSettings, file: LoginFile, redirect_uri: str) -> None:
        self._oidc, self._redirect_uri = oidc, redirect_uri
        self._secret = file.secret(oidc.client_secret_file) if oidc.client_secret_file else None
        self._verify: str | bool = str(file.beside(oidc.certificate_authority)) if oidc.certificate_authority else True
        self._lock = threading.Lock()
        self._metadata: tuple[float, Metadata] | None = None
        self._keys: tuple[float, KeySet] | None = None
        self._failed: tuple[float, str] | None = None

    def metadata(self) -> Metadata:
        """Its metadata, read once an hour; OidcProblem if it cannot be reached."""
        with self._lock:
            if self._metadata is None or time.monotonic() - self._metadata[0] > _FRESH_S:
                self._metadata = (time.monotonic(), self._discovered())
            return self._metadata[1]

    def keys(self, *, is_newer: bool) -> KeySet:
        """Its keys; newer ones where a token names a key that those do not have."""
        uri = self.metadata().jwks_uri
        with self._lock:
            age_s = _FRESH_S if self._keys is None else time.monotonic() - self._keys[0]
            if self._keys is None or age_s >= (_LEAST_WAIT_S if is_newer else _FRESH_S):
                try:
                    self._keys = (time.monotonic(), KeySet.import_key_set(self._json(uri)))
                except (JoseError, KeyError, TypeError, ValueError) as error:
                    raise OidcProblem("unreachable", f"the keys at {uri} cannot be read: {error}") from error
            return self._keys[1]

    def login_url(self, state: str, nonce: str, verifier: str) -> str:
        """Where a browser logs in."""
        url, _ = self._session().create_authorization_url(
            self.metadata().authorization_endpoint, state=state, nonce=nonce, code_verifier=verifier
        )
        return str(url)

    def logout_url(self, id_token: str, back: str) -> str | None:
        """Where a browser logs out at the provider as well, if it has such a page."""
        endpoint = self.metadata().end_session_endpoint
        if not endpoint:
            return None
        asked = {"id_token_hint": id_token, "client_id": self._oidc.client_id, "post_logout_redirect_uri": back}
        return f"{endpoint}{'&' if '?' in endpoint else '?'}{urlencode(asked)}"

    def tokens(self, code: str, verifier: str) -> Tokens:
        """The tokens that a code stands for; a code counts once."""
        responses: list[requests.Response] = []

        def keep(response: requests.Response) -> requests.Response:
            responses.append(response)
            return response

        endpoint = self.metadata().token_endpoint
        with self._session() as session:
            session.register_compliance_hook("access_token_response", keep)
            try:
                found = session.fetch_token(
                    endpoint, grant_type="authorization_code", code=code, code_verifier=verifier,
                    redirect_uri=self._redirect_uri, allow_redirects=False,
                )  # fmt: skip
            except (requests.RequestException, ValueError) as error:
                raise OidcProblem("unreachable", f"{endpoint} gives no token: {error}") from error
            except AuthlibBaseError as error:
                raise OidcProblem("token", f"the provider refuses the code: {error}") from error
        id_token, access_token = found.get("id_token"), found.get("access_token")
        if not isinstance(id_token, str) or not isinstance(access_token, str):
            raise OidcProblem("token", f"{endpoint} answers without an ID token")
        return Tokens(id_token, access_token, _clock_of(responses[-1]) if responses else None)

    def _session(self) -> OAuth2Session:
        methods = self.metadata().token_endpoint_auth_methods_supported
        of_secret = [each for each in ("client_secret_basic", "client_secret_post") if each in methods]
        method = "none" if self._secret is None else (of_secret or ["client_secret_basic"])[0]
        session = OAuth2Session(
            client_id=self._oidc.client_id, client_secret=self._secret, token_endpoint_auth_method=method,
            scope=" ".join(self._oidc.scopes), redirect_uri=self._redirect_uri, code_challenge_method="S256",
            default_timeout=_TIMEOUT_S,
        )  # fmt: skip
        session.verify = self._verify
        return session

    def _discovered(self) -> Metadata:
        if self._failed is not None and time.monotonic() - self._failed[0] < _LEAST_WAIT_S:
            # a crowd of logins must not wait for it one after the other
            raise OidcProblem("unreachable", self._failed[1])
        try:
            found = self._checked()
        except OidcProblem as problem:
            self._failed = (time.monotonic(), str(problem))
            raise
        self._failed = None
        return found

    def _checked(self) -> Metadata:
        uri = f"{self._oidc.issuer.rstrip('/')}/.well-known/openid-configuration"
        try:
            found = converted(self._json(uri), Metadata)
        except msgspec.ValidationError as error:
            raise OidcProblem("unreachable", f"{uri} does not describe a provider: {error}") from error
        if found.issuer != self._oidc.issuer:
            raise OidcProblem("unreachable", f"{uri} is of the issuer {found.issuer!r}, not {self._oidc.issuer!r}")
        for each in (found.authorization_endpoint, found.token_endpoint, found.jwks_uri):
            if not is_safe_url(each):
                raise OidcProblem("unreachable", f"{uri} names {each!r}, which is not https")
        if found.end_session_endpoint and not is_safe_url(found.end_session_endpoint):
            return msgspec.structs.replace(found, end_session_endpoint="")
        return found

    def _json(self, uri: str) -> Any:
        try:
            answer = requests.get(uri, timeout=_TIMEOUT_S, allow_redirects=False, verify=self._verify)
            if answer.status_code != 200:
                raise OidcProblem("unreachable", f"{uri} answers {answer.status_code}")
            return answer.json()
        except (requests.RequestException, ValueError, OSError) as error:
            raise OidcProblem("unreachable", f"{uri} cannot be read: {error}") from error


def _clock_of(answer: requests.Response) -> float | None:
    try:
        return parsedate_to_datetime(answer.headers.get("Date", "")).timestamp()
    except ValueError:
        return None
