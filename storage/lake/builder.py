"""The builder of a lake: one at a time, it builds what is sealed and not in the lake, and compacts it."""

import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from storage.lake.lake import Lake
from storage.store import Store, only_one
from stream.errors import StoreError


class LakeBusy(StoreError):
    """Another process, or another part of this one, changes the lake."""


@contextmanager
def builder_lock(store: Store, *, patience_s: float = 0.0) -> Iterator[None]:
    """Lock for changes of the lake of a store; waits up to `patience_s`, then raises LakeBusy."""
    until = time.monotonic() + patience_s
    with ExitStack() as stack:
        while True:
            try:
                stack.enter_context(only_one(store.folder / "lake.lock", "builder of the lake"))
                break
            except StoreError as error:
                if not isinstance(error.__context__, BlockingIOError):
                    raise
                if time.monotonic() >= until:
                    raise LakeBusy(str(error)) from None
            time.sleep(0.1)
        yield


def build_missing(store: Store, *, compacts: bool = True) -> Iterator[str]:
    """Build every sealed segment that is not in the lake, and yield its name. The caller holds `builder_lock`.

    With `compacts` small parts are merged, and what was replaced an hour ago is removed. A damaged segment raises
    StoreError after all others are built.
    """
    lake = Lake(store)
    if not (missing := lake.missing()) and not lake.manifest.parts:
        if compacts:
            lake.purge()
        return
    from storage.lake.compaction import FAN_IN, compact

    failed: dict[str, StoreError] = {}
    for number, segment in enumerate(lake.bring(missing, failed), start=1):
        yield segment
        if compacts and number % FAN_IN == 0:
            deque(compact(lake), maxlen=0)
    if compacts:
        deque(compact(lake), maxlen=0)
        lake.purge()
    for error in failed.values():
        raise error
