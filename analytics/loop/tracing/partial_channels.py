"""Channels that some runs lack, or that have gaps: their effects are tested in the remainder."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from analytics.loop.bilingual import Bilingual, listed
from analytics.loop.blocks.notes.left_out import REPORTED, LeftOut, Loss, left_out
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.registry import effect, effect_name, effects_for
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, FoundEffect, ModelVerdict
from analytics.loop.tracing.verdict.conclusion import denied
from analytics.loop.tracing.whitening.stack import MOST_LOST, common_channels, known_blocks
from stream.batch import BoolArray

LEAST_KNOWN = 0.2  # least share of the blocks in which a channel must have a value for its effects to be tested
MOST_GROUPS = 8  # largest number of additional traces; each costs as much as that of all blocks
_NO_VALUE = Bilingual(
    "it has no value there; effects that read it are tested where it has one", "该处无值；在有值处检验读取该通道的效应"
)
MOST_LACKING = 1 / 3  # largest share of the runs that may lack a channel whose effects are tested in the others
_TOO_MANY = Bilingual(
    "too many channels have gaps in different blocks; effects that read it were not tested",
    "在不同数据块中有缺段的通道过多；未检验读取该通道的效应",
)


@dataclass(frozen=True)
class GappedChannels:
    """Channels with gaps in the same blocks, a `share` of all; all runs, without other channels with gaps."""

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
    return any(each.share >= REPORTED and each.what != f"the excitation of {name}" for each in lost)


def _less(runs: Sequence[RunBlocks], names: set[str]) -> tuple[RunBlocks, ...]:
    if not names:
        return tuple(runs)
    return tuple(
        replace(run, channels={name: each for name, each in run.channels.items() if name not in names}) for run in runs
    )


@dataclass(frozen=True)
class PartialChannels:
    """Channels that most runs have; the runs that have all of them, and the names of the others."""

    channels: tuple[str, ...]
    runs: tuple[RunBlocks, ...]
    lacking: tuple[str, ...]

    def limit(self) -> Bilingual:
        """Caveat of a diagnosis of these runs."""
        names, lacking, count = ", ".join(self.channels), ", ".join(self.lacking), len(self.runs)
        return Bilingual(
            f"{lacking} lack channel {names}: this diagnosis is of the other {count} runs",
            f"{lacking}缺少通道{names}：本诊断只针对其余{count}次试验",
        )

    def left_out(self) -> LeftOut:
        """The other runs."""
        names, lacking = ", ".join(self.channels), ", ".join(self.lacking)
        return LeftOut(
            Bilingual(f"runs ({lacking})", f"试验（{lacking}）"),
            len(self.lacking) / (len(self.runs) + len(self.lacking)),
            Bilingual(f"channel {names} is not recorded there", f"该处未记录通道{names}"),
        )


def partial_channels(runs: Sequence[RunBlocks], kept: Collection[str] | None = None) -> PartialChannels | None:
    """The channels that a few of the runs lack; None if there are none. The runs `kept` must stay."""
    names = sorted(set[str]().union(*(run.channels for run in runs)))
    lacking = {name: [run.run for run in runs if name not in run.channels] for name in names}
    rare = sorted((name for name in names if lacking[name]), key=lambda name: (len(lacking[name]), name))
    chosen: list[str] = []
    gone: set[str] = set()
    for name in rare:
        more = gone.union(lacking[name])
        if len(more) <= MOST_LACKING * len(runs) and not more.intersection(kept or ()):
            chosen.append(name)
            gone = more
    if not chosen:
        return None
    return PartialChannels(
        tuple(chosen),
        tuple(run for run in runs if run.run not in gone),
        tuple(run.run for run in runs if run.run in gone),
    )


def with_gapped(
    found: Diagnosis,
    runs: Sequence[RunBlocks],
    whole: Sequence[RunBlocks],
    gapped: Sequence[GappedChannels],
    trace: Callable[[Sequence[RunBlocks], Sequence[str]], Diagnosis],
) -> Diagnosis:
    """The diagnosis `found` of `whole` with the effects of channels with gaps, each tested where it has readings.

    If several such channels explain the residual, each in its own blocks, they are compared in their common blocks.
    `whole` are the `runs` without channels with gaps; `trace` diagnoses runs in which some channels must have values.
    """
    tried = gapped[:MOST_GROUPS]
    traces = [(each, trace(each.runs, each.channels)) for each in tried]
    seen = [each for each, again in traces if _explains(each, again)]
    if len(seen) > 1:
        both = joined(runs, seen, gapped)
        if both.share <= 1.0 - LEAST_KNOWN:
            traces = [pair for pair in traces if pair[0] not in seen] + [(both, trace(both.runs, both.channels))]
        else:
            names = ", ".join(both.channels)
            text = Bilingual(
                f"channels {names} have few values in the same blocks: they cannot be compared",
                f"通道{names}在相同数据块中的值过少：无法比较",
            )
            found = msgspec.structs.replace(found, limits=(*found.limits, text))
    for each, again in traces:
        found = with_rest(found, again, each)
    untried = [name for each in gapped[MOST_GROUPS:] for name in each.channels]
    lost = tuple(
        LeftOut(Bilingual(f"channel {name}", f"通道{name}"), 1.0, _TOO_MANY, is_grave=True) for name in untried
    )
    sentences = tuple(each.sentence for each in lost)
    reasons = untested(runs, [whole, *(each.runs for each, _ in traces), *(each.runs for each in tried)], gapped)
    verdict = denied(found.verdict, lost)
    return msgspec.structs.replace(
        found,
        verdict=verdict,
        missing=found.missing if verdict is found.verdict else sentences,
        left_out=(*lost, *found.left_out),
        limits=(*sentences, *found.limits),
        not_tested=found.not_tested | reasons,
    )


def with_rest(found: Diagnosis, again: Diagnosis, some: PartialChannels | GappedChannels) -> Diagnosis:
    """The diagnosis of the remainder, with the channels, if one of them matters; else that of all runs and blocks."""
    if _explains(some, again):
        named = {name for each in again.effects for name in _names(each)}
        if named.issuperset(found.names) or isinstance(some, PartialChannels):
            return msgspec.structs.replace(
                again, left_out=(*again.left_out, some.left_out()), limits=(some.limit(), *again.limits)
            )
        channels = ", ".join(some.channels)
        beside = listed(effect_name(each.name) for each in again.effects if each.name not in found.names)
        text = Bilingual(
            f"in the blocks in which channel {channels} has a value, {beside} is significant as well",
            f"在通道{channels}有值处，{beside.zh}亦显著",
        )
        found = msgspec.structs.replace(found, limits=(*found.limits, text))
    if isinstance(some, GappedChannels):
        found = msgspec.structs.replace(found, left_out=(*found.left_out, some.left_out()))
    more = {name: each for name, each in again.detection_limits.items() if name not in found.detection_limits}
    reasons = {name: why for name, why in found.not_tested.items() if name not in more}
    if isinstance(some, GappedChannels):  # its effects have their channels in the remainder
        theirs = {name for name in reasons if set(effect(name).needs).intersection(some.channels)}
        reasons = {name: why for name, why in reasons.items() if name not in theirs}
        reasons |= {name: why for name, why in again.not_tested.items() if name in theirs}
    limits = {**found.detection_limits, **more} if found.verdict is not ModelVerdict.NOT_ENOUGH_DATA else {}
    return msgspec.structs.replace(found, detection_limits=limits, not_tested=reasons if limits else found.not_tested)


def _explains(some: PartialChannels | GappedChannels, again: Diagnosis) -> bool:
    """Whether an effect of these channels is among the findings or their alternatives."""
    names = {name for each in again.effects for name in _names(each)}
    return any(channel in some.channels for name in names for channel in effect(name).needs)


def _names(found: FoundEffect) -> tuple[str, ...]:
    return (found.name, *(each.name for each in found.confounded if each.recorded))
