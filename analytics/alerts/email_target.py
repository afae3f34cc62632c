"""E-mail by SMTP."""

import smtplib
import ssl
from collections.abc import Collection, Sequence
from contextlib import suppress
from email.message import EmailMessage
from typing import Annotated, ClassVar

import msgspec

from analytics.alerts.patience import Patience
from analytics.alerts.targets import Message, NotSent, Target, clean, one_line, reason, secret, short

_ANSWER_S = 15.0
_MOST_TEXT = 4_000


class EmailTarget(Target, frozen=True, kw_only=True):
    """E-mail; `password_env` names the variable of the environment with the password. A flood comes in one mail."""

    host: str
    sender: str
    to: tuple[str, ...]
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)] = 25
    security: str = "none"  # none, starttls or tls
    user: str = ""
    password_env: str = ""
    lang: str = "both"
    most_at_once: ClassVar[int] = 1_000

    def __post_init__(self) -> None:
        """Check what msgspec cannot."""
        if self.security not in {"none", "starttls", "tls"}:
            raise ValueError(f"security is {self.security!r}; it is none, starttls or tls")
        if self.lang not in {"en", "zh", "both"}:
            raise ValueError(f"lang is {self.lang!r}; it is en, zh or both")
        if not self.to:
            raise ValueError("to is empty; name at least one address")
        for address in (self.sender, *self.to):
            if not address or any(each.isspace() or not each.isprintable() or each in "<>,;" for each in address):
                raise ValueError(f"{address!r} is no address; write it as shift@plant.local")

    def check(self) -> None:
        """Raise a BadInput if the environment lacks the password."""
        if self.user:
            secret(self.password_env)

    def send(
        self, messages: Sequence[Message], identity: str, patience: Patience, without: Collection[str] = ()
    ) -> None:
        """Send a mail; its Message-ID is the same each time, so that a mail that comes twice is known."""
        to = [each for each in self.to if each not in without]
        line = (smtplib.SMTP_SSL if self.security == "tls" else smtplib.SMTP)(timeout=_ANSWER_S)
        patience.connection = lambda: getattr(line, "sock", None)
        try:
            mail = self._mail(messages, identity)
            line.connect(self.host, self.port)
            if self.security == "starttls":
                line.starttls(context=ssl.create_default_context())
            if self.user:
                line.login(self.user, secret(self.password_env))
            refused = line.send_message(mail, self.sender, to)
            with suppress(OSError, smtplib.SMTPException):
                line.quit()  # the mail is taken, whatever is answered
        except (OSError, smtplib.SMTPException, ValueError) as error:
            raise NotSent(f"{self.host}:{self.port}: {reason(error, patience)}") from error
        finally:
            line.close()
        if refused:
            address, (code, why) = next(iter(refused.items()))
            raise NotSent(
                f"{self.host}:{self.port} refuses {address}: {code} {one_line(why.decode(errors='replace'), 400)}",
                taken={*self.to} - refused.keys(),
            )

    def _mail(self, messages: Sequence[Message], identity: str) -> EmailMessage:
        first = messages[0]
        mail = EmailMessage()
        mail["From"], mail["To"] = self.sender, ", ".join(self.to)
        if len(messages) == 1:
            mail["Subject"] = f"[gyrofleet {first.severity}] {one_line(first.event)}: {one_line(first.subject)}"
            mail["Message-ID"] = f"<{first.id}.{first.event}@gyrofleet>"
            mail["X-Gyrofleet-Alert"] = first.id
            parts = [*self._texts(first), f"rule {first.rule}, store {first.store}", _how(first.id)]
            mail.set_content(clean("\n\n".join(parts) + "\n"))
            return mail
        severity = max((each.severity for each in messages), key=lambda each: each == "alarm")
        counts = {event: sum(each.event == event for each in messages) for event in ("raised", "cleared")}
        counted = ", ".join(f"{count:,} {event}" for event, count in counts.items() if count)
        mail["Subject"] = f"[gyrofleet {severity}] {len(messages):,} alerts: {counted}"
        mail["Message-ID"] = f"<{identity}.together@gyrofleet>"
        mail["X-Gyrofleet-Alert"] = identity
        lines = [
            f"{each.id} {each.severity}, {each.event}: {' / '.join(one_line(text, 500) for text in self._texts(each))}"
            for each in messages
        ]
        about = f"{counted}; store {first.store}"
        mail.set_content(clean("\n\n".join([about, "\n".join(lines), _how("ID")]) + "\n"))
        return mail

    def _texts(self, message: Message) -> list[str]:
        texts = {"en": [message.text], "zh": [message.text_zh], "both": [message.text, message.text_zh]}[self.lang]
        return [short(each, _MOST_TEXT) for each in texts]


def _how(alert: str) -> str:
    return f"gyrofleet alert acknowledge {alert} --by NAME"
