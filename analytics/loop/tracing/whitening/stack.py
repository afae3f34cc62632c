"""All blocks of one unit, its runs concatenated, as rows of a regression; the prior of their noise."""

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.notes.left_out import LeftOut, Loss, left_out
from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.whitening.whitener import NoiseModel, Whitener
from stream.batch import BoolArray, FloatArray, IntArray

MOST_LOST = 0.2  # largest share of the blocks that may be dropped because a channel has gaps
SEGMENTS = 9
NO_MODEL_VALUE = Bilingual("a channel of the declared model has no value there", "声明模型所需的某通道在该处无值")
NO_CHANNEL_VALUE = Bilingual("a channel has no value there", "某通道在该处无值")
DECLARED_SPREAD = np.array([0.1, 0.7, 0.7, 0.7])  # of log N, B, K, turn-on scatter about the declared values
ESTIMATED_SPREAD = np.array([0.3, 1.5, 1.5, 1.5])  # the same about values estimated from the data
SINGLE_RUN_SPREAD = np.array([0.3, 0.3, 0.3, 1.5])  # the same for a single run


@dataclass(frozen=True)
class Stack:
    """Blocks of one unit that are used, and their runs.

    Columns of an effect are computed on whole runs, then cut to the blocks used: a lag or a hysteresis depends on the
    blocks before.
    """

    runs: tuple[RunBlocks, ...]  # in the order of time
    rows: tuple[IntArray, ...]  # the blocks used of each run
    replicate: IntArray  # shape (n,); number of the replicate of each block: its run, or a segment of the only run
    replicates: tuple[str, ...]  # their names
    design: FloatArray  # shape (n, p); columns of the declared model

    def __len__(self) -> int:
        return self.replicate.size

    @property
    def value(self) -> FloatArray:
        """Mean of the signal in each block."""
        return self.column(lambda run: run.value)

    def column(self, of_run: Callable[[RunBlocks], FloatArray]) -> FloatArray:
        """A function of each run, at the blocks used."""
        return np.concatenate([of_run(run)[rows] for run, rows in zip(self.runs, self.rows, strict=True)])

    @cached_property
    def slot(self) -> IntArray:
        """Number of each block on the grid of its run."""
        return np.concatenate([run.slot[rows] for run, rows in zip(self.runs, self.rows, strict=True)])

    @cached_property
    def run_number(self) -> IntArray:
        """Number of the run of each block."""
        return np.repeat(np.arange(len(self.runs)), [rows.size for rows in self.rows])

    @property
    def steps(self) -> IntArray:
        """Blocks since the preceding block; 0 at the first block of each run."""
        number = self.run_number
        steps = np.diff(self.slot, prepend=0)
        steps[np.diff(number, prepend=-1) != 0] = 0
        return steps

    @property
    def noise_model(self) -> NoiseModel:
        """Noise model of these blocks."""
        lengths = [run.slot[-1] + 1 - run.slot[0] for run in self.runs]
        return NoiseModel(self.runs[0].block_s, float(max(lengths)) * self.runs[0].block_s)

    def part(self, chosen: BoolArray) -> "Stack":
        """The chosen blocks; runs without any are dropped."""
        ends = np.cumsum([rows.size for rows in self.rows])[:-1]
        kept = [rows[mask] for rows, mask in zip(self.rows, np.split(chosen, ends), strict=True)]
        pairs = [(run, rows) for run, rows in zip(self.runs, kept, strict=True) if rows.size]
        numbers, replicate = np.unique(self.replicate[chosen], return_inverse=True)
        return Stack(
            runs=tuple(run for run, _ in pairs),
            rows=tuple(rows for _, rows in pairs),
            replicate=replicate,
            replicates=tuple(self.replicates[number] for number in numbers),
            design=self.design[chosen],
        )

    def of_replicates(self, names: Sequence[str]) -> BoolArray:
        """Mark the blocks of these replicates."""
        wanted = np.array([name in names for name in self.replicates])
        return np.asarray(wanted[self.replicate])


@dataclass(frozen=True)
class StackReport:
    """Blocks and channels that were dropped."""

    limits: tuple[Bilingual, ...]
    lost_channels: dict[str, Bilingual]  # not used, and why
    left_out: tuple[LeftOut, ...] = ()

    def with_left_out(self, more: Sequence[LeftOut]) -> "StackReport":
        """Add parts that the reduction left out."""
        both = (*more, *self.left_out)
        return replace(self, left_out=tuple(sorted(both, key=lambda each: not each.is_grave)))


def stacked(runs: Sequence[RunBlocks], model: ErrorModel, insisted: Collection[str] = ()) -> tuple[Stack, StackReport]:
    """Blocks of one unit in which the declared model and all channels have values.

    Channels with gaps are kept if at most 20 % of the blocks have to be dropped for them, or if they are `insisted` on.
    """
    ordered = sorted(runs, key=_order)
    designs = [model.columns(run) for run in ordered]
    modelled = [
        np.isfinite(design).all(axis=1) & np.isfinite(run.value) for run, design in zip(ordered, designs, strict=True)
    ]
    blocks = sum(map(len, ordered))
    kept, lost, dropped = _without_gaps(ordered, modelled, insisted)
    limits, losses = [], []
    for count, masks, why in (
        (blocks - sum(map(np.count_nonzero, modelled)), modelled, NO_MODEL_VALUE),
        (dropped, kept, NO_CHANNEL_VALUE),
    ):
        if count:
            text = Bilingual(
                f"{count} of {blocks} blocks left out: {why}", f"略去{blocks}个数据块中的{count}个：{why.zh}"
            )
            limits.append(text)
            losses.append(Loss(why, {run.run: ~mask for run, mask in zip(ordered, masks, strict=True)}))
    limits += [
        Bilingual(f"channel {name} not used: {reason}", f"未使用通道{name}：{reason.zh}")
        for name, reason in lost.items()
    ]
    stack = Stack(
        runs=tuple(ordered),
        rows=tuple(np.arange(len(run)) for run in ordered),
        replicate=np.repeat(np.arange(len(ordered)), list(map(len, ordered))),
        replicates=tuple(run.run for run in ordered),
        design=np.concatenate(designs or [np.empty((0, 0))]),
    )
    used = stack.part(np.concatenate(kept)) if ordered else stack
    return used, StackReport(tuple(limits), lost, left_out(ordered, losses))


def _order(run: RunBlocks) -> tuple[int, tuple[tuple[int, str], ...]]:
    """Sorts runs by date; those without one by name, with numbers by their value: ``run2`` is before ``run10``."""
    parts = re.split(r"(\d+)", run.run)
    name = tuple((int(part) if number % 2 else 0, "" if number % 2 else part) for number, part in enumerate(parts))
    return run.t0_ns if run.is_date_known else 0, name


def in_segments(stack: Stack) -> Stack:
    """The only run cut into contiguous segments of equal length, as replicates."""
    segments = min(SEGMENTS, len(stack) // 8)
    replicate = np.minimum(np.arange(len(stack)) * segments // len(stack), segments - 1)
    names = tuple(f"{stack.runs[0].run}#{number + 1}" for number in range(segments))
    return replace(stack, replicate=replicate, replicates=names)


def _without_gaps(
    runs: Sequence[RunBlocks], kept: Sequence[BoolArray], insisted: Collection[str]
) -> tuple[list[BoolArray], dict[str, Bilingual], int]:
    """Blocks in which all kept channels have values, the channels not kept, and the number of blocks dropped."""
    before = sum(map(np.count_nonzero, kept))
    present = {name: [known_blocks(run.channels[name]) for run in runs] for name in common_channels(runs)}
    gaps = {
        name: sum(int(np.count_nonzero(k & ~p)) for k, p in zip(kept, masks, strict=True))
        for name, masks in present.items()
    }
    current, lost = list(kept), dict[str, Bilingual]()
    for name in sorted(present, key=gaps.__getitem__):
        trial = [k & p for k, p in zip(current, present[name], strict=True)]
        if name not in insisted and before - sum(map(np.count_nonzero, trial)) > MOST_LOST * before:
            lost[name] = Bilingual(
                f"no value in {gaps[name]} of {before} blocks", f"{before}个数据块中有{gaps[name]}个无值"
            )
        else:
            current = trial
    return current, lost, before - sum(map(np.count_nonzero, current))


def known_blocks(channel: Channel) -> BoolArray:
    """Mark the blocks in which a channel has a value; an angle is checked by its phasors."""
    value = channel.mean[None] if channel.phasors is None else channel.phasors
    return np.asarray(np.isfinite(value).all(axis=0))


def common_channels(runs: Sequence[RunBlocks]) -> list[str]:
    """Channels that all runs have."""
    return sorted(set.intersection(*(set(run.channels) for run in runs))) if runs else []


@dataclass(frozen=True)
class NoisePrior:
    """Log-normal prior of the noise; a coefficient of zero stays zero."""

    center: ModelNoise  # declared, or estimated from the data
    spread: FloatArray  # shape (4,); standard deviations of the logarithms
    turn_on_is_declared: bool = True  # else the scatter was estimated from these runs, and may be an effect

    @property
    def values(self) -> FloatArray:
        """N, B, K and turn-on scatter."""
        return as_array(self.center)

    def log_density(self, noise: ModelNoise) -> float:
        """Logarithm of the density, up to a constant."""
        active = self.values > 0
        apart = np.log(as_array(noise)[active] / self.values[active]) / self.spread[active]
        return -0.5 * float(apart @ apart)


def as_array(noise: ModelNoise) -> FloatArray:
    """N, B, K and turn-on scatter as an array."""
    return np.array([noise.N, noise.B, noise.K, noise.turn_on])


def from_array(values: FloatArray) -> ModelNoise:
    """Inverse of `as_array`."""
    n, b, k, turn_on = map(float, values)
    return ModelNoise(N=n, B=b, K=k, turn_on=turn_on)


@dataclass(frozen=True)
class UnitRecord:
    """The blocks of one unit as the filter reads them."""

    stack: Stack
    value: FloatArray  # shape (n,); the signal
    design: FloatArray  # shape (n, p); columns of the declared model
    steps: IntArray  # shape (n,); see `Whitener`
    noise_model: NoiseModel
    prior: NoisePrior
    white: FloatArray  # shape (n,); white variance of each block relative to that of `prior.center`

    def __len__(self) -> int:
        return self.value.size

    @property
    def unit(self) -> str:
        """The unit's serial number."""
        return self.stack.runs[0].unit

    def whitener(self, noise: ModelNoise) -> Whitener:
        """The filter for this noise."""
        return Whitener.of(self.noise_model, noise, self.steps, self.white)
