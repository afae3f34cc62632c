"""Base class of targets, which alerts are sent to."""

import os
from collections.abc import Collection, Sequence
from typing import ClassVar
from unicodedata import category

import msgspec

from analytics.alerts.patience import Patience
from stream.errors import BadInput, GyrofleetError


class NotSent(GyrofleetError):
    """A target did not take a message; it is sent again, but not to the addresses `taken`."""

    def __init__(self, text: str, taken: Collection[str] = ()) -> None:
        super().__init__(text)
        self.taken = frozenset(taken)


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """What a target receives of an alert."""

    id: str
    event: str  # ``raised``, ``cleared``, ``ended`` without passing, or ``test``
    rule: str
    severity: str
    subject: str
    text: str
    text_zh: str
    raised_ns: int
    store: str


class Target(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base class of targets."""

    most_at_once: ClassVar[int] = 1

    def send(
        self, messages: Sequence[Message], identity: str, patience: Patience, without: Collection[str] = ()
    ) -> None:
        """Hand over messages, several under one `identity`, but not to `without`; raises NotSent if not taken."""
        raise NotImplementedError

    def check(self) -> None:
        """Raise a BadInput if what it needs of this computer is not there."""


def reason(error: Exception, patience: Patience) -> str:
    """Why a message was not taken, on one line."""
    if patience.is_over:
        return "it has not answered within the time that it has"
    return one_line(f"{type(error).__name__}: {error}", 400)


def secret(name: str) -> str:
    """A variable of the environment; BadInput if there is none."""
    try:
        return os.environ[name]
    except KeyError:
        raise BadInput(f"the environment has no variable {name!r}, which the rules name for a password") from None


def one_line(text: str, most: int = 200) -> str:
    r"""Text on one line, for a header: without what is no sign, and not too long.

    >>> one_line("SIM-1\r\nBcc: all@plant\x00\u202e")
    'SIM-1 Bcc: all@plant??'
    """
    return short(clean(" ".join(text.split())), most)


def clean(text: str) -> str:
    """Text without control signs, signs that turn the direction of writing, and halves of signs."""
    return "".join(each if each.isprintable() or each in "\n\t" or category(each) == "Zs" else "?" for each in text)


def short(text: str, most: int) -> str:
    """The beginning of a text."""
    return text if len(text) <= most else f"{text[:most]} ..."
