"""Channels with gaps that would cost other effects much: their effects are looked for where they have readings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from analytics.loop.blocks.left_out import TOLD, LeftOut, Loss, left_out
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.registry import effect, effects_for
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.stack import MOST_LOST, common_channels, known_blocks
from stream.batch import BoolArray

LEAST_KNOWN = 0.2
"""Share of the blocks in which a channel must have a value, for its effects to be looked for."""
MOST_GROUPS = 8
"""Traces beside that of all blocks; each costs as much as that."""


@dataclass(frozen=True)
class GappedChannels:
    """Channels that have their gaps in the same blocks.

    Parameters
    ----------
    channels: The channels.
    share: Part of the blocks in which they have no value.
    runs: All runs, without other channels with gaps.
    """

    channels: tuple[str, ...]
    share: float
    runs: tuple[RunBlocks, ...]

    def limit(self) -> str:
        """Say that the other blocks take no part in this diagnosis."""
        return f"channel {', '.join(self.channels)} has gaps: this diagnosis is of the blocks in which it has a value"

    def left_out(self) -> LeftOut:
        """What that leaves out."""
        why = "it has no value there; effects that read it are looked for where it has"
        return LeftOut(f"the blocks of channel {', '.join(self.channels)}", self.share, why)


def gapped_channels(runs: Sequence[RunBlocks], model: ErrorModel) -> tuple[tuple[RunBlocks, ...], list[GappedChannels]]:
    """Return the runs without the channels whose gaps would cost other effects much, and these; fewest gaps first.

    A gap in a fifth of the blocks is much, or one that takes away a fifth of a kind of run or of the excitation of
    another channel. Channels of the declared model stay: without them there is no residual.

    Parameters
    ----------
    runs: All runs.
    model: The declared model.
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
    """Return several channels with gaps as one, for the blocks in which all of them have a value.

    Parameters
    ----------
    runs: With all channels.
    some: Those to be joined.
    every: All that have gaps.
    """
    names = tuple(name for each in some for name in each.channels)
    known = sum(int(np.logical_and.reduce([known_blocks(run.channels[name]) for name in names]).sum()) for run in runs)
    others = {name for each in every for name in each.channels} - set(names)
    return GappedChannels(names, 1.0 - known / sum(map(len, runs)), _less(runs, others))


def untried(
    runs: Sequence[RunBlocks], traced: Sequence[Sequence[RunBlocks]], gapped: Sequence[GappedChannels]
) -> dict[str, str]:
    """Return the effects whose channels are there and that no trace has looked for, each with the reason.

    Parameters
    ----------
    runs: With all channels.
    traced: The runs of each trace.
    gapped: All channels with gaps.
    """
    looked_for = {name for each in traced for name in effects_for(each)}
    names = {name for each in gapped for name in each.channels}
    reasons = {}
    for name, its in effects_for(runs).items():
        if name not in looked_for:
            lacking = [channel for channel in its.needs if channel in names]
            alone = f"has gaps in other blocks than {MOST_GROUPS} more channels"
            reasons[name] = f"{', '.join(lacking)} {'have gaps in different blocks' if len(lacking) > 1 else alone}"
    return reasons


def _costs_much(runs: Sequence[RunBlocks], name: str, known: dict[str, BoolArray], share: float) -> bool:
    if share > MOST_LOST:
        return True
    lost = left_out(runs, [Loss("", {run: ~each for run, each in known.items()})])
    return any(each.share >= TOLD and each.what != f"the excitation of {name}" for each in lost)


def _less(runs: Sequence[RunBlocks], names: set[str]) -> tuple[RunBlocks, ...]:
    """Runs without these channels."""
    if not names:
        return tuple(runs)
    return tuple(
        replace(run, channels={name: each for name, each in run.channels.items() if name not in names}) for run in runs
    )
