"""JSON, MessagePack and plain values as types: the one place where content from outside becomes objects.

The library examines a type when it is first decoded, and two threads that do so at once end the process: here each
type is examined once, by one thread.
"""

import datetime as dt
import threading
from functools import cache
from typing import Any, TypeVar, overload

import msgspec

T = TypeVar("T")

_TOML_TYPES = (dt.datetime, dt.date, dt.time)
_one_examines = threading.RLock()


@overload
def json_decoder(kind: type[T]) -> msgspec.json.Decoder[T]: ...


@overload
def json_decoder(kind: Any) -> msgspec.json.Decoder[Any]: ...


def json_decoder(kind: Any) -> msgspec.json.Decoder[Any]:
    """Decoder of JSON for a type; threads may share it.

    >>> json_decoder(list[int]).decode(b"[1, 2]")
    [1, 2]
    """
    with _one_examines:
        return _json_decoder(kind)


@overload
def msgpack_decoder(kind: type[T]) -> msgspec.msgpack.Decoder[T]: ...


@overload
def msgpack_decoder(kind: Any) -> msgspec.msgpack.Decoder[Any]: ...


def msgpack_decoder(kind: Any) -> msgspec.msgpack.Decoder[Any]:
    """Decoder of MessagePack for a type; threads may share it."""
    with _one_examines:
        return _msgpack_decoder(kind)


@overload
def decode_json(content: str | bytes, kind: type[T]) -> T: ...


@overload
def decode_json(content: str | bytes, kind: Any = ...) -> Any: ...


def decode_json(content: str | bytes, kind: Any = Any) -> Any:
    """Read JSON as `kind`, or as plain values.

    Raises msgspec.DecodeError if it is invalid, is no UTF-8, or is nested too deeply.

    >>> decode_json(b"[" * 100_000, object)
    Traceback (most recent call last):
    msgspec.DecodeError: lists or objects are nested too deeply
    """
    try:
        return json_decoder(kind).decode(content)
    except RecursionError:
        raise msgspec.DecodeError("lists or objects are nested too deeply") from None
    except UnicodeDecodeError as error:
        raise msgspec.DecodeError(str(error)) from None


def decode_msgpack(content: bytes, kind: type[T]) -> T:
    """Read MessagePack as `kind`; a msgspec.DecodeError if it is invalid, has text in no UTF-8, or is too deep."""
    try:
        return msgpack_decoder(kind).decode(content)
    except RecursionError:
        raise msgspec.DecodeError("lists or maps are nested too deeply") from None
    except UnicodeDecodeError as error:
        raise msgspec.DecodeError(str(error)) from None


@overload
def converted(value: Any, kind: type[T], *, strict: bool = True, is_toml: bool = False) -> T: ...


@overload
def converted(value: Any, kind: Any, *, strict: bool = True, is_toml: bool = False) -> Any: ...


def converted(value: Any, kind: Any, *, strict: bool = True, is_toml: bool = False) -> Any:
    """Make a `kind` of plain values, of which TOML has dates; a msgspec.ValidationError if they are none.

    >>> converted({"a": "1"}, dict[str, int], strict=False)
    {'a': 1}
    """
    examine(kind)
    return msgspec.convert(value, kind, strict=strict, builtin_types=_TOML_TYPES if is_toml else (), str_keys=is_toml)


def examine(kind: Any) -> None:
    """Have the library examine a type before it is used in another way than by the functions here."""
    json_decoder(kind)


@cache
def _json_decoder(kind: Any) -> msgspec.json.Decoder[Any]:
    return msgspec.json.Decoder(kind)


@cache
def _msgpack_decoder(kind: Any) -> msgspec.msgpack.Decoder[Any]:
    return msgspec.msgpack.Decoder(kind)
