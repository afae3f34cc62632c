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
_ZH = {
    "warning": "警告", "alarm": "报警", "raised": "出现", "cleared": "消除", "ended": "终止",
    "test": "测试", "rule": "规则",
    "store": "数据库", "alerts": "条报警",
}  # fmt: skip
_LONGEST = 900  # characters of a line that every server takes
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
            mail["Subject"] = self._subject(first.severity, f"{self._word(first.event)}: {one_line(first.subject)}")
            mail["Message-ID"] = f"<{first.id}.{first.event}@gyrofleet>"
            mail["X-Gyrofleet-Alert"] = first.id
            rule, store = self._word("rule"), self._word("store")
            parts = [*self._texts(first), f"{rule} {first.rule}, {store} {first.store}", self._how(first.id)]
            _fill(mail, "\n\n".join(parts))
            return mail
        severity = max((each.severity for each in messages), key=lambda each: each == "alarm")
        counts = {event: sum(each.event == event for each in messages) for event in ("raised", "cleared", "ended")}
        counted = ", ".join(f"{count:,} {self._word(event)}" for event, count in counts.items() if count)
        mail["Subject"] = self._subject(severity, f"{len(messages):,} {self._word('alerts')}: {counted}")
        mail["Message-ID"] = f"<{identity}.together@gyrofleet>"
        mail["X-Gyrofleet-Alert"] = identity
        lines = [
            f"{each.id} {self._word(each.severity)}, {self._word(each.event)}: "
            + " / ".join(one_line(text, 500) for text in self._texts(each))
            for each in messages
        ]
        about = f"{counted}; {self._word('store')} {first.store}"
        _fill(mail, "\n\n".join([about, "\n".join(lines), self._how("ID")]))
        return mail

    def _subject(self, severity: str, text: str) -> str:
        return f"[gyrofleet {self._word(severity)}] {text}"

    def _word(self, word: str) -> str:
        """A word of a mail in its language; that of both is English."""
        return _ZH.get(word, one_line(word)) if self.lang == "zh" else one_line(word)

    def _how(self, alert: str) -> str:
        name = "姓名" if self.lang == "zh" else "NAME"
        return f"gyrofleet alert acknowledge {alert} --by {name}"

    def _texts(self, message: Message) -> list[str]:
        texts = {"en": [message.text], "zh": [message.text_zh], "both": [message.text, message.text_zh]}[self.lang]
        return [short(each, _MOST_TEXT) for each in texts]


def _fill(mail: EmailMessage, text: str) -> None:
    """Set the text; in base64 where it is not ASCII, since not every server takes eight bits."""
    plain = clean(f"{text}\n")
    mail.set_content(
        plain, cte="7bit" if plain.isascii() and max(map(len, plain.splitlines())) < _LONGEST else "base64"
    )
