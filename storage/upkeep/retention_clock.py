"""Plausibility of the clock before raw rows are dropped by age: a clock that leaps makes everything old at once.

A file beside the lake keeps the last readings of the wall clock and of the machine's clock, which nobody sets, and up
to when a person has confirmed leaps.
"""

import time
from contextlib import suppress
from pathlib import Path

import msgspec

from storage.manifests.lake import Manifest
from storage.store import Store
from stream.decoding import decode_json
from stream.errors import StoreError
from stream.files.atomic_file import replacement

_NAME = "retention-clock.json"
_BOOT = Path("/proc/sys/kernel/random/boot_id")
_DAY_NS = 86_400 * 10**9
_MOST_APART_NS = 3600 * 10**9  # between both clocks while the machine runs
_LONGEST_PAUSE_NS = 30 * _DAY_NS  # without an arrival, or with the machine off
_REMEDY = "nothing is dropped by age; set the clock right, or, if it is right, give `gyrofleet retain --trust-clock`"


class RetentionPaused(StoreError):
    """Ages are unknown, since the clock has leapt."""


class Seen(msgspec.Struct, frozen=True):
    """Last readings of the clocks, and up to when leaps are confirmed, nanoseconds."""

    wall_ns: int
    machine_ns: int
    boot: str
    trusted_ns: int = -(2**62)


def check_clock(store: Store, manifest: Manifest, now_ns: int) -> None:
    """Keep a reading of the clock; RetentionPaused if it leapt, went back, or 30 days passed without any record."""
    last = None
    with suppress(OSError, msgspec.MsgspecError):
        last = decode_json((store.folder / _NAME).read_bytes(), Seen)
    reason = _doubt(manifest, last, now_ns)
    if reason is not None:
        raise RetentionPaused(f"{store.folder}: {reason}; {_REMEDY}")
    _write(store, Seen(now_ns, _machine_ns(), _boot(), -(2**62) if last is None else last.trusted_ns))


def trust_clock(store: Store, now_ns: int) -> None:
    """Confirm the present time, and all leaps before."""
    _write(store, Seen(now_ns, _machine_ns(), _boot(), now_ns))


def _doubt(manifest: Manifest, last: Seen | None, now_ns: int) -> str | None:
    """Why the clock is implausible; None if it is not."""
    if last is not None and last.boot and last.boot == _boot():
        leap_ns = (now_ns - last.wall_ns) - (_machine_ns() - last.machine_ns)
        if abs(leap_ns) > _MOST_APART_NS:
            return f"the clock was set by {_days(leap_ns)} while the machine was running"
    trusted_ns = -(2**62) if last is None else last.trusted_ns
    arrivals = sorted(
        (part.arrival_first_ns, part.arrival_last_ns)
        for part in manifest.parts
        if part.arrival_first_ns is not None and part.arrival_last_ns is not None
    )
    reached_ns = max(trusted_ns, *([arrivals[0][0]] if arrivals else [trusted_ns]))
    for first_ns, last_ns in arrivals:
        if first_ns - reached_ns > _LONGEST_PAUSE_NS and first_ns > trusted_ns:
            return f"the times of arrival leap by {_days(first_ns - reached_ns)} in the log"
        reached_ns = max(reached_ns, last_ns)
    if last is not None:
        reached_ns = max(reached_ns, last.wall_ns)
    if not arrivals and last is None:
        return None
    if reached_ns - now_ns > _MOST_APART_NS:
        return f"the clock stands {_days(reached_ns - now_ns)} before what was recorded last"
    if now_ns - reached_ns > _LONGEST_PAUSE_NS:
        return f"the clock stands {_days(now_ns - reached_ns)} after what was recorded last"
    return None


def _days(span_ns: int) -> str:
    return f"{abs(span_ns) / _DAY_NS:,.1f} days" + (" back" if span_ns < 0 else "")


def _machine_ns() -> int:
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def _boot() -> str:
    try:
        return _BOOT.read_text().strip()
    except OSError:
        return ""  # then only arrivals are compared


def _write(store: Store, seen: Seen) -> None:
    path = store.folder / _NAME
    try:
        with replacement(path) as fresh:
            fresh.write_bytes(msgspec.json.encode(seen))
    except OSError as error:
        raise StoreError(f"{path} cannot be written: {error}; free space or repair the disk") from error
