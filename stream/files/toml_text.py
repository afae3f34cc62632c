"""Untrusted TOML: every fault is one kind of error."""

import re
from typing import TypeVar

import msgspec

from stream.decoding import examine
from stream.mistakes import listed, mistakes

T = TypeVar("T")
_BOMS_OF_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_LONG_KEY = re.compile(r"(?:[\w\"'-]{1,64}+[ \t]{0,4}+\.[ \t]{0,4}+){200}")


def decode_toml(text: str | bytes, kind: type[T]) -> T:
    """Read TOML as `kind`; a msgspec.DecodeError if it is invalid, nested too deeply, or has numbers too long.

    Of what is no `kind` the error has all mistakes.

    >>> decode_toml("a = " + "[" * 5000, dict[str, int])
    Traceback (most recent call last):
    msgspec.DecodeError: tables or lists are nested too deeply
    """
    if isinstance(text, bytes):
        text = _as_text(text)
    written = text = text.removeprefix("\ufeff")  # Windows writes it before UTF-8
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


def _as_text(content: bytes) -> str:
    """The text of a file; a msgspec.DecodeError that says how to save it, if it is not UTF-8.

    >>> _as_text("产品".encode("gbk"))
    Traceback (most recent call last):
    msgspec.DecodeError: line 1 is not UTF-8 text but perhaps GBK, as of a Chinese Windows: save the file as UTF-8
    """
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
    if content.startswith(_BOMS_OF_UTF16):
        raise msgspec.DecodeError("the file is UTF-16 text: save it as UTF-8")
    try:
        content.decode("gb18030")
    except UnicodeDecodeError:
        raise msgspec.DecodeError(f"line {line} is not UTF-8 text: save the file as UTF-8") from None
    raise msgspec.DecodeError(
        f"line {line} is not UTF-8 text but perhaps GBK, as of a Chinese Windows: save the file as UTF-8"
    )
