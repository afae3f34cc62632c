"""Causes that a proxy follows: found alone, it stands for one of them."""

from collections.abc import Collection, Sequence

import msgspec

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Role
from analytics.loop.effects.registry import effect
from analytics.loop.tracing.result import ConfoundedEffect, FoundEffect


def with_causes(found: FoundEffect, runs: Sequence[RunBlocks], declared: Collection[str]) -> FoundEffect:
    """Return a finding; of a proxy with the causes that it follows, recorded or not.

    Parameters
    ----------
    found: The finding.
    runs: Which tell what is recorded.
    declared: Effects of the declared model, which are taken off already.
    """
    own = effect(found.name)
    if own.role is not Role.PROXY:
        return found
    known = {found.name, *(each.name for each in found.confounded), *declared}
    causes = tuple(_cause(name, runs) for name in own.follows if name not in known)
    return msgspec.structs.replace(found, confounded=(*found.confounded, *causes))


def _cause(name: str, runs: Sequence[RunBlocks]) -> ConfoundedEffect:
    cause = effect(name)
    return ConfoundedEffect(
        name=name,
        parameters={},
        evidence_behind=None,
        role=cause.role.value,
        separating_test=cause.separating_test,
        separating_test_zh=cause.separating_test_zh,
        recorded=all(channel in run.channels for channel in cause.needs for run in runs),
    )
