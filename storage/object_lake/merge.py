"""What a builder publishes: its own lake joined with the published one, so that neither loses a segment.

Parts that share segments, directly or through others, are decided on together. A replacement has all segments of what
it replaces and all raw rows that are not dropped; so a builder whose view is stale changes nothing, and two builders
that publish in turns come to rest.
"""

from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

from storage.lake.drops import Drops
from storage.lake.part import without_samples
from storage.manifests.part import Part


class Merge(NamedTuple):
    """Published parts that stay, own parts of segments that are not published, own parts that replace published ones.

    `trimmed` are published parts whose raw rows are dropped now, as they become; `alone` are segments that need parts
    of their own, since the own part that has them overlaps others; `conflicting` segments were published from other
    files of the same names, and stay so.
    """

    stays: tuple[Part, ...]
    fresh: tuple[Part, ...]
    adds: tuple[Part, ...]
    replaces: tuple[Part, ...]
    trimmed: tuple[Part, ...]
    alone: tuple[str, ...]
    conflicting: tuple[str, ...]
    drops: Drops


def merge(
    own: Sequence[Part], own_drops: Drops, published: Sequence[Part], published_drops: Drops,
    damaged: Collection[str] = (),
) -> Merge:  # fmt: skip
    """Join a lake with the published one, some parts of which may be `damaged`."""
    drops = published_drops.join(own_drops)
    stays: list[Part] = []
    fresh: list[Part] = []
    adds: list[Part] = []
    replaces: list[Part] = []
    alone: list[str] = []
    conflicting: list[str] = []
    for mine, theirs in _overlapping(own, published):
        others = _conflicts(mine, theirs)
        conflicting += others
        if not theirs:
            fresh += mine
        elif not others and _improves(mine, theirs, drops, damaged):
            adds += mine
            replaces += theirs
        else:
            stays += theirs
            alone += sorted(_segments(mine) - _segments(theirs))
    trimmed = [_trimmed(part, drops) for part in stays]
    return Merge(
        stays=tuple(part for part, trim in zip(stays, trimmed, strict=True) if trim is None), fresh=tuple(fresh),
        adds=tuple(adds), replaces=tuple(replaces), trimmed=tuple(part for part in trimmed if part is not None),
        alone=tuple(alone), conflicting=tuple(conflicting), drops=drops,
    )  # fmt: skip


def _improves(mine: list[Part], theirs: list[Part], drops: Drops, damaged: Collection[str]) -> bool:
    """Whether own parts may replace published ones, and are better."""
    have, had = _segments(mine), _segments(theirs)
    kept = {segment for part in theirs if part.dropped is None for segment in part.segments} - drops.dropped.keys()
    raw = {segment for part in mine if part.dropped is None for segment in part.segments}
    if not (had <= have and kept <= raw):
        return False
    return (
        had < have
        or any(part.name in damaged for part in theirs)
        or _cost(mine, drops) < _cost([_trimmed(part, drops) or part for part in theirs], drops)
    )


def _cost(parts: list[Part], drops: Drops) -> tuple[int, int]:
    """Segments with raw rows that should be dropped, or without those that should be there; then number of parts."""
    wrong = sum((segment in drops.dropped) != (part.dropped is not None) for part in parts for segment in part.segments)
    return wrong, len(parts)


def _trimmed(part: Part, drops: Drops) -> Part | None:
    """A published part once its raw rows are dropped; None if they stay, or only some of them go."""
    if part.dropped is not None or not all(segment in drops.dropped for segment in part.segments):
        return None
    return without_samples(part, drops.dropped[part.segments[-1]])


def _conflicts(mine: list[Part], theirs: list[Part]) -> list[str]:
    """Segments of both that were made from different files."""
    own = {segment: sha256 for part in mine for segment, sha256 in part.sources.items()}
    return sorted(
        segment for part in theirs for segment, sha256 in part.sources.items() if own.get(segment, sha256) != sha256
    )


def _segments(parts: Iterable[Part]) -> set[str]:
    return {segment for part in parts for segment in part.segments}


def _overlapping(own: Sequence[Part], published: Sequence[Part]) -> list[tuple[list[Part], list[Part]]]:
    """Groups of own and published parts that share segments, directly or through others."""
    parts = [*own, *published]
    group = list(range(len(parts)))

    def root(at: int) -> int:
        while group[at] != at:
            group[at] = group[group[at]]
            at = group[at]
        return at

    holder: dict[str, int] = {}
    for at, part in enumerate(parts):
        for segment in part.segments:
            group[root(at)] = root(holder.setdefault(segment, at))
    found: dict[int, tuple[list[Part], list[Part]]] = {}
    for at, part in enumerate(parts):
        mine, theirs = found.setdefault(root(at), ([], []))
        (mine if at < len(own) else theirs).append(part)
    return list(found.values())
