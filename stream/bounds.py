"""Bounds of every number, name, key and message on the wire; sources and recorders refuse more.

Within them the difference of two times, and an interval added, fit 64 bits: no compiled loop or SQL view overflows.
"""

from functools import cache
from typing import Any

import msgspec

MIN_MOMENT_NS = -(2**61)  # December 1896
MAX_MOMENT_NS = 2**62  # February 2116
MAX_INTERVAL_NS = 2**58  # 9 years
MAX_SEQ = 2**53  # 285 years at 1 MHz
MAX_INTEGER = 2**63 - 1
MAX_SECONDS = MAX_MOMENT_NS / 1e9
MAX_NAME_CHARS = 128
MAX_KEY_CHARS = 1024
MAX_MESSAGE_BYTES = 32 << 20  # a batch of a million samples with times and flags has 17 MB
MAX_DEPTH = 20

_PLAIN = frozenset({str, str | None, bool, bool | None, float, float | None})  # JSON has no float beyond its bounds
_SECONDS = frozenset({"settle_s", "planned_s", "tau_s"})  # which are made into nanoseconds
_NAMES = ("run", "unit", "signal")


def beyond_bounds(document: msgspec.Struct) -> str | None:
    """What is out of bounds in a document, as a phrase; None if nothing is.

    >>> from stream.events import RunResumed
    >>> beyond_bounds(RunResumed(run="r1", t_ns=0, gap_ns=10**9))
    >>> beyond_bounds(RunResumed(run="r1", t_ns=0, gap_ns=2**80))
    'gap_ns is beyond 64 bits'
    """
    t_ns = getattr(document, "t_ns", 0)
    if not MIN_MOMENT_NS <= t_ns <= MAX_MOMENT_NS:
        return f"t_ns {t_ns} is not between 1897 and 2116"
    for name in _NAMES:
        text = getattr(document, name, None)
        if text is not None and len(text) > MAX_NAME_CHARS:
            return f"{name} has {len(text)} characters, at most {MAX_NAME_CHARS} are allowed"
    return _of_fields(document, "", 0)


def _of_fields(value: msgspec.Struct, path: str, depth: int) -> str | None:
    for name in _fields(type(value)):
        if name in _SECONDS:
            if abs(getattr(value, name) or 0.0) > MAX_SECONDS:
                return f"{path}{name} is more than 146 years"
        elif (found := _of(getattr(value, name), f"{path}{name}", depth)) is not None:
            return found
    return None


@cache
def _fields(kind: type[msgspec.Struct]) -> tuple[str, ...]:
    """Fields that are checked: those that may hold an integer, and some times."""
    fields = msgspec.structs.fields(kind)
    return tuple(field.name for field in fields if field.type not in _PLAIN or field.name in _SECONDS)


def _of(value: Any, path: str, depth: int) -> str | None:
    if type(value) is int:
        return f"{path[:80]} is beyond 64 bits" if abs(value) > MAX_INTEGER else None
    if isinstance(value, str | float | bool) or value is None:
        return None
    if depth >= MAX_DEPTH:
        return f"{path[:80]} is nested deeper than {MAX_DEPTH} levels"
    if isinstance(value, msgspec.Struct):
        return _of_fields(value, f"{path}.", depth + 1)
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for name, each in items:
        if (found := _of(each, f"{path}.{name}", depth + 1)) is not None:
            return found
    return None
