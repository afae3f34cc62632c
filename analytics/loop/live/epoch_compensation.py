"""Compensation of one signal of one power-on: raw samples and channel readings in, compensated samples out."""

from collections import deque
from dataclasses import replace
from uuid import UUID, uuid5

import numpy as np

from analytics.loop.blocks.reading.channels import standard_unit
from analytics.loop.blocks.run_blocks import Channel
from analytics.loop.model import live_terms
from analytics.loop.model.model_registry import ModelVersion
from stream.batch import CountArray, FloatArray, SampleBatch
from stream.errors import BadInput
from stream.quantities import report_unit

SUFFIX = "_compensated"
PATIENCE_S = 600.0  # largest delay of a channel behind the signal; a channel with a larger delay keeps its last value
PATIENCE_BATCHES = 3.0  # least delay in lengths of the longest batch: batches of imported slow samples last hours

_BLOCK_NS = round(live_terms.LIVE_BLOCK_S * 1e9)
# each evaluation covers the whole run, so that it must be rare in long runs
_EVERY_BLOCKS = 6
_EVERY_PART = 500
_FINER = 10.0
_INT32 = np.iinfo(np.int32)


def compensated_epoch(raw: UUID, run: str, model: str, first_seq: int) -> UUID:
    """Epoch of the compensated samples; a function of the raw samples and the model."""
    return uuid5(raw, f"{run}/{model}/{first_seq}")


class ChannelBlocks:
    """Block means of a channel, independent of how its readings are batched; the first block begins at `t0_ns`."""

    def __init__(self, name: str, t0_ns: int) -> None:
        self._name = name
        self._t0_ns = t0_ns
        self._sums = np.zeros(64)
        self._counts = np.zeros(64, np.int64)
        self.last_ns: int | None = None
        self.unit_of_measure = ""
        self.is_read = False

    def take(self, batch: SampleBatch) -> None:
        """Add readings, without those before the first block; BadInput if their unit of measure differs from before."""
        unit, factor, offset = standard_unit(self._name, batch.unit_of_measure)
        if self.unit_of_measure not in ("", unit):
            raise BadInput(
                f"run {batch.run}, {batch.unit}: channel {self._name} changes from {self.unit_of_measure} to {unit}"
            )
        self.unit_of_measure = unit
        t_ns, value = batch.time_array, batch.value_array * factor + offset
        self.last_ns = int(t_ns[-1]) if self.last_ns is None else max(self.last_ns, int(t_ns[-1]))
        is_in = np.isfinite(value) & (t_ns >= self._t0_ns)
        slots = (t_ns[is_in] - self._t0_ns) // _BLOCK_NS
        if not slots.size:
            return
        self._reserve(int(slots.max()) + 1)
        np.add.at(self._sums, slots, value[is_in])  # in order, so that the sum does not depend on the batches
        np.add.at(self._counts, slots, 1)
        self.is_read = True

    def known_blocks(self, horizon_ns: int) -> int:
        """Number of leading blocks that are final once readings up to a time have arrived."""
        closed = min(int((horizon_ns - self._t0_ns) // _BLOCK_NS), len(self._counts))
        while closed > 0 and self._counts[closed - 1] == 0:
            closed -= 1
        return max(closed, 0)

    def channel(self, blocks: int) -> Channel:
        """The channel in the first blocks, linearly interpolated between readings and constant beyond them."""
        self._reserve(blocks)
        counts = self._counts[:blocks]
        known = np.flatnonzero(counts)
        means = self._sums[known] / counts[known]
        return Channel(np.interp(np.arange(blocks), known, means), np.zeros(blocks), self.unit_of_measure)

    def _reserve(self, blocks: int) -> None:
        if blocks > len(self._sums):
            more = max(blocks, 2 * len(self._sums)) - len(self._sums)
            self._sums = np.concatenate([self._sums, np.zeros(more)])
            self._counts = np.concatenate([self._counts, np.zeros(more, np.int64)])


class EpochCompensation:
    """Compensates one signal of one power-on in one run.

    The output is a function of the samples, not of their batching or arrival, if no channel is delayed by more than
    `patience_s`. A batch is ready one to two minutes after its arrival, since the slope of a channel needs later
    readings; in long runs up to 0.2 % of the run later (three minutes in a day). Changes within blocks of 5 s are not
    compensated. `first` are the first raw samples of the power-on in the run, not taken yet; without `power_on_ns` the
    power-on is at the first of them.
    """

    def __init__(self, version: ModelVersion, first: SampleBatch, power_on_ns: int | None = None) -> None:
        self.version = version
        self.epoch = compensated_epoch(first.epoch, first.run, version.hash, first.seq)
        self.raw_epoch = first.epoch
        self.signal = first.signal + SUFFIX
        self.first_seq = self.next_seq = first.seq
        self.unit, self.run = first.unit, first.run
        self._name = (first.unit, first.run, first.signal)
        self._model = live_terms.live_part(version.model)
        self._result_unit, self._factor = report_unit(first.unit_of_measure)
        if version.model.unit_of_measure not in (None, self._result_unit):
            raise BadInput(
                f"run {first.run}, unit {first.unit}: {first.signal} is in {first.unit_of_measure}, its error model in "
                f"{version.model.unit_of_measure}: diagnose the unit again"
            )
        self.t0_ns = first.t0_ns
        self._power_on_ns = first.t0_ns if power_on_ns is None else power_on_ns
        names = live_terms.needed_channels(self._model)
        self._has_time = live_terms.TIME_SINCE_POWER_ON in names
        self._sources: dict[str, dict[tuple[int, str], ChannelBlocks]] = {
            name: {} for name in names if name != live_terms.TIME_SINCE_POWER_ON
        }
        self._channels: dict[str, ChannelBlocks] = {}
        self._waiting: deque[SampleBatch] = deque()
        self._raw_ns = first.t0_ns
        self._longest_ns = 0
        self._correction = np.empty(0)
        self._held: dict[str, float] = {}

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that the model reads."""
        return tuple(self._sources)

    @property
    def lacking(self) -> dict[str, str]:
        """Channels that are missing, and why: no readings, or readings of several instruments."""
        found = {}
        for name, sources in self._sources.items():
            if name in self._channels:
                continue
            best = _best(sources)
            if not best:
                found[name] = "no reading was recorded"
            elif len(best) > 1:
                found[name] = f"several instruments record it: {', '.join(sorted(unit for _, unit in best))}"
        return found

    def newly_held(self) -> dict[str, float]:
        """Channels newly held at their last value, and since when, seconds from the first sample."""
        found, self._held = {name: at for name, at in self._held.items() if at >= 0.0}, dict.fromkeys(self._held, -1.0)
        return found

    def take_reading(self, name: str, batch: SampleBatch, rank: int) -> None:
        """Add readings of a channel; only its sources of the highest rank are used."""
        source = (rank, batch.unit)
        if source not in self._sources[name]:
            self._sources[name][source] = ChannelBlocks(name, self.t0_ns)
        self._sources[name][source].take(batch)
        self._longest_ns = max(self._longest_ns, batch.last_ns - batch.t0_ns)

    @property
    def patience_s(self) -> float:
        """Largest delay of a channel behind the signal, seconds."""
        return max(PATIENCE_S, PATIENCE_BATCHES * self._longest_ns / 1e9)

    def take(self, batch: SampleBatch) -> None:
        """Add the next raw samples."""
        self._waiting.append(batch)
        self.next_seq = batch.next_seq
        self._raw_ns = max(self._raw_ns, batch.last_ns)
        self._longest_ns = max(self._longest_ns, batch.last_ns - batch.t0_ns)

    def due(self, *, is_last: bool = False) -> list[SampleBatch]:
        """The compensated batches that are ready, with the numbers and times of the raw ones; all if `is_last`."""
        if self.lacking:
            return []
        self._correct(is_last=is_last)
        ready = []
        while self._waiting and (is_last or self._block_of(self._waiting[0].last_ns) < len(self._correction)):
            ready.append(self._compensated(self._waiting.popleft()))
        return ready

    def _block_of(self, t_ns: int) -> int:
        """The first block whose middle is not before a time; its value is needed to interpolate."""
        return int(-((self.t0_ns + _BLOCK_NS // 2 - t_ns) // _BLOCK_NS))

    def _correct(self, *, is_last: bool) -> None:
        """Evaluate the model on the final blocks."""
        used = self._channels or {name: sources[_best(sources)[0]] for name, sources in self._sources.items()}
        if is_last:
            settled = blocks = self._block_of(self._raw_ns) + 1
        else:
            patient_ns = self._raw_ns - round(self.patience_s * 1e9)
            blocks = int((self._raw_ns - self.t0_ns) // _BLOCK_NS)
            for name, each in used.items():
                assert each.last_ns is not None
                if each.last_ns >= patient_ns:
                    blocks = min(blocks, each.known_blocks(each.last_ns))
                else:
                    self._held.setdefault(name, (each.last_ns - self.t0_ns) / 1e9)
                    blocks = min(blocks, int((patient_ns - self.t0_ns) // _BLOCK_NS))
            settled = blocks - live_terms.LOOK_AHEAD_BLOCKS
        done = len(self._correction)
        if settled - done < (1 if is_last else max(_EVERY_BLOCKS, settled // _EVERY_PART)):
            return
        self._channels = used  # the sources are fixed from the first evaluation on
        channels = {name: each.channel(blocks) for name, each in used.items()}
        if self._has_time:
            since_s = live_terms.middles_s(blocks) + (self.t0_ns - self._power_on_ns) / 1e9
            channels[live_terms.TIME_SINCE_POWER_ON] = Channel(since_s, np.zeros(blocks), "s")
        found = live_terms.predicted(
            self._model, live_terms.live_blocks(self._name, self.t0_ns, self._result_unit, channels, blocks)
        )
        self._correction = np.concatenate([self._correction, found[done:settled]])

    def _compensated(self, batch: SampleBatch) -> SampleBatch:
        middle = (batch.time_array - self.t0_ns) / _BLOCK_NS - 0.5
        at = np.clip(middle, 0.0, len(self._correction) - 1.0)
        correction = np.interp(at, np.arange(len(self._correction)), self._correction) / self._factor
        values = batch.value_array - correction
        own = replace(batch, signal=self.signal, epoch=self.epoch, seq=batch.seq - self.first_seq)
        if (counts := _counts(batch, values)) is not None:
            return replace(own, counts=counts, scale=batch.scale / _FINER)
        return replace(own, counts=None, values=values, scale=1.0, offset=0.0)


def _best(sources: dict[tuple[int, str], ChannelBlocks]) -> list[tuple[int, str]]:
    """The sources of the highest rank that have readings."""
    read = [source for source, each in sources.items() if each.is_read]
    highest = max((rank for rank, _ in read), default=0)
    return [source for source in read if source[0] == highest]


def _counts(batch: SampleBatch, values: FloatArray) -> CountArray | None:
    """Values as counts of a tenth of the raw scale; None if the raw values are not counts, or if they overflow."""
    if batch.counts is None or batch.scale == 0.0:
        return None
    counts = np.rint((values - batch.offset) / (batch.scale / _FINER))
    return counts.astype(np.int32) if counts.min() >= _INT32.min and counts.max() <= _INT32.max else None
