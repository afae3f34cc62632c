"""Channels that a few runs lack, or that have gaps: their effects are looked for in the rest."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import msgspec

from analytics.loop.blocks.left_out import LeftOut
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.registry import effect
from analytics.loop.tracing.gapped_channels import LEAST_KNOWN, MOST_GROUPS, GappedChannels, joined, untried
from analytics.loop.tracing.result import Diagnosis, FoundEffect, Verdict

_TOO_MANY = "too many channels have gaps in different blocks; effects that read it were not looked for"
MOST_LACKING = 1 / 3
"""Part of the runs that may lack a channel whose effects are looked for in the others."""


@dataclass(frozen=True)
class PartialChannels:
    """Channels that most runs have.

    Parameters
    ----------
    channels: Those that some run lacks.
    runs: The runs that have all of them.
    lacking: Names of the others.
    """

    channels: tuple[str, ...]
    runs: tuple[RunBlocks, ...]
    lacking: tuple[str, ...]

    def limit(self) -> str:
        """Say that the others take no part in this diagnosis."""
        return (
            f"{', '.join(self.lacking)} lack channel {', '.join(self.channels)}: this diagnosis is of the other "
            f"{len(self.runs)} runs"
        )

    def left_out(self) -> LeftOut:
        """What that leaves out."""
        share = len(self.lacking) / (len(self.runs) + len(self.lacking))
        return LeftOut(
            f"runs ({', '.join(self.lacking)})", share, f"channel {', '.join(self.channels)} is not recorded there"
        )


def partial_channels(runs: Sequence[RunBlocks], kept: Collection[str] | None = None) -> PartialChannels | None:
    """Return the channels that a few of the runs lack; None where there are none.

    Parameters
    ----------
    runs: All runs.
    kept: Runs that must stay, as those that are to be held out.
    """
    count = len(runs)
    names = sorted(set[str]().union(*(run.channels for run in runs)))
    lacking = {name: [run.run for run in runs if name not in run.channels] for name in names}
    rare = sorted((name for name in names if lacking[name]), key=lambda name: (len(lacking[name]), name))
    chosen: list[str] = []
    gone: set[str] = set()
    for name in rare:
        more = gone.union(lacking[name])
        if len(more) <= MOST_LACKING * count and not more.intersection(kept or ()):
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
    """Return the diagnosis with the effects of channels that have gaps looked for, each where it has readings.

    Where several such channels explain the residual, each in its own blocks, they are compared in those that all have.

    Parameters
    ----------
    found: Of `whole`.
    runs, whole: With all channels, and without those that have gaps.
    gapped: The channels.
    trace: Diagnoses runs in which some channels must have values.
    """
    tried = gapped[:MOST_GROUPS]
    traces = [(each, trace(each.runs, each.channels)) for each in tried]
    seen = [each for each, again in traces if _explains(each, again)]
    if len(seen) > 1:
        both = joined(runs, seen, gapped)
        if both.share <= 1.0 - LEAST_KNOWN:
            traces = [pair for pair in traces if pair[0] not in seen] + [(both, trace(both.runs, both.channels))]
        else:
            text = f"channels {', '.join(both.channels)} have few values in the same blocks: they cannot be compared"
            found = msgspec.structs.replace(found, limits=(*found.limits, text))
    for each, again in traces:
        found = with_rest(found, again, each)
    names = [name for each in gapped[MOST_GROUPS:] for name in each.channels]
    lost = tuple(LeftOut(f"channel {name}", 1.0, _TOO_MANY, is_grave=True) for name in names)
    reasons = untried(runs, [whole, *(each.runs for each, _ in traces), *(each.runs for each in tried)], gapped)
    verdict = denied(found.verdict, lost)
    return msgspec.structs.replace(
        found,
        verdict=verdict,
        missing=found.missing if verdict is found.verdict else tuple(each.sentence for each in lost),
        left_out=(*lost, *found.left_out),
        limits=(*(each.sentence for each in lost), *found.limits),
        not_tested=found.not_tested | reasons,
    )


def denied(verdict: Verdict, left_out: Sequence[LeftOut]) -> Verdict:
    """Return the verdict; where much was left out, what remains cannot show that nothing is missing."""
    if verdict is Verdict.NOTHING_MISSING and any(each.is_grave for each in left_out):
        return Verdict.NOT_ENOUGH_DATA
    return verdict


def _explains(some: PartialChannels | GappedChannels, again: Diagnosis) -> bool:
    """Whether an effect of these channels is among those found."""
    seen = {channel for each in again.effects for channel in _channels_meant(each)}
    return not seen.isdisjoint(some.channels)


def with_rest(found: Diagnosis, again: Diagnosis, some: PartialChannels | GappedChannels) -> Diagnosis:
    """Return the diagnosis of the rest, where one of these channels matters; else that of all.

    Parameters
    ----------
    found: Of all runs and blocks, without the channels.
    again: Of the rest, with them.
    some: The channels.
    """
    if _explains(some, again):
        named = {name for each in again.effects for name in _names_meant(each)}
        if named.issuperset(found.names) or isinstance(some, PartialChannels):
            return msgspec.structs.replace(
                again, left_out=(*again.left_out, some.left_out()), limits=(some.limit(), *again.limits)
            )
        beside = ", ".join(each.name for each in again.effects if each.name not in found.names)
        text = f"where channel {', '.join(some.channels)} has a value, {beside} stands out as well"
        found = msgspec.structs.replace(found, limits=(*found.limits, text))
    if isinstance(some, GappedChannels):
        found = msgspec.structs.replace(found, left_out=(*found.left_out, some.left_out()))
    more = {name: each for name, each in again.detection_limits.items() if name not in found.detection_limits}
    reasons = {name: why for name, why in found.not_tested.items() if name not in more}
    if isinstance(some, GappedChannels):  # its effects find their channels in the rest
        theirs = {name for name in reasons if set(effect(name).needs).intersection(some.channels)}
        reasons = {name: why for name, why in reasons.items() if name not in theirs}
        reasons |= {name: why for name, why in again.not_tested.items() if name in theirs}
    limits = {**found.detection_limits, **more} if found.verdict is not Verdict.NOT_ENOUGH_DATA else {}
    return msgspec.structs.replace(found, detection_limits=limits, not_tested=reasons if limits else found.not_tested)


def _names_meant(found: FoundEffect) -> tuple[str, ...]:
    return (found.name, *(each.name for each in found.confounded if each.recorded))


def _channels_meant(found: FoundEffect) -> set[str]:
    return {channel for name in _names_meant(found) for channel in effect(name).needs}
