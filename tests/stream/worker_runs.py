"""A log in memory, and workers that are stopped and started again over it."""

import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from uuid import UUID

import numpy as np

from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.delivery.recorded_log import LogBeginning, LoggedMessage
from stream.events import AnyDocument, Limit, LimitsApplied, RunEnded, StreamTotal, decode_event, encode_event
from stream.identity import (
    ACKNOWLEDGEMENT_KEY,
    EVERYTHING,
    EstimateKey,
    Place,
    SampleKey,
    event_key,
    parse_key,
    sample_key,
)
from stream.transport.bus import LocalBus
from stream.wire.acknowledgement import StreamId, StreamPosition, encode_acknowledgement
from stream.wire.batches import decode_batch, encode_batch
from stream.worker.worker import EstimationWorker

PLACE = Place("plant", "bench")


KEY = sample_key(PLACE, "U1", "rate")


DT_NS = 10**7


VALUES = np.random.default_rng(12).standard_normal(60_000) + 3.0


LIMITS = (
    Limit(characteristic="bias_stability", signal="rate", tau_s=1.0, upper=100.0, unit_of_measure="deg/h"),
    Limit(characteristic="allan_deviation", signal="rate", tau_s=2.56, upper=5000.0, unit_of_measure="deg/h"),
    Limit(characteristic="allan_deviation", signal="rate", tau_s=3.0, upper=5000.0, unit_of_measure="deg/h"),
    Limit(characteristic="bias_stability", signal="rate", tau_s=10.0, upper=0.2, unit_of_measure="deg/s"),
    Limit(characteristic="allan_deviation", signal="rate", tau_s=0.05, upper=5000.0, unit_of_measure="deg/h"),
    Limit(characteristic="angle_random_walk", signal="rate", tau_s=None, upper=1.0, unit_of_measure="deg/sqrt(h)"),
)


class MemoryLog:
    """A recorder that keeps everything in memory and acknowledges it at once."""

    identity = "memory"

    def __init__(self, bus: LocalBus) -> None:
        self._bus = bus
        self.messages: list[LoggedMessage] = []
        bus.subscribe(EVERYTHING, self._on_message)

    def _on_message(self, key: str, payload: bytes) -> None:
        if isinstance(parse_key(key), SampleKey):
            batch = decode_batch(payload)
            message = LoggedMessage(StreamId(key, batch.epoch.hex), batch.next_seq, payload)
        else:
            event = decode_event(payload)
            message = LoggedMessage(StreamId(key, event.epoch), event.seq + 1, payload)
        if message.next_seq > self.positions().get(message.stream, 0):
            self.messages.append(message)
        position = StreamPosition(*message.stream, message.next_seq)
        self._bus.publish(ACKNOWLEDGEMENT_KEY, encode_acknowledgement(self.identity, (position,)))

    def positions(self) -> dict[StreamId, int]:
        return {message.stream: message.next_seq for message in self.messages}

    def beginning(self, *, thorough: bool = False) -> LogBeginning:
        self.was_read_thoroughly = thorough
        return LogBeginning({}, frozenset())

    def published(self, positions: Mapping[StreamId, int]) -> Iterator[str]:
        for message in self.since(positions):
            if isinstance(parse_key(message.stream.key), EstimateKey):
                yield decode_event(message.payload).document.uid

    def since(self, positions: Mapping[StreamId, int]) -> Iterator[LoggedMessage]:
        return iter([each for each in self.messages if each.next_seq > positions.get(each.stream, 0)])


def batch(first: int, n: int = 500) -> SampleBatch:
    return SampleBatch(
        "U1", "rate", "r1", UUID(int=1), first, first * DT_NS, DT_NS, "deg/s", values=VALUES[first : first + n]
    )


def run(
    path: Path | None,
    lives: list[list[int]],
    *,
    deaf: frozenset[int] = frozenset(),
    between: Callable[[], None] | None = None,
) -> tuple[list[AnyDocument], list[EstimationWorker]]:
    """Documents of a run whose worker lives through those batches; samples of the `deaf` ones reach only the log."""
    bus = LocalBus()
    log = MemoryLog(bus)
    seen: dict[str, AnyDocument] = {}
    workers = []
    first = encode_event(LimitsApplied(run="r1", t_ns=0, revision="R", limits=LIMITS, planned_s=600.0), "e", 0)
    with DurablePublisher(bus) as publisher:

        def see(document: AnyDocument) -> None:
            assert document.uid not in seen, "published twice"
            seen[document.uid] = document

        for number, life in enumerate(lives):
            worker = EstimationWorker(
                bus, publisher, every_s=60.0, on_document=see, log=log, checkpoint=path, checkpoint_every_s=0.05
            )
            workers.append(worker)
            if number == 0:
                bus.publish(event_key(PLACE), first)
            for start in life:
                if start in deaf:
                    log._on_message(KEY, encode_batch(batch(start)))
                else:
                    bus.publish(KEY, encode_batch(batch(start)))
            if number == len(lives) - 1:
                totals = (StreamTotal(unit="U1", signal="rate", epoch=str(UUID(int=1)), samples=60_000),)
                bus.publish(event_key(PLACE), encode_event(RunEnded(run="r1", t_ns=10**12, totals=totals), "e", 1))
                worker.close()
            else:
                deadline = time.monotonic() + 10
                while between is not None and worker.counts.checkpoints < 2 and time.monotonic() < deadline:
                    time.sleep(0.01)
                worker.kill()
                if between is not None:
                    between()
    return list(seen.values()), workers


def sorted_documents(documents: list[AnyDocument]) -> list[AnyDocument]:
    return sorted(documents, key=lambda document: document.uid)


STARTS = list(range(0, 60_000, 500))
