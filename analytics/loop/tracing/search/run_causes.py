"""The biases of all runs against each cause that differs between them only: a small family, fixed before they are seen.

The search asks for a significance among all its tests, of the training runs alone. With the biases of six runs hardly
any cause reaches that, however clearly the biases of all runs follow it: the scatter of the runs takes it up.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from analytics.loop.effects.base import Effect, EffectKind, Role
from analytics.loop.tracing.result.diagnosis_result import BiasTest
from analytics.loop.tracing.search.effect_search import Search, Selected
from analytics.loop.tracing.search.evidence import leave_one_out
from analytics.loop.tracing.search.fitted_candidates import ALPHA, FittedCandidate
from analytics.loop.tracing.search.run_biases import RunBiases, Slope, run_means, slope_within
from analytics.loop.tracing.search.screening import Candidate, Candidates, effect_columns
from analytics.loop.tracing.whitening.joint_fit import fit_jointly, nothing_more
from analytics.loop.tracing.whitening.stack import Stack, UnitRecord
from analytics.methods.distributions import chi_square_isf
from stream.batch import FloatArray

SEEN_IN_TRAINING = 0.05  # p-value times the number of tests; the held-out runs then confirm by 5 % as well
_FOLLOWS = 0.05  # p-value of a cause that the biases follow as well
_CONTRADICTED = 3.0  # standard errors between the coefficients between and within runs
_ALIKE = 1e-9  # spread of a column's means over their size below which it is alike in all runs


class RunCause(NamedTuple):
    """A search with the cause that the biases of all runs follow, and its test."""

    found: Search
    test: BiasTest


class _Tried(NamedTuple):
    item: Candidate
    column: FloatArray  # mean of each run
    slope: Slope


def run_cause(candidates: Candidates, found: Search, record: UnitRecord) -> RunCause | None:
    """The cause that the biases of all runs of a unit follow, where the search found nothing; None if they follow none.

    Its p-value times the number of tests is below 1 %, which holds by chance for 1 % of the units whose biases are
    independent and normal. Alternatives are the other causes that the biases follow, at 5 %, and beside which it is not
    as significant. The coefficient is that of the training runs, which the held-out runs then judge; they can confirm
    only what the training runs name without them, at 5 %, and what the output within the runs does not contradict.

    Parameters
    ----------
    record: All runs, `candidates` being of the training.
    """
    noise = found.joint.noises[0]
    biases = RunBiases.of(record, noise)
    tried = _tried(biases, _family(candidates, record.stack))
    best = min(tried, key=_p_value, default=None)
    if best is None or best.slope.p_value * len(tried) >= ALPHA:
        return None
    rivals = []
    for each in tried:
        beside = biases.slope(best.column, each.column)
        is_as_good = beside is None or beside.p_value * len(tried) >= ALPHA
        if each is not best and is_as_good and each.slope.p_value < _FOLLOWS:
            rivals.append(each)
    fitted, *others = (_fitted(candidates, found, each, len(tried)) for each in (best, *rivals))
    joint = fit_jointly(fitted.joint.records, fitted.joint.hypothesis, found.joint.noises, restricted=True)
    value, half = best.slope.value, best.slope.half
    training = candidates.records[0]
    alone = _tried(RunBiases.of(training, noise), _columns([each.item for each in tried], training.stack))
    first = min(alone, key=_p_value, default=None)
    is_in_training = (
        first is not None and first.item is best.item and first.slope.p_value * len(tried) < SEEN_IN_TRAINING
    )
    within = slope_within(record, noise, effect_columns(record.stack, best.item.effect, best.item.shape)[:, 0])
    if within is not None and abs(within[0] - value) <= _CONTRADICTED * np.hypot(within[1], best.slope.error):
        within = None
    test = BiasTest(
        runs=best.column.size, tests=len(tried), degrees=best.slope.degrees, p_value=best.slope.p_value,
        value=value, lo=value - half, hi=value + half,
        is_in_training=is_in_training and within is None, within=within,
    )  # fmt: skip
    selected = (Selected(fitted, tuple(others), ()),)
    return RunCause(replace(found, selected=selected, joint=joint, unreplicated=(), beside=()), test)


def _p_value(tried: _Tried) -> float:
    return tried.slope.p_value


def _tried(biases: RunBiases, columns: Iterable[tuple[Candidate, FloatArray]]) -> list[_Tried]:
    """The causes that these runs can test."""
    slopes = [(item, column, biases.slope(column)) for item, column in columns]
    return [_Tried(item, column, slope) for item, column, slope in slopes if slope is not None]


def _columns(items: Sequence[Candidate], stack: Stack) -> Iterator[tuple[Candidate, FloatArray]]:
    for item in items:
        yield item, run_means(stack, effect_columns(stack, item.effect, item.shape))[:, 0]


def _family(candidates: Candidates, stack: Stack) -> Iterator[tuple[Candidate, FloatArray]]:
    """The causes of one channel in one form that differ more between runs than within, and the mean of each run."""
    names = [item.effect.name for item in candidates.items]
    for item in candidates.items:
        if not _is_plain(item.effect) or item.width != 1 or names.count(item.effect.name) > 1:
            continue
        column = effect_columns(stack, item.effect, item.shape)
        if not np.isfinite(column).all():
            continue
        means = run_means(stack, column)[:, 0]
        inside = float(np.sqrt(np.mean((column[:, 0] - means[stack.run_number]) ** 2)))
        if np.std(means, ddof=1) > max(inside, _ALIKE * float(np.abs(means).max())):
            yield item, means


def _is_plain(effect: Effect) -> bool:
    return effect.kind is EffectKind.LIBRARY and effect.role is Role.CAUSE and len(effect.needs) == 1


def _fitted(candidates: Candidates, found: Search, tried: _Tried, tests: int) -> FittedCandidate:
    """A cause fitted to the training runs, with the significance of its test on all runs."""
    records = found.joint.records
    columns = candidates.of_all(tried.item)
    joint = fit_jointly(records, nothing_more(records).with_common(columns), found.joint.noises)
    statistic = float(chi_square_isf(max(tried.slope.p_value, 1e-300), 1))
    return FittedCandidate(
        tried.item.effect,
        dict(tried.item.shape),
        columns,
        joint,
        likelihood_ratio=statistic,
        degrees=1,
        evidence=statistic - 2.0 * float(np.log(tests)),
        replication=leave_one_out(joint, [each.stack.replicate for each in records], 1),
    )
