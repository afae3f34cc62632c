"""A recorder in memory and a bus that loses messages."""

import random
import threading
import time
from collections.abc import Callable
from uuid import UUID

import numpy as np

from stream.batch import SampleBatch
from stream.errors import WireError
from stream.events import decode_event
from stream.identity import ACKNOWLEDGEMENT_KEY, EVERYTHING, Place, sample_key
from stream.transport.bus import LocalBus
from stream.wire.acknowledgement import StreamId, StreamPosition, encode_acknowledgement
from stream.wire.batches import decode_batch

PLACE = Place("plant", "bench")


KEY = sample_key(PLACE, "U1", "rate")


N = 100


def batch(i: int, epoch: int = 1, unit: str = "U1") -> SampleBatch:
    values = np.arange(i * N, (i + 1) * N, dtype=np.float64)
    return SampleBatch(unit, "rate", "r1", UUID(int=epoch), i * N, i * N * 10**6, 10**6, "deg/s", values=values)


class StandIn:
    """Takes what a recorder takes, in memory; it can be stopped, paused, and made to forget what is not durable."""

    def __init__(self, bus: LocalBus, *, acknowledges: bool = True) -> None:
        self._bus = bus
        self._lock = threading.Lock()
        self.acknowledges = acknowledges
        self.is_stopped = False
        self.paused = ""
        self.marks: dict[StreamId, int] = {}
        self.values: dict[StreamId, list[float]] = {}
        self.arrived: list[tuple[StreamId, int]] = []
        self.duplicates = 0
        bus.subscribe(EVERYTHING, self._take)

    def _take(self, key: str, payload: bytes) -> None:
        if self.is_stopped:
            return
        with self._lock:
            answer = self._answer(key, payload)
        if answer is not None and (self.acknowledges or answer.rewind):
            self._bus.publish(ACKNOWLEDGEMENT_KEY, encode_acknowledgement("store", (answer,)))

    def _answer(self, key: str, payload: bytes) -> StreamPosition | None:
        if self.paused:
            return None
        try:
            sent = decode_batch(payload)
            stream, seq, after, values = StreamId(key, sent.epoch.hex), sent.seq, sent.next_seq, sent.value_array
        except WireError:
            event = decode_event(payload)
            stream, seq, after, values = StreamId(key, event.epoch), event.seq, event.seq + 1, np.zeros(1)
        self.arrived.append((stream, seq))
        expected = self.marks.get(stream, 0)
        if seq > expected:
            return StreamPosition(key, stream.epoch, expected, rewind=True)
        if seq == expected:
            self.marks[stream] = after
            self.values.setdefault(stream, []).extend(values.tolist())
        else:
            self.duplicates += 1
        return StreamPosition(key, stream.epoch, self.marks[stream])

    def say(self, *positions: StreamPosition, store: str = "store") -> None:
        self._bus.publish(ACKNOWLEDGEMENT_KEY, encode_acknowledgement(store, positions, self.paused))

    def samples(self, epoch: int = 1) -> list[float]:
        return self.values.get(StreamId(KEY, UUID(int=epoch).hex), [])


class LossyBus(LocalBus):
    """Loses, doubles and delays."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self._random = random.Random(seed)
        self._late: list[tuple[str, bytes]] = []

    def publish(self, key: str, payload: bytes) -> None:
        with self._lock:
            draw = self._random.random()
            if draw < 0.1:
                return
            if draw < 0.15:
                self._late.append((key, payload))
                return
            late, self._late = self._late, []
        for each in [(key, payload), *([(key, payload)] if draw > 0.9 else []), *late]:
            super().publish(*each)


def until(condition: Callable[[], object], patience_s: float = 20.0) -> None:
    deadline = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline, "it did not come to it"
        time.sleep(0.005)
