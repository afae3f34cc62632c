"""What a test decides: which of several effects is at work, whether one is seen again, whether noise stays at rest."""

from collections.abc import Callable, Sequence
from functools import partial

import msgspec
import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Shape
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.next_test.plans import Decides
from analytics.loop.next_test.separation import DRAWS, FittedRecord, RivalFit, Separation, rival
from analytics.loop.tracing.result.diagnosis_result import FoundEffect
from analytics.loop.tracing.verdict.noise_agreement import NOISE_AVERAGES_S, NOISE_P_VALUE, NOISE_RATIO
from analytics.loop.tracing.whitening.whitener import NoiseModel, Whitener
from analytics.methods.distributions import chi_square_isf, normal_cdf
from stream.batch import FloatArray

AT_REST, DRIVEN = "at_rest", "driven"
_ONE_SIDED, _TWO_SIDED = 1.64, 3.29  # of the held-out answer
_NOISE_TERMS = 4


def which(
    records: Sequence[FittedRecord], model: ErrorModel, names: Sequence[str], others: Sequence[tuple[Effect, Shape]]
) -> tuple[Decides, FloatArray]:
    """Whether the true one of several rivals is left as the single name; and the weight of each so far.

    The shapes of a rival are those that the search would try on the runs so far and on those of the test.
    """
    runs = [run for each in records for run in each.stack.runs]
    base = RivalFit(records, model, [rival(name, runs) for name in names], others)

    def decides(test: Sequence[RunBlocks]) -> Callable[[int], Separation] | None:
        rivals = tuple(rival(name, [*runs, *test]) for name in names)
        fit = base if rivals == base.rivals else RivalFit(records, model, rivals, others)
        white = fit.whitened(test)
        return None if white is None else partial(fit.separation, white, weights=base.weights)

    return decides, base.weights


def again(found: FoundEffect, records: Sequence[FittedRecord], model: ErrorModel) -> Decides:
    """Whether held-out runs confirm an effect of the size that was found."""
    theta = np.array([each.value for each in found.coefficients])
    # of the size as a whole: coefficients of one curve err together
    training_se = 1.0 / max(found.significance, 1.0)

    def confirmed(information: float) -> Separation:
        if information <= _ONE_SIDED**2:
            return Separation(0.0, {found.name: 0.0}, information, 0.0)
        se = information**-0.5
        scatter = float(np.hypot(se, training_se))
        lo = max(_ONE_SIDED * se, 1.0 - _TWO_SIDED * scatter)
        hi = 1.0 + _TWO_SIDED * scatter
        power = normal_cdf((hi - 1.0) / scatter) - normal_cdf((lo - 1.0) / scatter)
        return Separation(power, {found.name: power}, information, power)

    shares = [_declared_share(found, theta, each, model) for each in records]

    def decides(test: Sequence[RunBlocks]) -> Callable[[int], Separation] | None:
        of_one = 0.0
        for run in test:
            alone = effect(found.name).regressors(run, found.parameters) @ theta
            if not np.isfinite(alone).all():
                return None
            steps = np.diff(run.slot, prepend=run.slot[0])
            for each, share in zip(records, shares, strict=True):
                whitener = Whitener.of(each.stack.noise_model, each.noise, steps, np.ones(len(run)))
                predicted = alone - np.nan_to_num(model.columns(run)) @ share
                of_one += float(np.sum(whitener(predicted[:, None]) ** 2))
        return lambda repeats: confirmed(repeats * of_one)

    return decides


def _declared_share(found: FoundEffect, theta: FloatArray, record: FittedRecord, model: ErrorModel) -> FloatArray:
    """What the coefficients of the declared model take of an effect in the runs so far."""
    stack = record.stack
    columns = stack.column(lambda run: effect(found.name).regressors(run, found.parameters)) @ theta
    whitener = Whitener.of(stack.noise_model, record.noise, stack.steps, record.white)
    white = whitener(np.column_stack([stack.column(model.columns), columns]))
    return np.asarray(np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=1e-9)[0])


def excess(noise_model: NoiseModel, fitted: ModelNoise, declared: ModelNoise) -> Decides:
    """Whether a run at rest shows more noise than declared, if its noise is as fitted, by its likelihood ratio.

    The diagnosis calls noise unexplained by its variance at averages of minutes. White noise that does not show there
    does not count here either.
    """
    white = msgspec.structs.replace(declared, N=fitted.N)
    if not any(
        noise_model.average_variance(white, each) > NOISE_RATIO * noise_model.average_variance(declared, each)
        for each in NOISE_AVERAGES_S
    ):
        declared = white

    def decides(test: Sequence[RunBlocks]) -> Callable[[int], Separation] | None:
        return lambda repeats: _seen([*test] * repeats)

    def _seen(test: Sequence[RunBlocks]) -> Separation:
        rng = np.random.default_rng(0)
        gain = np.zeros(DRAWS)
        for run in test:
            steps, white = np.diff(run.slot, prepend=run.slot[0]), np.ones(len(run))
            own, other = (Whitener.of(noise_model, each, steps, white) for each in (fitted, declared))
            drawn = rng.standard_normal((len(run), DRAWS))
            left = other(own.colour(drawn))
            gain += 0.5 * (np.sum(left**2, axis=0) - np.sum(drawn**2, axis=0))
            gain += 0.5 * (other.log_determinant - own.log_determinant)
        needed = float(chi_square_isf(NOISE_P_VALUE, _NOISE_TERMS)) / 2.0
        power = float(np.mean(gain > needed))
        by_truth = {AT_REST: power, DRIVEN: 1.0 - NOISE_P_VALUE}
        return Separation(power, by_truth, float(2.0 * np.mean(gain)), power)

    return decides
