"""Who is told: e-mail by SMTP, or a webhook."""

import hashlib
import hmac
import os
import smtplib
import ssl
import urllib.error
import urllib.request
from email.message import EmailMessage
from typing import Any

import msgspec

from stream.errors import BadInput, GyrofleetError

_PATIENCE_S = 15.0


class NotSent(GyrofleetError):
    """A target did not take a message; it is sent again."""


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """What a target is told of an alert."""

    id: str
    event: str  # ``raised``, ``cleared`` or ``test``
    rule: str
    severity: str
    subject: str
    text: str
    text_zh: str
    raised_ns: int
    store: str


class Target(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base class of targets."""

    def send(self, message: Message) -> None:
        """Hand over a message; raises NotSent if it is not taken."""
        raise NotImplementedError


class EmailTarget(Target, frozen=True, kw_only=True):
    """E-mail; `password_env` names the variable of the environment with the password."""

    host: str
    sender: str
    to: tuple[str, ...]
    port: int = 25
    security: str = "none"  # none, starttls or tls
    user: str = ""
    password_env: str = ""
    lang: str = "both"

    def __post_init__(self) -> None:
        """Check what msgspec cannot."""
        if self.security not in {"none", "starttls", "tls"}:
            raise ValueError(f"security is {self.security!r}; it is none, starttls or tls")
        if self.lang not in {"en", "zh", "both"}:
            raise ValueError(f"lang is {self.lang!r}; it is en, zh or both")

    def send(self, message: Message) -> None:
        """Send a mail; its Message-ID is the same each time, so that a mail that comes twice is known."""
        mail = EmailMessage()
        mail["From"], mail["To"] = self.sender, ", ".join(self.to)
        mail["Subject"] = f"[gyrofleet {message.severity}] {_line(message.event)}: {_line(message.subject)}"
        mail["Message-ID"] = f"<{message.id}.{message.event}@gyrofleet>"
        mail["X-Gyrofleet-Alert"] = message.id
        texts = {"en": [message.text], "zh": [message.text_zh], "both": [message.text, message.text_zh]}[self.lang]
        about = f"rule {message.rule}, store {message.store}\ngyrofleet alert acknowledge {message.id} --by NAME"
        mail.set_content("\n\n".join([*texts, about]) + "\n")
        try:
            connect = smtplib.SMTP_SSL if self.security == "tls" else smtplib.SMTP
            with connect(self.host, self.port, timeout=_PATIENCE_S) as line:
                if self.security == "starttls":
                    line.starttls(context=ssl.create_default_context())
                if self.user:
                    line.login(self.user, _secret(self.password_env))
                line.send_message(mail)
        except (OSError, smtplib.SMTPException) as error:
            raise NotSent(f"{self.host}:{self.port}: {type(error).__name__}: {error}") from error


class WebhookTarget(Target, frozen=True, kw_only=True):
    """A POST of JSON; with `secret_env` its HMAC-SHA256 is in the header ``X-Gyrofleet-Signature``."""

    url: str
    secret_env: str = ""
    headers: dict[str, str] = {}

    def __post_init__(self) -> None:
        """Check what msgspec cannot."""
        if not self.url.startswith(("http://", "https://")):
            raise ValueError(f"url is {self.url!r}; it begins with https:// or http://")

    def send(self, message: Message) -> None:
        """Post a message; its ``Idempotency-Key`` is the same each time."""
        body = msgspec.json.encode(message)
        headers = {
            "Content-Type": "application/json", "Idempotency-Key": f"{message.id}.{message.event}", **self.headers
        }  # fmt: skip
        if self.secret_env:
            digest = hmac.new(_secret(self.secret_env).encode(), body, hashlib.sha256).hexdigest()
            headers["X-Gyrofleet-Signature"] = f"sha256={digest}"
        request = urllib.request.Request(self.url, body, headers)  # noqa: S310  checked above
        try:
            with _opener().open(request, timeout=_PATIENCE_S):
                pass
        except (OSError, urllib.error.HTTPError, ValueError) as error:
            raise NotSent(f"{self.url}: {type(error).__name__}: {error}") from error


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        """Follow no redirection: a message would be lost as a GET."""


def _opener() -> urllib.request.OpenerDirector:
    return urllib.request.build_opener(_NoRedirect)


def _secret(name: str) -> str:
    try:
        return os.environ[name]
    except KeyError:
        raise BadInput(f"the environment has no variable {name!r}, which the rules name for a password") from None


def _line(text: str) -> str:
    """Text on one line, for a header."""
    return " ".join(text.split())
