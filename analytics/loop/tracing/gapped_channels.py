"""Channels with gaps: if dropping their gaps would affect other effects, their effects are tested where they exist."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.left_out import TOLD, LeftOut, Loss, left_out
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.registry import effect, effects_for
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.whitening.stack import MOST_LOST, common_channels, known_blocks
from stream.batch import BoolArray

LEAST_KNOWN = 0.2
"""Least share of the blocks in which a channel must have a value for its effects to be tested."""
MOST_GROUPS = 8
"""Largest number of additional traces; each costs as much as that of all blocks."""
_NO_VALUE = Bilingual(
    "it has no value there; effects that read it are tested where it has one", "该处无值；在有值处检验读取该通道的效应"
)


@dataclass(frozen=True)
class GappedChannels:
    """Channels with gaps in the same blocks.

    Parameters
    ----------
    share: Share of the blocks in which they have no value.
    runs: All runs, without other channels with gaps.
    """

    channels: tuple[str, ...]
    share: float
    runs: tuple[RunBlocks, ...]

    def limit(self) -> Bilingual:
        """Caveat of a diagnosis of these channels."""
        names = ", ".join(self.channels)
        return Bilingual(
            f"channel {names} has gaps: this diagnosis is of the blocks in which it has a value",
            f"通道{names}有缺段：本诊断只针对其有值的数据块",
        )

    def left_out(self) -> LeftOut:
        """The blocks without a value."""
        names = ", ".join(self.channels)
        return LeftOut(Bilingual(f"the blocks of channel {names}", f"通道{names}的数据块"), self.share, _NO_VALUE)


def gapped_channels(runs: Sequence[RunBlocks], model: ErrorModel) -> tuple[tuple[RunBlocks, ...], list[GappedChannels]]:
    """The runs without channels whose gaps would affect other effects, and these channels, fewest gaps first.

    These are gaps in a fifth of the blocks, of a kind of run, or of the excitation of another channel. Channels of the
    declared model stay.
    """
    needed = {channel for name in model.effects for channel in effect(name).needs}
    blocks = sum(map(len, runs))
    groups: dict[bytes, list[str]] = {}
    shares: dict[bytes, float] = {}
    for name in common_channels(runs):
        known = {run.run: known_blocks(run.channels[name]) for run in runs}
        share = 1.0 - sum(int(each.sum()) for each in known.values()) / max(1, blocks)
        if name in needed or not 0.0 < share <= 1.0 - LEAST_KNOWN or not _costs_much(runs, name, known, share):
            continue
        key = np.packbits(np.concatenate(list(known.values()))).tobytes()
        groups.setdefault(key, []).append(name)
        shares[key] = share
    gapped = {name for names in groups.values() for name in names}
    return _less(runs, gapped), [
        GappedChannels(tuple(groups[key]), shares[key], _less(runs, gapped - set(groups[key])))
        for key in sorted(groups, key=shares.__getitem__)
    ]


def joined(
    runs: Sequence[RunBlocks], some: Sequence[GappedChannels], every: Sequence[GappedChannels]
) -> GappedChannels:
    """Some of all channels with gaps as one, in the blocks in which each of them has a value."""
    names = tuple(name for each in some for name in each.channels)
    known = sum(int(np.logical_and.reduce([known_blocks(run.channels[name]) for name in names]).sum()) for run in runs)
    others = {name for each in every for name in each.channels} - set(names)
    return GappedChannels(names, 1.0 - known / sum(map(len, runs)), _less(runs, others))


def untested(
    runs: Sequence[RunBlocks], traced: Sequence[Sequence[RunBlocks]], gapped: Sequence[GappedChannels]
) -> dict[str, Bilingual]:
    """Effects with recorded channels that no trace tested, and why; `traced` are the runs of each trace."""
    tested = {name for each in traced for name in effects_for(each)}
    names = {name for each in gapped for name in each.channels}
    reasons = {}
    for name, its in effects_for(runs).items():
        if name not in tested:
            lacking = [channel for channel in its.needs if channel in names]
            why = Bilingual("have gaps in different blocks", "在不同数据块中有缺段")
            if len(lacking) < 2:
                why = Bilingual(
                    f"has gaps in other blocks than {MOST_GROUPS} more channels",
                    f"的缺段与另外{MOST_GROUPS}个通道所在数据块不同",
                )
            reasons[name] = Bilingual(f"{', '.join(lacking)} {why}", f"{'、'.join(lacking)}{why.zh}")
    return reasons


def _costs_much(runs: Sequence[RunBlocks], name: str, known: dict[str, BoolArray], share: float) -> bool:
    if share > MOST_LOST:
        return True
    lost = left_out(runs, [Loss(Bilingual("", ""), {run: ~each for run, each in known.items()})])
    return any(each.share >= TOLD and each.what != f"the excitation of {name}" for each in lost)


def _less(runs: Sequence[RunBlocks], names: set[str]) -> tuple[RunBlocks, ...]:
    """Runs without these channels."""
    if not names:
        return tuple(runs)
    return tuple(
        replace(run, channels={name: each for name, each in run.channels.items() if name not in names}) for run in runs
    )
