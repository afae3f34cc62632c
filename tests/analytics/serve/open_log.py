"""Samples in the open segment of a store, as a recorder that was killed leaves them."""

from uuid import UUID

from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.segments.records import SAMPLES, LogRecord
from stream.batch import FloatArray, SampleBatch
from stream.identity import Place, sample_key
from stream.wire.batches import encode_batch

START_NS = 1_763_683_200 * 10**9
INTERVAL_NS = 10**7


def write_samples(log: EventLog, values: FloatArray, *, run: str = "r1", signal: str = "rate", first: int = 0) -> None:
    """Write samples of the unit U1 at 100 Hz, durably; `first` is the number of the first one."""
    t0_ns = START_NS + first * INTERVAL_NS
    identity = UUID(int=1 + sum(f"{run}/{signal}".encode()))
    batch = SampleBatch("U1", signal, run, identity, first, t0_ns, INTERVAL_NS, "deg/h", values=values)
    key = sample_key(Place("plant", "bench"), "U1", signal)
    record = LogRecord(key, SAMPLES, batch.last_ns + 1, t0_ns, encode_batch(batch))
    place = place_of(record)
    assert place is not None
    log.append(place, record)
    log.sync()
