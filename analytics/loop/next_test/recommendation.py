"""The next test: the cheapest run that would decide what a diagnosis leaves open, with its hours and power."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import msgspec
import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.distributions import normal_cdf
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.next_test.plans import Decides, TestPlan, cheapest_plans
from analytics.loop.next_test.separation import RivalFit, Separation, inseparable, rival
from analytics.loop.next_test.station_bounds import StationBounds
from analytics.loop.tracing.case import case_of
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, FoundEffect
from analytics.loop.tracing.whitening.stack import UnitRecord
from analytics.loop.tracing.whitening.whitener import Whitener

_SAME_COLUMNS = Bilingual(
    "No run decides: they follow the same regressor in the recorded channels; the separating test of each names what "
    "to record or to set up otherwise.",
    "任何试验均不能判别：它们在所记录的通道中回归量相同；各自的区分方法指出须另行记录或布置的内容。",
)
_NO_RIVAL = Bilingual(
    "No run decides: the others are not recorded, or would need an implausible size.",
    "任何试验均不能判别：其余效应未被记录，或所需大小不合理。",
)
_NO_TEST = Bilingual(
    "No test within the bounds of the station separates them in the recorded channels.",
    "在台站能力范围内，没有试验能在所记录的通道中区分它们。",
)
_ONE_SIDED, _TWO_SIDED = 1.64, 3.29  # of the held-out answer


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
    if diagnosis.noise is None:
        return None
    held_out = diagnosis.held_out_runs
    shaped = model.shaped(runs)
    record = case_of(runs, shaped, declared_noise, held_out).training
    subject = next((each for each in diagnosis.effects if _recorded_rivals(each)), None)
    if subject is not None:
        twins = inseparable((subject.name, *_recorded_rivals(subject)), record.stack.runs)
        names = tuple(twins)
        if len(names) == 1:
            return NextTest(question="which", rivals=names, weights={names[0]: 1.0}, twins=twins, why_not=_SAME_COLUMNS)
        rivals = [rival(name, record.stack.runs) for name in names]
        others = [(effect(each.name), each.parameters) for each in diagnosis.effects if each.name != subject.name]
        fit = RivalFit(record.stack, shaped, diagnosis.noise, record.white, rivals, others)
        weights = dict(zip(names, map(float, fit.weights), strict=True))
        twins = {name: others for name, others in twins.items() if others}
        found = NextTest(question="which", rivals=names, weights=weights, holdout=held_out, twins=twins)
        decides = _which(fit)
    elif (alone := next((each for each in diagnosis.effects if each.confounded), None)) is not None:
        return NextTest(question="which", rivals=(alone.name,), weights={alone.name: 1.0}, why_not=_NO_RIVAL)
    else:
        open_ = next((each for each in (*diagnosis.unreplicated, *diagnosis.effects) if not each.confirmed), None)
        if open_ is None or not effect(open_.name).needs:
            return None
        found = NextTest(question="again", rivals=(open_.name,), weights={open_.name: 1.0})
        decides = _again(open_, record, diagnosis.noise)
    limits = StationBounds.of_runs(runs) if bounds is None else bounds
    plans, repeat = cheapest_plans(decides, found.rivals, runs, limits, on_progress)
    return msgspec.structs.replace(found, plans=plans, repeat=repeat, why_not=None if plans else _NO_TEST)


def _recorded_rivals(found: FoundEffect) -> tuple[str, ...]:
    return tuple(
        each.name
        for each in found.confounded
        if each.recorded and each.is_plausible and each.evidence_behind is not None
    )


def _which(fit: RivalFit) -> Decides:
    """Whether the true one of several rivals is left as the single name."""

    def decides(run: RunBlocks) -> Callable[[int], Separation] | None:
        white = fit.whitened(run)
        return None if white is None else partial(fit.separation, white)

    return decides


def _again(found: FoundEffect, record: UnitRecord, noise: ModelNoise) -> Decides:
    """Whether held-out runs confirm an effect of the size that was found."""
    theta = np.array([each.value for each in found.coefficients])
    spread = np.array([(each.hi - each.lo) / 3.92 for each in found.coefficients])
    training_se = float(np.linalg.norm(spread) / max(float(np.linalg.norm(theta)), 1e-300))

    def confirmed(information: float) -> Separation:
        if information <= _ONE_SIDED**2:
            return Separation(0.0, {found.name: 0.0}, information)
        se = information**-0.5
        scatter = float(np.hypot(se, training_se))
        lo = max(_ONE_SIDED * se, 1.0 - _TWO_SIDED * scatter)
        hi = 1.0 + _TWO_SIDED * scatter
        power = float(normal_cdf((hi - 1.0) / scatter) - normal_cdf((lo - 1.0) / scatter))
        return Separation(power, {found.name: power}, information)

    def decides(run: RunBlocks) -> Callable[[int], Separation] | None:
        predicted = effect(found.name).regressors(run, found.parameters) @ theta
        if not np.isfinite(predicted).all():
            return None
        steps = np.diff(run.slot, prepend=run.slot[0])
        whitener = Whitener.of(record.stack.noise_model, noise, steps, np.ones(len(run)))
        of_one = float(np.sum(whitener(predicted[:, None]) ** 2))
        return lambda repeats: confirmed(repeats * of_one)

    return decides
