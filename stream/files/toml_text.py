"""Untrusted TOML: every fault is one kind of error."""

import re
from typing import TypeVar

import msgspec

from stream.decoding import examine
from stream.mistakes import listed, mistakes

T = TypeVar("T")
_LONG_KEY = re.compile(r"(?:[\w\"'-]{1,64}+[ \t]{0,4}+\.[ \t]{0,4}+){200}")


def decode_toml(text: str | bytes, kind: type[T]) -> T:
    """Read TOML as `kind`; a msgspec.DecodeError if it is invalid, nested too deeply, or has numbers too long.

    Of what is no `kind` the error has all mistakes.

    >>> decode_toml("a = " + "[" * 5000, dict[str, int])
    Traceback (most recent call last):
    msgspec.DecodeError: tables or lists are nested too deeply
    """
    written = text if isinstance(text, str) else text.decode(errors="replace")
    if _LONG_KEY.search(written):  # the parser needs memory quadratic in it
        raise msgspec.DecodeError("a key has more than 200 parts")
    examine(kind)
    try:
        try:
            return msgspec.toml.decode(text, type=kind)
        except msgspec.ValidationError as error:
            raise msgspec.ValidationError(listed(mistakes(msgspec.toml.decode(text), kind)) or str(error)) from None
    except msgspec.DecodeError:
        raise
    except RecursionError:
        raise msgspec.DecodeError("tables or lists are nested too deeply") from None
    except ValueError as error:  # numbers that are too long, invalid UTF-8
        raise msgspec.DecodeError(str(error)) from None
