"""What one replicate alone shows, beside the effects that were selected."""

from collections.abc import Sequence

from analytics.loop.tracing.search.fitted_candidates import FittedCandidate, as_if_replicated


def unreplicated_of(beside: Sequence[FittedCandidate], *, beside_others: bool) -> tuple[FittedCandidate, ...]:
    """Candidates with evidence, but without replication; beside selected effects, the best and those near it.

    Beside effects that were found, evidence counts over the noise inflation, since their forms are never exact.
    """
    seen = tuple(each for each in beside if not (each.replicates or each.is_rival) and each.evidence > 0)
    if not beside_others:
        return seen
    worth = [each for each in map(as_if_replicated, seen) if each.is_common and each.evidence > 0]
    best = max(worth, key=lambda each: each.evidence, default=None)
    return () if best is None else (best, *(each for each in worth if each is not best and each.is_near(best)))
