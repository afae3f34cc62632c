"""A webhook: a POST of JSON."""

import hashlib
import hmac
import http.client
import socket
import ssl
import urllib.request
from collections.abc import Callable, Collection, Sequence
from typing import Any

import msgspec

from analytics.alerts.patience import Patience
from analytics.alerts.targets import Message, NotSent, Target, reason, secret

_ANSWER_S = 15.0


class WebhookTarget(Target, frozen=True, kw_only=True):
    """A POST of JSON; with `secret_env` its HMAC-SHA256 is in the header ``X-Gyrofleet-Signature``."""

    url: str
    secret_env: str = ""
    headers: dict[str, str] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check what msgspec cannot."""
        if not self.url.startswith(("http://", "https://")):
            raise ValueError(f"url is {self.url!r}; it begins with https:// or http://")
        for name, value in self.headers.items():
            if not name.isascii() or not (name + value).isprintable() or not value.isascii():
                raise ValueError(f"headers.{name}: {value!r} is no header of HTTP")

    def check(self) -> None:
        """Raise a BadInput if the environment lacks the secret."""
        if self.secret_env:
            secret(self.secret_env)

    def send(
        self, messages: Sequence[Message], identity: str, patience: Patience, without: Collection[str] = ()
    ) -> None:
        """Post a message; its ``Idempotency-Key`` is the same each time."""
        del identity, without
        for message in messages:
            headers = {
                "Content-Type": "application/json", "Idempotency-Key": f"{message.id}.{message.event}", **self.headers
            }  # fmt: skip
            try:
                body = msgspec.json.encode(message)
                if self.secret_env:
                    digest = hmac.new(secret(self.secret_env).encode(), body, hashlib.sha256).hexdigest()
                    headers["X-Gyrofleet-Signature"] = f"sha256={digest}"
                request = urllib.request.Request(self.url, body, headers)  # noqa: S310  checked above
                with _opener(patience).open(request, timeout=_ANSWER_S):
                    pass
            except (OSError, http.client.HTTPException, ValueError) as error:
                raise NotSent(f"{self.url}: {reason(error, patience)}") from error


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        """Follow no redirection: a message would be lost as a GET."""


def _opener(patience: Patience) -> urllib.request.OpenerDirector:
    """Opens addresses by connections that `patience` can cut."""

    def watched(kind: Callable[..., http.client.HTTPConnection]) -> Callable[..., http.client.HTTPConnection]:
        def connected(*arguments: Any, **options: Any) -> http.client.HTTPConnection:
            connection = kind(*arguments, **options)
            patience.connection = lambda: _socket_of(connection)
            return connection

        return connected

    class Plain(urllib.request.HTTPHandler):
        def http_open(self, request: urllib.request.Request) -> http.client.HTTPResponse:
            return self.do_open(watched(http.client.HTTPConnection), request)

    class Secure(urllib.request.HTTPSHandler):
        def https_open(self, request: urllib.request.Request) -> http.client.HTTPResponse:
            context = ssl.create_default_context()
            return self.do_open(watched(http.client.HTTPSConnection), request, context=context)

    return urllib.request.build_opener(_NoRedirect, Plain, Secure)


def _socket_of(connection: http.client.HTTPConnection) -> socket.socket | None:
    found: socket.socket | None = connection.sock
    return found
