"""A source that samples in real time, and what a recorder has acknowledged of it, for tests and benchmarks."""

import threading
import time
from types import TracebackType
from typing import Self
from uuid import uuid4

import numpy as np

from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.events import EstimatePoint, EstimatePublished
from stream.identity import ACKNOWLEDGEMENT_KEY, EstimateKey, Place, SampleKey, estimate_key, parse_key, sample_key
from stream.transport.zenoh_bus import ZenohBus
from stream.wire.acknowledgement import decode_acknowledgement

PLACE = Place("plant", "bench")
ESTIMATOR = "bias_stability_1s"


class LiveSource:
    """Sends batches of every unit, whose counts are their numbers, and an estimate after each turn of the units.

    `acknowledged` is the number after the last acknowledged sample of each unit, `estimates` how many estimates are.
    """

    def __init__(self, endpoint: str, *, units: int = 4, rate_hz: int = 1000, batch_s: float = 0.1) -> None:
        self.units = [f"U{number}" for number in range(units)]
        self._size, self._dt_ns, self._batch_s = round(rate_hz * batch_s), 10**9 // rate_hz, batch_s
        self._bus = ZenohBus(connect=[endpoint])
        self._publisher = DurablePublisher(self._bus, resend_after_s=0.5)
        self._lock = threading.Lock()
        self._acknowledged = dict.fromkeys(self.units, 0)
        self._estimates = 0
        self._stop = threading.Event()
        self._bus.subscribe(ACKNOWLEDGEMENT_KEY, self._on_acknowledgement)
        self._thread = threading.Thread(target=self._send)

    def acknowledged(self) -> tuple[dict[str, int], int]:
        """The number after the last acknowledged sample of each unit, and how many estimates are acknowledged."""
        with self._lock:
            return dict(self._acknowledged), self._estimates

    def stop(self) -> None:
        """Sample no more, and wait until everything is acknowledged."""
        self._stop.set()
        self._thread.join()
        self._publisher.drain()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._publisher.close()
        self._bus.close()

    def _send(self) -> None:
        epoch, seq, began, began_ns = uuid4(), 0, time.monotonic(), time.time_ns()
        while not self._stop.wait(max(0.0, began + (seq / self._size + 1) * self._batch_s - time.monotonic())):
            t0_ns = began_ns + seq * self._dt_ns
            counts = np.arange(seq, seq + self._size, dtype=np.int32)
            for unit in self.units:
                batch = SampleBatch(unit, "rate", "live", epoch, seq, t0_ns, self._dt_ns, "deg/s", counts=counts)
                self._publisher.send_batch(sample_key(PLACE, unit, "rate"), batch)
            seq += self._size
            points = (EstimatePoint(tau_s=1.0, value=float(seq), lo=0.0, hi=1.0, edf=1.0, n=1),)
            published = EstimatePublished(
                run="live", t_ns=t0_ns, unit="U0", signal="rate", estimator=ESTIMATOR, unit_of_measure="deg/s",
                confidence=0.95, samples=seq, missing=0, sample_interval_s=self._dt_ns / 1e9, points=points,
            )  # fmt: skip
            self._publisher.send_event(estimate_key(PLACE, "U0", "rate", ESTIMATOR), published)

    def _on_acknowledgement(self, _key: str, payload: bytes) -> None:
        with self._lock:
            for position in decode_acknowledgement(payload).positions:
                key = parse_key(position.key)
                if isinstance(key, EstimateKey):
                    self._estimates = max(self._estimates, position.next_seq)
                elif isinstance(key, SampleKey):
                    self._acknowledged[key.unit] = max(self._acknowledged[key.unit], position.next_seq)
