"""A log whose writer is interrupted in every way, as its source sees it, for tests of what reads it meanwhile."""

import os
from pathlib import Path
from uuid import UUID

from hypothesis import strategies as st

from storage.lake.builder import build_missing, builder_lock
from storage.log.event_log import EventLog
from storage.store import Store
from stream.identity import sample_key
from stream.wire.acknowledgement import StreamId
from tests.storage.log_records import PLACE, append, samples

UNITS = ("U1", "U2", "U3")
STREAMS = [StreamId(sample_key(PLACE, unit, "rate"), UUID(int=1).hex) for unit in UNITS]


SIZE = 10  # samples a batch


class InterruptedLog:
    """A log that is written, interrupted and taken up again; `acknowledged` is what a source has been told."""

    def __init__(self, folder: Path) -> None:
        self.store = Store.create(folder / "store")
        self.log = EventLog(self.store)
        self.acknowledged: dict[StreamId, int] = {}

    def send(self, unit: int) -> None:
        """The next batch of a unit, as a source sends it that resends what is not acknowledged."""
        append(self.log, samples(UNITS[unit], self.log.marks.get(STREAMS[unit], 0), n=SIZE))

    def sync(self) -> None:
        self.log.sync()
        self.acknowledged = dict(self.log.marks)

    def write(self) -> None:
        """Write without making durable, as a chunk that is full."""
        if self.log._segment is not None:
            self.log._segment._end_chunk()

    def seal(self) -> None:
        self.log.recover()
        self.log.seal()
        self.acknowledged = dict(self.log.marks)

    def fail(self) -> None:
        """The disk fails: what is written and not durable does not count."""
        self.log.abandon()

    def kill(self, torn: int = 0) -> None:
        """The recorder is killed, perhaps within a write, and started again."""
        segment = self.log._segment
        if segment is not None:
            self.write()
            size = segment._size
            segment.abandon()
            if torn:
                os.truncate(segment.open_path, max(size - torn, segment.durable_bytes))
        self.log = EventLog(self.store)

    def build(self) -> None:
        with builder_lock(self.store):
            list(build_missing(self.store))

    def apply(self, name: str, *given: int) -> None:
        """Do a step of a schedule."""
        getattr(self, name)(*given)


SEND = st.tuples(st.just("send"), st.integers(0, 2))
TURNS = st.sampled_from([("sync",), ("write",), ("seal",), ("fail",), ("kill",), ("build",)])
TORN = st.tuples(st.just("kill"), st.integers(1, 300))
