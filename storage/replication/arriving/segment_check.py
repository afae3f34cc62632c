"""Checks of a segment: one that has arrived, and one that is in the log."""

import time
from pathlib import Path

from storage.manifests.entries import SegmentEntry
from storage.replication.arriving.arrival import ArrivalRefused
from storage.segments.disk import DISK, sha256_of
from storage.segments.reader import read_marks, read_origin
from storage.store import Store
from stream.errors import StoreError


def check_segment(path: Path, store: str, segment: str) -> None:
    """Refuse a file with the listed hash that is no sealed segment of the plant's store."""
    origin = read_origin(path)
    if origin is not None and origin[0] != store:
        raise ArrivalRefused("foreign_segment", f"{segment} is a segment of store {origin[0]}, the plant's is {store}")
    try:
        read_marks(path)
    except StoreError as error:
        raise ArrivalRefused(
            "not_a_segment", f"{segment} has the listed hash and is no sealed segment: {error}"
        ) from error


def is_intact(path: Path, entry: SegmentEntry) -> bool:
    """Whether a segment is there as it is listed; every byte is read."""
    try:
        return path.stat().st_size == entry.size and sha256_of(path) == entry.sha256
    except OSError:
        return False


def set_aside(store: Store, path: Path) -> Path:
    """Keep a damaged segment in ``log/aside``, durably; returns its path there."""
    store.aside.mkdir(exist_ok=True)
    aside = store.aside / f"{path.name}.{time.time_ns()}"
    DISK.rename(path, aside)
    DISK.sync_folder(store.aside)
    DISK.sync_folder(store.log)
    return aside
