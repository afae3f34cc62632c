"""Mutations that know the structure of a format: cells of lines, values of trees, integers and blocks of bytes.

A mutation takes a content and a generator of random numbers, and gives another content. What it puts in are values that
readers get wrong: ends of number ranges, paths out of a folder, formulas, marks of writing direction, deep nesting.
"""

import json
import random
import re
import struct
from collections.abc import Callable
from typing import Any

import msgspec
import tomli_w

Mutation = Callable[[bytes, random.Random], bytes]

MAX_BYTES = 1 << 18
BAIT = "../../bait"
_DEEP = "@deep@"
TEXTS = (
    "", " ", "x" * 5000, BAIT, "/etc/passwd", "..", ".", "a/b", "a\\b", "\x00", "=1+1", "@SUM(A1)", "<svg onload=1>",
    "gyrofleet/**", "$(id)", "'; drop table x; --", "\u202egnp.exe", "\x1b[31m", "\ufeff", "\ud7ff", "\uffff", "零偏",
    "nan", "-inf", "1e400", "9" * 400, "-0", "0x10", "1_000", "\u0663", "2026-02-30T25:61:00Z", "0001-01-01T00:00:00Z",
    "9999-12-31T23:59:59.999999999Z", "true", "null", "%s%n", "{0}", _DEEP,
)  # fmt: skip
NUMBERS = (
    0, 1, -1, 2, 127, 128, 255, 256, 32767, 32768, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**53, 2**62,
    2**63 - 1, 2**63, 2**64 - 1, -(2**31), -(2**63),
)  # fmt: skip
FLOATS = (0.5, -0.0, 1e-320, 1e308, -1e308, float("nan"), float("inf"), float("-inf"))
_INTEGERS = ("<B", "<H", "<I", "<Q", ">H", ">I", ">Q")
_TOKEN = re.compile(rb"[^\s,;:=\[\](){}|@\"']+")


def mutated_bytes(content: bytes, rng: random.Random) -> bytes:
    """Some bytes changed, as a disk, a cut transfer or an attacker does it."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        at, span = rng.randrange(len(data) + 1), rng.choice((1, 2, 8, 64, 1024))
        match rng.randrange(8):
            case 0 if data:
                data[at % len(data)] ^= 1 << rng.randrange(8)
            case 1:
                del data[at : at + span]
            case 2:
                data[at:at] = data[at : at + span]
            case 3:
                data[at:at] = rng.randbytes(span)
            case 4:
                data[at : at + span] = bytes(span)
            case 5:
                other = rng.randrange(len(data) + 1)
                data[at : at + span] = data[other : other + span]
            case 6:
                _put_integer(data, at, rng)
            case _:
                del data[at:]
    return bytes(data[:MAX_BYTES])


def mutated_blocks(content: bytes, rng: random.Random) -> bytes:
    """Aligned integers changed: lengths, links and counts of binary formats; sometimes any bytes."""
    if rng.random() < 0.3:
        return mutated_bytes(content, rng)
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(max(1, len(data) // 4)) * 4
        _put_integer(data, at, rng)
    return bytes(data)


def _put_integer(data: bytearray, at: int, rng: random.Random) -> None:
    form = rng.choice(_INTEGERS)
    size = struct.calcsize(form)
    at = max(0, min(at, len(data) - size))
    if len(data) < size:
        return
    (before,) = struct.unpack_from(form, data, at)
    value = rng.choice((*NUMBERS, before + 1, before - 1, 2 * before, len(data), rng.randrange(len(data) + 1)))
    struct.pack_into(form, data, at, value % 256**size)


def mutated_lines(content: bytes, rng: random.Random) -> bytes:
    """Lines and the words in them changed; sometimes any bytes."""
    if rng.random() < 0.15:
        return mutated_bytes(content, rng)
    lines = content.splitlines(keepends=True) or [b""]
    for _ in range(rng.choice((1, 1, 2, 4, 8))):
        at = rng.randrange(len(lines))
        match rng.randrange(6):
            case 0 if len(lines) > 1:
                del lines[at]
            case 1:
                lines.insert(at, rng.choice(lines))
            case 2:
                other = rng.randrange(len(lines))
                lines[at], lines[other] = lines[other], lines[at]
            case 3:
                lines[at] = lines[at].rstrip(b"\r\n") + rng.choice((b"\r\n", b"\r", b"", b"\n\n", b",\n", b";\n"))
            case _:
                lines[at] = _other_word(lines[at], rng.choice(lines), rng)
    return _deepened(b"".join(lines))[:MAX_BYTES]


def _other_word(line: bytes, other: bytes, rng: random.Random) -> bytes:
    words = list(_TOKEN.finditer(line))
    if not words:
        return line + _text(rng).encode(errors="surrogatepass")
    word = rng.choice(words)
    elsewhere = _TOKEN.findall(other)
    new: bytes = rng.choice((_text(rng).encode(errors="surrogatepass"), str(_number(rng)).encode(), *elsewhere[:8]))
    return line[: word.start()] + new + line[word.end() :]


def mutated_tree(tree: Any, rng: random.Random) -> Any:
    """A tree of dictionaries, lists and values with some parts changed; `tree` may be changed itself."""
    root = {"root": tree}
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        places: list[tuple[Any, Any]] = []
        waiting: list[Any] = [root]
        while waiting:
            each = waiting.pop()
            pairs = list(each.items()) if isinstance(each, dict) else list(enumerate(each))
            places += [(each, key) for key, _ in pairs]
            waiting += [value for _, value in pairs if isinstance(value, dict | list)]
        if not places:
            break
        holder, key = rng.choice(places[1:] or places)
        _change(holder, key, rng, places)
    return root.get("root")


def _change(holder: Any, key: Any, rng: random.Random, places: list[tuple[Any, Any]]) -> None:
    value = holder[key]
    match rng.randrange(8):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, dict):
            holder[_text(rng)[:200]] = holder.pop(key)
        case 1 | 2 if isinstance(holder, list):
            holder.insert(key, value)
        case 2:
            holder[_text(rng)[:200]] = _value(rng)
        case 3:
            other, place = rng.choice(places)
            holder[key] = _copied(other[place])
        case 4 if isinstance(value, int | float) and not isinstance(value, bool):
            far = (value * 10**9, value // 10**9) if isinstance(value, int) else (value * 1e9, value / 1e9)
            holder[key] = rng.choice((value + 1, value - 1, -value, *far))
        case 5 if isinstance(value, str):
            at = rng.randrange(len(value) + 1)
            holder[key] = value[:at] + _text(rng) + value[at + rng.randrange(3) :]
        case _:
            holder[key] = _value(rng)


def _copied(value: Any) -> Any:
    try:
        return json.loads(json.dumps(value))
    except (TypeError, ValueError):
        return value if not isinstance(value, dict | list) else None


def _value(rng: random.Random) -> Any:
    match rng.randrange(8):
        case 0 | 1:
            return _text(rng)
        case 2 | 3:
            return _number(rng)
        case 4:
            return rng.choice((True, False, None))
        case 5:
            return rng.choice(([], {}, [[]], {"": {}}, [None], [0] * 1000))
        case _:
            return rng.choice((b"", b"\xff" * 9, "a", 0.1))


def _text(rng: random.Random) -> str:
    return rng.choice(TEXTS)


def _number(rng: random.Random) -> int | float:
    return rng.choice((*NUMBERS, *FLOATS))


def _deepened(content: bytes) -> bytes:
    """The content with a deeply nested list in the place of its mark."""
    if _DEEP.encode() not in content:
        return content
    deep = b"[" * 20_000 + b"]" * 20_000
    return content.replace(b'"' + _DEEP.encode() + b'"', deep, 1).replace(_DEEP.encode(), deep, 1)


def mutated_toml(content: bytes, rng: random.Random) -> bytes:
    """A TOML file with other values and keys; sometimes with other words."""
    import tomllib

    if rng.random() < 0.75:
        try:
            tree = mutated_tree(tomllib.loads(content.decode()), rng)
            return _deepened(tomli_w.dumps(tree).encode(errors="surrogatepass"))[:MAX_BYTES]
        except (ValueError, TypeError, RecursionError, AttributeError, OverflowError):
            pass
    return mutated_lines(content, rng)


def mutated_json(content: bytes, rng: random.Random) -> bytes:
    """A JSON document with other values and keys; sometimes with other words."""
    if rng.random() < 0.85:
        try:
            tree = mutated_tree(json.loads(content), rng)
            text = json.dumps(tree, ensure_ascii=False, default=str, separators=(",", ":"))
            return _deepened(text.encode(errors="surrogatepass"))[: 4 * MAX_BYTES]
        except (ValueError, TypeError, RecursionError):
            pass
    return mutated_lines(content, rng)


def mutated_msgpack(content: bytes, rng: random.Random) -> bytes:
    """A MessagePack document with other values and keys; sometimes with other bytes."""
    if rng.random() < 0.85:
        try:
            return msgspec.msgpack.encode(mutated_tree(msgspec.msgpack.decode(content), rng))
        except (msgspec.MsgspecError, ValueError, TypeError, OverflowError, RecursionError):
            pass
    return mutated_bytes(content, rng)


def within(unpack: Callable[[bytes], bytes], pack: Callable[[bytes], bytes], inner: Mutation) -> Mutation:
    """Mutations of what is inside of a checksum, a compression or a signature, which is then made valid again.

    One in five is one of the outside.
    """

    def mutate(content: bytes, rng: random.Random) -> bytes:
        if rng.random() < 0.8:
            try:
                return pack(inner(unpack(content), rng))
            except Exception:  # noqa: BLE001  what cannot be unpacked any more is mutated as it is
                pass
        return mutated_bytes(content, rng)

    return mutate
