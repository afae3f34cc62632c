"""Retention: raw rows of the oldest parts are dropped, after a document in the log; what was derived stays."""

import time
from datetime import UTC, datetime
from typing import NamedTuple

from storage.lake.lake import Lake
from storage.lake.tables import SAMPLES_FILE
from storage.log.store_documents import signed, store_document
from storage.manifests.lake import Manifest
from storage.manifests.part import Part
from storage.recording.client import record_documents
from storage.upkeep.retention_clock import check_clock
from stream.errors import BadInput
from stream.events import RAW_ROWS_DROPPED, RAW_ROWS_RESTORED, StoreNoted

_UNITS = {"s": 1, "m": 60, "h": 3600, "d": 86_400, "w": 7 * 86_400}
_SIZES = {"B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}


class Rule(NamedTuple):
    """Age and size up to which raw rows are kept; None is no bound."""

    older_than_s: float | None = None
    max_bytes: int | None = None

    def __str__(self) -> str:
        bounds = [] if self.older_than_s is None else [f"older than {format_age(self.older_than_s)}"]
        bounds += [] if self.max_bytes is None else [f"beyond {self.max_bytes:,} bytes"]
        return " or ".join(bounds) or "none"


def format_age(age_s: float) -> str:
    """An age in its largest whole unit.

    >>> format_age(7776000.0), format_age(90.0)
    ('90 d', '90 s')
    """
    name = next((name for name in ("d", "h", "m") if age_s and age_s % _UNITS[name] == 0), "s")
    return f"{age_s / _UNITS[name]:g} {name}"


class Dropped(NamedTuple):
    """Raw rows that are, or would be, dropped."""

    parts: int
    segments: int
    samples: int
    bytes: int


def parse_age(text: str) -> float:
    """Seconds of an age like ``90d``, ``12h`` or ``2w``.

    >>> parse_age("90d")
    7776000.0
    """
    try:
        age_s = float(text[:-1]) * _UNITS[text[-1:]]
    except (ValueError, KeyError):
        age_s = -1.0
    if not 0 <= age_s < float("inf"):
        raise BadInput(f"age {text!r}: give a number with s, m, h, d or w, for example 90d")
    return age_s


def parse_size(text: str) -> int:
    """Bytes of a size like ``500GB``.

    >>> parse_size("1.5 GB")
    1500000000
    """
    number = text.upper().rstrip("BKMGT ")
    try:
        size = float(number) * _SIZES[text.upper()[len(number) :].strip() or "B"]
    except (ValueError, KeyError):
        size = -1.0
    if not 0 <= size < float("inf"):
        raise BadInput(f"size {text!r}: give a number with KB, MB, GB or TB, for example 500GB")
    return round(size)


def choose(manifest: Manifest, rule: Rule, now_ns: int) -> list[Part]:
    """Parts whose raw rows the rule drops, the oldest first."""
    kept = sorted(
        (part for part in manifest.parts if part.dropped is None and part.samples),
        key=lambda part: (part.arrival_last_ns or 0, part.name),
    )
    left = sum(part.files[SAMPLES_FILE].bytes for part in kept)
    chosen = []
    for part in kept:
        is_old = rule.older_than_s is not None and now_ns - (part.arrival_last_ns or 0) > rule.older_than_s * 1e9
        if not is_old and (rule.max_bytes is None or left <= rule.max_bytes):
            break
        chosen.append(part)
        left -= part.files[SAMPLES_FILE].bytes
    return chosen


def would_drop(manifest: Manifest, rule: Rule) -> Dropped:
    """What the rule would drop now."""
    return _sum(choose(manifest, rule, time.time_ns()))


def apply_rule(lake: Lake, rule: Rule, *, now_ns: int | None = None) -> Dropped:
    """Drop raw rows by a rule, after a document of it is in the log; nothing if the clock cannot be trusted."""
    now_ns = time.time_ns() if now_ns is None else now_ns
    if rule.older_than_s is not None:
        check_clock(lake.store, lake.manifest, now_ns)
    chosen = choose(lake.manifest, rule, now_ns)
    dropped = _sum(chosen)
    if not chosen:
        return dropped
    document = signed(lake.store, _document(lake.store.identity, chosen, rule, dropped))
    record_documents(lake.store, [document], role="gyrofleet retain")
    lake.drop_raw({segment: document.uid for part in chosen for segment in part.segments})
    return dropped


def restore_raw(lake: Lake) -> Dropped:
    """Restore dropped raw rows, as far as the log still has their segments; returns what was restored."""
    there = {
        segment: document
        for segment, document in lake.manifest.dropped.items()
        if (lake.store.log / f"{segment}.mcap").exists()
    }
    if not there:
        return Dropped(0, 0, 0, 0)
    before = {part.name for part in lake.manifest.parts if part.dropped is None}
    text = f"raw rows of {len(there)} segments, dropped before, were restored from the log"
    details = {"segments": sorted(there), "documents": sorted(set(there.values()))}
    document = signed(lake.store, store_document(lake.store.identity, RAW_ROWS_RESTORED, text, details))
    record_documents(lake.store, [document], role="gyrofleet rebuild --raw")
    lake.restore_raw({segment: (*lake.manifest.restored.get(segment, ()), by) for segment, by in there.items()})
    return _sum([part for part in lake.manifest.parts if part.dropped is None and part.name not in before])


def _sum(chosen: list[Part]) -> Dropped:
    return Dropped(
        len(chosen), sum(len(part.segments) for part in chosen), sum(part.samples for part in chosen),
        sum(part.files[SAMPLES_FILE].bytes for part in chosen),
    )  # fmt: skip


def _document(store: str, chosen: list[Part], rule: Rule, dropped: Dropped) -> StoreNoted:
    first_ns = min(part.t_first_ns or 0 for part in chosen)
    last_ns = max(part.t_last_ns or 0 for part in chosen)
    text = (
        f"raw rows of {dropped.samples:,} samples from {_moment(first_ns)} to {_moment(last_ns)} were dropped "
        f"from the lake ({dropped.bytes:,} bytes, rule: {rule}); rollups, estimates, events and the log stay"
    )
    details = {
        "segments": sorted(segment for part in chosen for segment in part.segments), "samples": dropped.samples,
        "bytes": dropped.bytes, "t_first_ns": first_ns, "t_last_ns": last_ns, "rule": str(rule),
    }  # fmt: skip
    return store_document(store, RAW_ROWS_DROPPED, text, details)


def _moment(t_ns: int) -> str:
    return datetime.fromtimestamp(t_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S")
