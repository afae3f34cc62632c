"""Untrusted JSON and MessagePack: every fault is one kind of error."""

from typing import TypeVar

import msgspec

T = TypeVar("T")


def decode_json(content: str | bytes, kind: type[T]) -> T:
    """Read JSON as `kind`; a msgspec.DecodeError if it is invalid, is no UTF-8, or is nested too deeply.

    >>> decode_json(b"[" * 100_000, object)
    Traceback (most recent call last):
    msgspec.DecodeError: lists or objects are nested too deeply
    """
    try:
        return msgspec.json.decode(content, type=kind)
    except RecursionError:
        raise msgspec.DecodeError("lists or objects are nested too deeply") from None
    except UnicodeDecodeError as error:
        raise msgspec.DecodeError(str(error)) from None


def decode_msgpack(content: bytes, kind: type[T]) -> T:
    """Read MessagePack as `kind`; a msgspec.DecodeError if it is invalid, has text in no UTF-8, or is too deep."""
    try:
        return msgspec.msgpack.decode(content, type=kind)
    except RecursionError:
        raise msgspec.DecodeError("lists or maps are nested too deeply") from None
    except UnicodeDecodeError as error:
        raise msgspec.DecodeError(str(error)) from None
