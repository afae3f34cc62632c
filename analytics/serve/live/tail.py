"""Samples that only the log has so far, as they are on the wire: the newest minutes of each signal."""

import threading
import time
from collections import defaultdict
from collections.abc import Collection, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from storage.log.follower import ContinuedBatch
from stream.batch import FloatArray, IntArray
from stream.events import EstimatePublished
from stream.wire.batches import RawBatch
from stream.wire.count_residuals import join_batches
from stream.worker.limit_checks import ALLAN_DEVIATION

SignalName = tuple[str, str, str]
"""Unit, run, signal."""

# a request may still look at the version of the lake before
_KEPT_S = 15.0
_MOST_BYTES = 1 << 30


class LiveSamples(NamedTuple):
    """Samples of a signal that are not in the lake."""

    unit_of_measure: str
    sample_interval_s: float
    irregular: bool
    first_ns: int  # of all of them, whatever stretch is asked, and those that are no numbers
    last_ns: int
    t_ns: IntArray  # shape (n,), not ordered where epochs overlap
    values: FloatArray  # shape (n,); without those that are no numbers


class LiveTail:
    """Keeps messages of samples until the lake has them; of more than 1 GiB the oldest segments are left out."""

    def __init__(self) -> None:
        self._batches: dict[SignalName, list[tuple[str, RawBatch | ContinuedBatch]]] = defaultdict(list)
        self._bytes: dict[str, int] = defaultdict(int)  # by segment
        self._in_lake: dict[str, float] = {}  # segments, and since when
        self._taken: dict[SignalName, int] = defaultdict(int)
        self._curves: dict[SignalName, EstimatePublished] = {}
        self._lock = threading.Lock()

    def take(self, segment: str, raw: RawBatch | ContinuedBatch, size_bytes: int) -> None:
        """Keep a message of so many bytes."""
        head = raw.like.message
        name = (head.unit, head.run, head.signal)
        with self._lock:
            self._batches[name].append((segment, raw))
            self._taken[name] += 1
            self._bytes[segment] += size_bytes

    def take_estimate(self, document: EstimatePublished) -> None:
        """Keep the newest Allan deviation of a signal."""
        if document.estimator == ALLAN_DEVIATION and document.points:
            name = (document.unit, document.run, document.signal)
            with self._lock:
                self._curves[name] = document
                self._taken[name] += 1

    def curve(self, name: SignalName) -> EstimatePublished | None:
        """The newest Allan deviation of a signal that came since the server began."""
        return self._curves.get(name)

    def forget(self, in_lake: Collection[str]) -> None:
        """Leave out what has been in the lake for some seconds, and what is too much."""
        now_s = time.monotonic()
        with self._lock:
            self._in_lake = {each: self._in_lake.get(each, now_s) for each in self._bytes if each in in_lake}
            gone = {each for each, since_s in self._in_lake.items() if now_s - since_s > _KEPT_S}
            room = _MOST_BYTES
            for segment in sorted(self._bytes.keys() - gone, reverse=True):
                room -= self._bytes[segment]
                if room < 0:
                    gone.add(segment)
            if not gone:
                return
            for name in list(self._batches):
                kept = [each for each in self._batches[name] if each[0] not in gone]
                if kept:
                    self._batches[name] = kept
                else:
                    del self._batches[name]
            for segment in gone:
                del self._bytes[segment]

    def version(self, name: SignalName) -> int:
        """Number that grows with every message of a signal."""
        return self._taken.get(name, 0)

    def signals(self, unit: str, run: str) -> list[str]:
        """Signals of a unit in a run, of which it has samples."""
        with self._lock:
            return sorted(signal for of_unit, of_run, signal in self._batches if (of_unit, of_run) == (unit, run))

    def channels(self, run: str) -> dict[tuple[str, str], str]:
        """Units and signals of a run of which it has samples, with their unit of measure."""
        with self._lock:
            return {
                (unit, signal): batches[-1][1].like.message.unit_of_measure
                for (unit, of_run, signal), batches in self._batches.items()
                if of_run == run and batches
            }

    def samples(
        self, name: SignalName, in_lake: Collection[str], first_ns: int | None = None, stop_ns: int | None = None
    ) -> LiveSamples | None:
        """Samples of a stretch that segments in the lake do not have; None if it has no message of the signal."""
        # a copy at once, without the lock, which who follows the log takes for each message
        found = [raw for segment, raw in list(self._batches.get(name, ())) if segment not in in_lake]
        if not found:
            return None
        head = found[-1].like.message
        inside = [
            raw
            for raw in found
            if (first_ns is None or raw.last_ns >= first_ns) and (stop_ns is None or raw.t0_ns < stop_ns)
        ]
        parts = [_samples_of(list(own)) for _, own in groupby(inside, lambda raw: id(raw.like))]
        empty = np.empty(0)
        t_ns = np.concatenate([empty.astype(np.int64), *(times_ns for times_ns, _ in parts)])
        values = np.concatenate([empty, *(part for _, part in parts)])
        is_asked = np.isfinite(values)
        if first_ns is not None:
            is_asked &= t_ns >= first_ns
        if stop_ns is not None:
            is_asked &= t_ns < stop_ns
        ends = min(raw.t0_ns for raw in found), max(raw.last_ns for raw in found)
        return LiveSamples(
            head.unit_of_measure, head.dt_ns / 1e9, head.irregular, *ends, t_ns[is_asked], values[is_asked]
        )


def _samples_of(batches: Sequence[RawBatch | ContinuedBatch]) -> tuple[IntArray, FloatArray]:
    """Times and values of a batch that was read and those that continue it, which are read together."""
    alone = [batch.decoded() for batch in batches if isinstance(batch, RawBatch)]
    times_ns, values = [each.time_array for each in alone], [each.value_array for each in alone]
    if continued := [batch for batch in batches if isinstance(batch, ContinuedBatch)]:
        head, data = continued[0].like.message, [each.payload[each.begin : each.end] for each in continued]
        n = continued[0].place.next_seq - continued[0].place.seq  # of each, as their form is one
        t0_ns = np.array([each.t0_ns for each in continued])
        times_ns.append((t0_ns[:, None] + head.dt_ns * np.arange(n)).reshape(-1))
        if head.values:
            values.append(np.frombuffer(b"".join(data), "<f8"))
        else:
            counts = join_batches(data, np.full(len(data), n))
            values.append(np.multiply(counts, head.scale, dtype=np.float64) + head.offset)
    return np.concatenate(times_ns), np.concatenate(values)
