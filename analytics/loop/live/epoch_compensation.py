"""Takes off a live signal what its error model predicts: raw samples and channels in, compensated samples out."""

from collections import deque
from uuid import UUID, uuid5

import numpy as np

from analytics.loop.blocks.channels import standard_unit
from analytics.loop.blocks.run_blocks import Channel
from analytics.loop.model.live_terms import (
    LIVE_BLOCK_S,
    LOOK_AHEAD_BLOCKS,
    TIME_SINCE_POWER_ON,
    live_blocks,
    live_part,
    middles_s,
    needed_channels,
    predicted,
)
from analytics.loop.model.model_registry import ModelVersion
from stream.batch import FloatArray, IntArray, SampleBatch
from stream.errors import BadInput
from stream.quantities import report_unit

SUFFIX = "_compensated"
PATIENCE_S = 600.0
"""So far behind the signal a channel may be; one that is further behind is taken to stand still."""
PATIENCE_BATCHES = 3.0
"""Nor fewer than so many of the longest batches: an imported file of slow samples comes in pieces of hours."""

_BLOCK_NS = round(LIVE_BLOCK_S * 1e9)
# each time the whole run is gone through anew, which in long ones must not be done too often
_EVERY_BLOCKS = 6
_EVERY_PART = 500
_FINER = 10.0
_INT32 = np.iinfo(np.int32)


def compensated_epoch(raw: UUID, run: str, model: str, first_seq: int) -> UUID:
    """Epoch of the compensated samples: the same whenever the same samples are compensated by the same model."""
    return uuid5(raw, f"{run}/{model}/{first_seq}")


class ChannelBlocks:
    """Means of a channel over blocks, whatever pieces its readings come in.

    Parameters
    ----------
    name: Of the channel.
    t0_ns: Where the first block begins.
    """

    def __init__(self, name: str, t0_ns: int) -> None:
        self._name = name
        self._t0_ns = t0_ns
        self._sums = np.zeros(64)
        self._counts = np.zeros(64, np.int64)
        self.last_ns: int | None = None
        self.unit_of_measure = ""
        self.is_read = False

    def take(self, batch: SampleBatch) -> None:
        """Take in readings; those before the first block do not count.

        Raises
        ------
        BadInput: If they are in another unit of measure than those before.
        """
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
        np.add.at(self._sums, slots, value[is_in])  # one after the other: the sum is that of the readings alone
        np.add.at(self._counts, slots, 1)
        self.is_read = True

    def known_blocks(self, horizon_ns: int) -> int:
        """How many blocks from the first on will not change any more, readings up to a moment having come."""
        closed = min(int((horizon_ns - self._t0_ns) // _BLOCK_NS), len(self._counts))
        while closed > 0 and self._counts[closed - 1] == 0:
            closed -= 1
        return max(closed, 0)

    def channel(self, blocks: int) -> Channel:
        """The channel in the first blocks; between readings on the line between them, beyond them as the nearest."""
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

    What comes out is a function of the samples alone, not of how they were cut or when they came, as long as channels
    are not further behind than `patience_s`. A batch goes out one to two minutes after it came, since a slope of a
    channel looks so far ahead; in long runs up to 0.2 % of the run later (three minutes in a day). What moves within
    blocks of 5 s is not compensated.

    Parameters
    ----------
    version: The model.
    first: The first raw samples of the power-on in the run; they are still to be taken.
    power_on_ns: When the unit was powered on; by default at its first sample.
    """

    def __init__(self, version: ModelVersion, first: SampleBatch, power_on_ns: int | None = None) -> None:
        self.version = version
        self.epoch = compensated_epoch(first.epoch, first.run, version.hash, first.seq)
        self.raw_epoch = first.epoch
        self.signal = first.signal + SUFFIX
        self.first_seq = self.next_seq = first.seq
        self.unit, self.run = first.unit, first.run
        self._name = (first.unit, first.run, first.signal)
        self._model = live_part(version.model)
        self._result_unit, self._factor = report_unit(first.unit_of_measure)
        if version.model.unit_of_measure not in (None, self._result_unit):
            raise BadInput(
                f"run {first.run}, unit {first.unit}: {first.signal} is in {first.unit_of_measure}, its error model in "
                f"{version.model.unit_of_measure}: trace the unit anew"
            )
        self.t0_ns = first.t0_ns
        self._power_on_ns = first.t0_ns if power_on_ns is None else power_on_ns
        names = needed_channels(self._model)
        self._has_time = TIME_SINCE_POWER_ON in names
        self._sources: dict[str, dict[tuple[int, str], ChannelBlocks]] = {
            name: {} for name in names if name != TIME_SINCE_POWER_ON
        }
        self._channels: dict[str, ChannelBlocks] = {}
        self._waiting: deque[SampleBatch] = deque()
        self._raw_ns = first.t0_ns
        self._longest_ns = 0
        self._correction = np.empty(0)
        self._held: dict[str, float] = {}

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels whose readings are to be taken in."""
        return tuple(self._sources)

    @property
    def lacking(self) -> dict[str, str]:
        """Channels that it cannot do with, and why: nothing has come, or from several instruments."""
        found = {}
        for name, sources in self._sources.items():
            if name in self._channels:
                continue
            best = _best(sources)
            if not best:
                found[name] = "nothing of it was recorded"
            elif len(best) > 1:
                found[name] = f"several instruments give it: {', '.join(sorted(unit for _, unit in best))}"
        return found

    def newly_held(self) -> dict[str, float]:
        """Channels that are taken to stand still from now on, and since when, seconds from the first sample."""
        found, self._held = {name: at for name, at in self._held.items() if at >= 0.0}, dict.fromkeys(self._held, -1.0)
        return found

    def take_reading(self, name: str, batch: SampleBatch, rank: int) -> None:
        """Take in readings of a channel; of its sources those of the highest rank are used."""
        source = (rank, batch.unit)
        if source not in self._sources[name]:
            self._sources[name][source] = ChannelBlocks(name, self.t0_ns)
        self._sources[name][source].take(batch)
        self._longest_ns = max(self._longest_ns, batch.last_ns - batch.t0_ns)

    @property
    def patience_s(self) -> float:
        """How far behind a channel may be, seconds of the signal."""
        return max(PATIENCE_S, PATIENCE_BATCHES * self._longest_ns / 1e9)

    def take(self, batch: SampleBatch) -> None:
        """Take in raw samples, which follow each other."""
        self._waiting.append(batch)
        self.next_seq = batch.next_seq
        self._raw_ns = max(self._raw_ns, batch.last_ns)
        self._longest_ns = max(self._longest_ns, batch.last_ns - batch.t0_ns)

    def due(self, *, is_last: bool = False) -> list[SampleBatch]:
        """The compensated samples that can be told now, each batch with the numbers and times of the raw one.

        Parameters
        ----------
        is_last: Nothing comes any more.
        """
        if self.lacking:
            return []
        self._correct(is_last=is_last)
        ready = []
        while self._waiting and (is_last or self._block_of(self._waiting[0].last_ns) < len(self._correction)):
            ready.append(self._compensated(self._waiting.popleft()))
        return ready

    def _block_of(self, t_ns: int) -> int:
        """The block behind whose middle a moment is not any more; its value is needed to interpolate."""
        return int(-((self.t0_ns + _BLOCK_NS // 2 - t_ns) // _BLOCK_NS))

    def _correct(self, *, is_last: bool) -> None:
        """Evaluate the model on the blocks that will not change any more."""
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
            settled = blocks - LOOK_AHEAD_BLOCKS
        done = len(self._correction)
        if settled - done < (1 if is_last else max(_EVERY_BLOCKS, settled // _EVERY_PART)):
            return
        self._channels = used  # by now every source has come, and which is used stays
        channels = {name: each.channel(blocks) for name, each in used.items()}
        if self._has_time:
            since_s = middles_s(blocks) + (self.t0_ns - self._power_on_ns) / 1e9
            channels[TIME_SINCE_POWER_ON] = Channel(since_s, np.zeros(blocks), "s")
        found = predicted(self._model, live_blocks(self._name, self.t0_ns, self._result_unit, channels, blocks))
        self._correction = np.concatenate([self._correction, found[done:settled]])

    def _compensated(self, batch: SampleBatch) -> SampleBatch:
        middle = (batch.time_array - self.t0_ns) / _BLOCK_NS - 0.5
        at = np.clip(middle, 0.0, len(self._correction) - 1.0)
        correction = np.interp(at, np.arange(len(self._correction)), self._correction) / self._factor
        values = batch.value_array - correction
        counts, scale = _counts(batch, values)
        return SampleBatch(
            unit=batch.unit,
            signal=self.signal,
            run=batch.run,
            epoch=self.epoch,
            seq=batch.seq - self.first_seq,
            t0_ns=batch.t0_ns,
            dt_ns=batch.dt_ns,
            unit_of_measure=batch.unit_of_measure,
            counts=counts,
            values=values if counts is None else None,
            times_ns=batch.times_ns,
            irregular=batch.irregular,
            scale=scale,
            offset=batch.offset if counts is not None else 0.0,
            flags=batch.flags,
        )


def _best(sources: dict[tuple[int, str], ChannelBlocks]) -> list[tuple[int, str]]:
    """The sources of the highest rank of which something has come."""
    read = [source for source, each in sources.items() if each.is_read]
    highest = max((rank for rank, _ in read), default=0)
    return [source for source in read if source[0] == highest]


def _counts(
    batch: SampleBatch, values: FloatArray
) -> "tuple[np.ndarray[tuple[int], np.dtype[np.int32]] | None, float]":
    """Values as counts of a tenth of the raw ones; None where the raw ones are no counts, or these would not fit."""
    if batch.counts is None or batch.scale == 0.0:
        return None, 1.0
    scale = batch.scale / _FINER
    counts: IntArray | FloatArray = np.rint((values - batch.offset) / scale)
    if counts.min() < _INT32.min or counts.max() > _INT32.max:
        return None, 1.0
    return counts.astype(np.int32), scale
