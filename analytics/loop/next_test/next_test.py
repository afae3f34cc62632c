"""The next test: the cheapest run that would decide what a diagnosis leaves open, with its hours and power."""

from collections.abc import Callable, Sequence
from typing import Any, Literal

import msgspec
import numpy as np
from scipy import stats

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Shape
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.next_test.candidate_tests import CandidateTest, StationBounds, candidate_tests
from analytics.loop.next_test.predicted_run import predicted_run, repeated_run
from analytics.loop.next_test.separation import RivalFit, Separation, rival
from analytics.loop.next_test.timeline import timeline
from analytics.loop.tracing.case import case_of
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, FoundEffect
from analytics.loop.tracing.whitening.stack import UnitRecord
from analytics.loop.tracing.whitening.whitener import Whitener
from stream.batch import FloatArray

WANTED_POWER = 0.9
_MOST_PLANS = 5
_MOST_REPEATS = 3
_SAME = 1.0 - 1e-9
_SAME_COLUMNS = Bilingual(
    "No run decides: they follow the same regressor in the recorded channels; the separating test of each names what "
    "to record or to set up otherwise.",
    "任何试验均不能判别：它们在所记录的通道中回归量相同；各自的区分方法指出须另行记录或布置的内容。",
)
_NO_RIVAL = Bilingual(
    "No run decides: the others are not recorded, or would need an implausible size.",
    "任何试验均不能判别：其余效应未被记录，或所需大小不合理。",
)
_POWER_ON_H = 0.25  # to mount and warm up, for each run
_ONE_SIDED, _TWO_SIDED = 1.64, 3.29  # of the held-out answer


class TestPlan(msgspec.Struct, frozen=True, kw_only=True):
    """A test that may decide.

    Parameters
    ----------
    hours: Of all its runs, with ramps and pauses.
    power: Probability that it decides.
    separation: Least expected difference of evidence between a true effect and another, chi-square.
    by_truth: Power if each of the rivals is the true one.
    """

    __test__ = False

    test: CandidateTest
    hours: float
    power: float
    separation: float
    by_truth: dict[str, float]

    def document(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "procedure": self.test.name,
            "what": str(self.test.what),
            "repeat_of": self.test.like or None,
            "runs": self.test.repeats,
            "hours": round(self.hours, 2),
            "power": round(self.power, 3),
            "separation": round(self.separation, 1),
            "by_truth": {name: round(power, 3) for name, power in self.by_truth.items()},
            "steps": list(self.test.steps),
        }


class NextTest(msgspec.Struct, frozen=True, kw_only=True):
    """What is open, and the tests that would decide it, the cheapest that reaches the wanted power first.

    Parameters
    ----------
    question: Which of several effects is at work, or whether one effect is seen again.
    weights: Posterior weight of each rival on the data so far.
    twins: By rival, effects with the same columns, which no run separates from it.
    repeat: The cheapest repetition of a run that reaches the power, for comparison; None if none does.
    holdout: Runs to hold out in the diagnosis after the test; empty for its default.
    why_not: Why there is no plan.
    """

    question: Literal["which", "again"]
    rivals: tuple[str, ...]
    weights: dict[str, float]
    twins: dict[str, tuple[str, ...]] = {}
    plans: tuple[TestPlan, ...] = ()
    repeat: TestPlan | None = None
    holdout: tuple[str, ...] = ()
    why_not: Bilingual | None = None

    def document(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "question": self.question,
            "rivals": list(self.rivals),
            "weights": {name: round(weight, 4) for name, weight in self.weights.items()},
            "inseparable": {name: list(others) for name, others in self.twins.items()},
            "plans": [each.document() for each in self.plans],
            "repeat": None if self.repeat is None else self.repeat.document(),
            "holdout": list(self.holdout),
            "why_not": None if self.why_not is None else str(self.why_not),
        }


def next_test(
    diagnosis: Diagnosis,
    runs: Sequence[RunBlocks],
    model: ErrorModel,
    *,
    declared_noise: ModelNoise | None = None,
    bounds: StationBounds | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
) -> NextTest | None:
    """The tests that would decide what a diagnosis leaves open; None if it leaves nothing open.

    Parameters
    ----------
    runs, model, declared_noise: As they were diagnosed.
    bounds: Of the station; by default what the unit has been through.
    """
    assert diagnosis.noise is not None or not diagnosis.training_runs
    if diagnosis.noise is None:
        return None
    held_out = tuple(run for run in diagnosis.runs if run not in diagnosis.training_runs)
    shaped = model.shaped(runs)
    case = case_of(runs, shaped, declared_noise, held_out or ())
    limits = StationBounds.of_runs(runs) if bounds is None else bounds
    subject = next((each for each in diagnosis.effects if _recorded_rivals(each)), None)
    if subject is None and (alone := next((each for each in diagnosis.effects if each.confounded), None)) is not None:
        return NextTest(question="which", rivals=(alone.name,), weights={alone.name: 1.0}, why_not=_NO_RIVAL)
    if subject is not None:
        twins = _twins((subject.name, *_recorded_rivals(subject)), case.training.stack.runs)
        names = tuple(twins)
        if len(names) == 1:
            return NextTest(question="which", rivals=names, weights={names[0]: 1.0}, twins=twins, why_not=_SAME_COLUMNS)
        fit = RivalFit(
            case.training.stack,
            shaped,
            diagnosis.noise,
            case.training.white,
            [rival(name, case.training.stack.runs) for name in names],
            _others(diagnosis, subject),
        )
        found = NextTest(
            question="which",
            rivals=names,
            weights=dict(zip(names, map(float, fit.weights), strict=True)),
            holdout=held_out,
            twins={name: others for name, others in twins.items() if others},
        )
        plans, repeat = _plans(_which(fit), names, runs, limits, on_progress)
    else:
        open_ = next((each for each in (*diagnosis.unreplicated, *diagnosis.effects) if not each.confirmed), None)
        if open_ is None or not effect(open_.name).needs:
            return None
        found = NextTest(question="again", rivals=(open_.name,), weights={open_.name: 1.0})
        plans, repeat = _plans(_again(open_, case.training, diagnosis.noise), (open_.name,), runs, limits, on_progress)
    why_not = None
    if not plans:
        why_not = Bilingual(
            "No test within the bounds of the station separates them in the recorded channels.",
            "在台站能力范围内，没有试验能在所记录的通道中区分它们。",
        )
    return msgspec.structs.replace(found, plans=plans, repeat=repeat, why_not=why_not)


Decides = Callable[[RunBlocks, int], Separation | None]


def _recorded_rivals(found: FoundEffect) -> tuple[str, ...]:
    return tuple(
        each.name
        for each in found.confounded
        if each.recorded and each.is_plausible and each.evidence_behind is not None
    )


def _twins(names: Sequence[str], runs: Sequence[RunBlocks]) -> dict[str, tuple[str, ...]]:
    """By rival: others with the same columns whatever is run, such as an effect of a slope and a sensor's clock."""
    columns = {name: _direction(name, runs) for name in names}
    found: dict[str, tuple[str, ...]] = {}
    for name, own in columns.items():
        first = next((each for each in found if _is_same(columns[each], own)), None)
        if first is None:
            found[name] = ()
        else:
            found[first] = (*found[first], name)
    return found


def _direction(name: str, runs: Sequence[RunBlocks]) -> FloatArray | None:
    """The one column of a rival without parameters, of length one."""
    shapes = effect(name).shapes(runs)
    if len(shapes) != 1 or len(effect(name).columns(shapes[0])) != 1:
        return None
    column = np.concatenate([effect(name).regressors(run, shapes[0])[:, 0] for run in runs])
    column = column[np.isfinite(column)]
    return np.asarray(column / max(float(np.linalg.norm(column)), 1e-300))


def _is_same(one: FloatArray | None, other: FloatArray | None) -> bool:
    return one is not None and other is not None and one.size == other.size and abs(float(one @ other)) > _SAME


def _others(diagnosis: Diagnosis, subject: FoundEffect) -> list[tuple[Effect, Shape]]:
    return [(effect(each.name), each.parameters) for each in diagnosis.effects if each.name != subject.name]


def _which(fit: RivalFit) -> Decides:
    return fit.separated_by


def _again(found: FoundEffect, record: UnitRecord, noise: ModelNoise) -> Decides:
    """Whether held-out runs confirm an effect of the size that was found."""
    theta = np.array([each.value for each in found.coefficients])
    spread = np.array([(each.hi - each.lo) / 3.92 for each in found.coefficients])
    training_se = float(np.linalg.norm(spread) / max(float(np.linalg.norm(theta)), 1e-300))

    def decides(run: RunBlocks, repeats: int) -> Separation | None:
        predicted = effect(found.name).regressors(run, found.parameters) @ theta
        if not np.isfinite(predicted).all():
            return None
        steps = np.diff(run.slot, prepend=run.slot[0])
        whitener = Whitener.of(record.stack.noise_model, noise, steps, np.ones(len(run)))
        information = repeats * float(np.sum(whitener(predicted[:, None]) ** 2))
        if information <= _ONE_SIDED**2:
            return Separation(0.0, {found.name: 0.0}, information)
        se = information**-0.5
        scatter = float(np.hypot(se, training_se))
        lo = max(_ONE_SIDED * se, 1.0 - _TWO_SIDED * scatter)
        hi = 1.0 + _TWO_SIDED * scatter
        power = float(stats.norm.cdf((hi - 1.0) / scatter) - stats.norm.cdf((lo - 1.0) / scatter))
        return Separation(power, {found.name: power}, information)

    return decides


def _plans(
    decides: Decides,
    names: Sequence[str],
    runs: Sequence[RunBlocks],
    bounds: StationBounds,
    on_progress: Callable[[str], None],
) -> tuple[tuple[TestPlan, ...], TestPlan | None]:
    """Plans that reach the power, the cheapest first, else the most powerful; and the cheapest repetition."""
    needed = {channel for name in names for channel in effect(name).needs}
    tests = candidate_tests(needed, bounds, runs)
    timed = sorted(
        ((run, _hours(run), each) for each in tests for run in [_run_of(each, runs, bounds)]), key=lambda it: it[1]
    )
    good: list[TestPlan] = []
    weak: list[TestPlan] = []
    repeat: TestPlan | None = None
    for number, (run, hours, test) in enumerate(timed, start=1):
        on_progress(f"planning the next test ({number} of {len(timed)})")
        most = good[_MOST_PLANS - 1].hours if len(good) >= _MOST_PLANS else np.inf
        plan = _cheapest(decides, run, hours, test, np.inf if test.like and repeat is None else most)
        if plan is None:
            continue
        if test.like and plan.power >= WANTED_POWER and (repeat is None or plan.hours < repeat.hours):
            repeat = plan
        (good if plan.power >= WANTED_POWER else weak).append(plan)
        good.sort(key=lambda each: each.hours)
    chosen = good or sorted(weak, key=lambda each: -each.power)
    return tuple(each for each in chosen[:_MOST_PLANS] if each.power > 0.05), repeat


def _cheapest(decides: Decides, run: RunBlocks, hours: float, test: CandidateTest, most_h: float) -> TestPlan | None:
    """The test with as many repeats as its power needs, at most three; None if it is not worth looking at."""
    best: TestPlan | None = None
    for repeats in range(1, _MOST_REPEATS + 1):
        if repeats * hours > most_h:
            break
        found = decides(run, repeats)
        if found is None:
            return None
        best = TestPlan(
            test=msgspec.structs.replace(test, repeats=repeats),
            hours=repeats * hours,
            power=found.power,
            separation=found.least,
            by_truth=found.by_truth,
        )
        if found.power >= WANTED_POWER or found.power < 0.02:
            break
    return best


def _run_of(test: CandidateTest, runs: Sequence[RunBlocks], bounds: StationBounds) -> RunBlocks:
    if test.like:
        run = next(each for each in runs if each.run == test.like)
        return repeated_run(run, test.name, max(each.t0_ns for each in runs))
    start = float(np.mean([bounds.least_deg_c or 25.0, bounds.most_deg_c or 25.0]))
    return predicted_run(timeline(test.planned(), bounds, start), runs, test.name)


def _hours(run: RunBlocks) -> float:
    return float(run.slot[-1] + 1 - run.slot[0]) * run.block_s / 3600.0 + _POWER_ON_H
