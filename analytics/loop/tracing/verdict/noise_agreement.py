"""Declared and fitted noise compared; differences between runs: turn-on scatter, or a cause that differs as well."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, EffectKind, Role
from analytics.loop.effects.events import TURN_ON
from analytics.loop.effects.registry import effect_name, effects
from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.result.diagnosis_result import ConfoundedEffect, EffectCoefficient, FoundEffect
from analytics.loop.tracing.search.evidence import PRICE, one_degree
from analytics.loop.tracing.verdict.effect_findings import unfitted
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.least_squares import fit
from analytics.loop.tracing.whitening.noise_variance import correlated_variance
from analytics.loop.tracing.whitening.stack import UnitRecord, as_array, from_array
from analytics.loop.tracing.whitening.whitened_fit import evaluate
from analytics.methods.distributions import chi_square_cdf, chi_square_isf, chi_square_sf, normal_sf
from stream.batch import FloatArray

FAR = 10.0  # ratio of the scatter of the runs to the noise of their means from which it is a finding
WORTH_A_WORD = 3.0  # the same ratio from which a caveat says that the scatter can hide an effect
MOST_RUNS = 4  # with more runs the search itself separates a cause from turn-on scatter
_EXPLAINED = 1 / 3  # largest share of the scatter that a cause may leave
_P_VALUE = 1e-3
_UNRECORDED = (
    ("temperature", ("temperature", "case_temperature")),
    ("gravity_i", ("gravity_i", "gravity_o", "gravity_s")),
)
"""Causes that may differ between runs, and the channels any of which records them."""
NOISE_P_VALUE = 1e-3
NOISE_RATIO = 1.3
NOISE_AVERAGES_S = (300.0, 3600.0)
MOST_APART = 1.25  # ratio of declared to measured N that is reported; the filter accepts N within 10 %
WHITE_EXCESS = 1.5  # ratio of measured to declared N from which the white noise itself is an excess
_LOG_VARIANCE_OF_PAIR = 8.1  # variance of the logarithm of a white variance, times the pairs whose median it rests on
LEAST_OF_DECLARED = 1 / 1.3  # ratio of variances of long averages below which the declared noise is too large


@dataclass(frozen=True)
class RunScatter:
    """Mean residual of each run, and its standard deviation due to the noise within the run."""

    means: FloatArray
    within: FloatArray

    @property
    def scatter(self) -> float:
        """Standard deviation of the means; 0 for one run."""
        return float(np.std(self.means, ddof=1)) if self.means.size > 1 else 0.0

    @property
    def ratio(self) -> float:
        """Scatter over the noise of a mean."""
        return self.scatter / max(float(np.sqrt(np.mean(self.within**2))), 1e-300)

    def bounds(self) -> tuple[float, float]:
        """95 % confidence bounds of the scatter."""
        degrees = self.means.size - 1
        squares = degrees * self.scatter**2
        return math.sqrt(squares / chi_square_isf(0.025, degrees)), math.sqrt(squares / chi_square_isf(0.975, degrees))

    def disagrees_with(self, turn_on: float) -> bool:
        """Whether the means contradict a declared turn-on scatter at 1 in 1000."""
        degrees = self.means.size - 1
        if degrees < 1:
            return False
        expected = turn_on**2 + float(np.mean(self.within**2))
        chi_square = degrees * self.scatter**2 / max(expected, 1e-300)
        p_value = min(float(chi_square_sf(chi_square, degrees)), float(chi_square_cdf(chi_square, degrees)))
        return p_value < _P_VALUE / 2


def run_scatter(record: UnitRecord, noise: ModelNoise) -> RunScatter:
    """Means of the runs of a unit beside the declared model, with the fitted noise."""
    quiet = msgspec.structs.replace(noise, turn_on=0.0)
    white = record.noise_model.space(quiet).white
    number = record.stack.run_number
    residual = record.value - record.design @ fit(record.design, record.value).coefficients
    means, within = [], []
    for run in range(len(record.stack.runs)):
        of_run = number == run
        weights = of_run / np.count_nonzero(of_run)
        means.append(float(residual[of_run].mean()))
        variance = correlated_variance(record, quiet, of_run, weights)
        within.append(math.sqrt(variance + white * float(np.sum(np.median(record.white[of_run]) * weights**2))))
    return RunScatter(np.array(means), np.array(within))


def scatter_finding(
    record: UnitRecord, scatter: RunScatter, declared: Collection[str], available: Mapping[str, Effect]
) -> FoundEffect | None:
    """Turn-on scatter with its alternatives; None if the runs agree, or are enough for the search."""
    runs = record.stack.runs
    if not 2 <= len(runs) <= MOST_RUNS or scatter.ratio < FAR:
        return None
    others = _recorded(runs, scatter, declared, available) + _unrecorded(runs, declared)
    if not others:
        return None
    unit = runs[0].unit_of_measure
    chi_square = float(np.sum(((scatter.means - scatter.means.mean()) / scatter.within) ** 2))
    equivalent = float(one_degree(chi_square, len(runs) - 1))
    low, high = scatter.bounds()
    rows = zip(runs, scatter.means, scatter.within, strict=True)
    return FoundEffect(
        name=TURN_ON,
        parameters={},
        coefficients=(EffectCoefficient("", scatter.scatter, low, high, unit),),
        significance=math.sqrt(equivalent),
        evidence=equivalent - PRICE,
        roles={},
        confounded=tuple(others),
        by_run={run.run: (float(mean), float(se)) for run, mean, se in rows},
    )


def _recorded(
    runs: Sequence[RunBlocks], scatter: RunScatter, declared: Collection[str], available: Mapping[str, Effect]
) -> list[ConfoundedEffect]:
    """Recorded causes, one for each channel, that differ between the runs and explain most of the scatter."""
    found: dict[str, ConfoundedEffect] = {}
    for name, each in available.items():
        is_linear = each.kind is EffectKind.LIBRARY and each.role is Role.CAUSE and not each.parameters
        if not is_linear or len(each.needs) != 1 or name in declared or each.needs[0] in found:
            continue
        columns = [each.regressors(run, {}) for run in runs]
        if columns[0].shape[1] != 1 or not all(np.isfinite(column).all() for column in columns):
            continue
        means = np.array([float(column.mean()) for column in columns])
        inside = float(np.sqrt(np.mean([np.var(column) for column in columns])))
        differs = np.std(means, ddof=1) > max(inside, 1e-9 * float(np.abs(means).max()))
        if differs and _left(means, scatter) < _EXPLAINED * scatter.scatter:
            found[each.needs[0]] = unfitted(each, recorded=True, evidence_behind=0.0)
    return [found[channel] for channel in sorted(found)]


def _left(driver: FloatArray, scatter: RunScatter) -> float:
    """Scatter of the runs about a line in a driver."""
    if driver.size == 2:
        return 0.0
    design = np.column_stack([np.ones_like(driver), driver])
    left = scatter.means - design @ fit(design, scatter.means).coefficients
    return float(np.sqrt(left @ left / (driver.size - 2)))


def _unrecorded(runs: Sequence[RunBlocks], declared: Collection[str]) -> list[ConfoundedEffect]:
    known = set.union(*(set(run.channels) for run in runs))
    return [
        unfitted(effects()[name], recorded=False)
        for name, channels in _UNRECORDED
        if name not in declared and not known.intersection((*channels, "position"))
    ]


def scatter_caveat(finding: FoundEffect | None, scatter: RunScatter, runs: Sequence[RunBlocks]) -> Bilingual:
    """Undeclared turn-on scatter far above the noise within the runs, with its possible causes if it is a finding."""
    size = f"{scatter.scatter:.4g} {runs[0].unit_of_measure}"
    en = f"the runs differ by {size} (one standard deviation), {scatter.ratio:.3g} times the noise within them: "
    zh = f"各次试验相差{size}（一倍标准差），为试验内噪声的{scatter.ratio:.3g}倍："
    if finding is None:
        return Bilingual(
            f"{en}this is attributed to turn-on scatter, which was not declared and can hide an effect that changes "
            "only between runs",
            f"{zh}已视为逐次启动散布（未声明），仅在试验之间变化的效应可能隐藏其中",
        )
    names = [(effect_name(each.name), each.recorded) for each in finding.confounded] + [(effect_name(TURN_ON), True)]
    causes = ", ".join(f"{name}{'' if recorded else ' (not recorded)'}" for name, recorded in names)
    causes_zh = "、".join(f"{name.zh}{'' if recorded else '（未记录）'}" for name, recorded in names)
    return Bilingual(
        f"{en}{causes} differ between them, and {len(runs)} runs cannot separate these causes",
        f"{zh}其间{causes_zh}均不同，{len(runs)}次试验无法区分",
    )


@dataclass(frozen=True)
class NoiseExcess:
    """Test of the declared noise: largest and least ratio of measured to declared variance of averages.

    `slow_p_value` is that of the slow noise, whose ratio is `slow_ratio`, and `other_slow_p_value` that without the
    replicate that contributes most; `white_p_value` that of a white noise of `WHITE_EXCESS` times the declared one.
    `most_slow_ratio` is to what the unit's own Allan fits allow, where these give the declared noise: a random walk
    that no run of an hour shows may be three times the declared one.
    """

    ratio: float
    least_ratio: float
    slow_ratio: float
    slow_p_value: float
    other_slow_p_value: float
    white_p_value: float
    most_slow_ratio: float

    @property
    def is_slow_excess(self) -> bool:
        """Whether there is more slow noise than declared, or than the Allan fits that give it allow."""
        return self.slow_p_value < NOISE_P_VALUE and self.slow_ratio > NOISE_RATIO and self.most_slow_ratio > 1.0

    @property
    def is_slow_excess_allowed(self) -> bool:
        """Whether there is more slow noise than declared, and no more than the Allan fits that give it allow."""
        return self.slow_p_value < NOISE_P_VALUE and self.slow_ratio > NOISE_RATIO and self.most_slow_ratio <= 1.0

    @property
    def is_excess(self) -> bool:
        """Whether there is more noise than declared."""
        return self.is_slow_excess or self.is_white_excess

    @property
    def is_white_excess(self) -> bool:
        """Whether the white noise itself is far larger than declared."""
        return self.white_p_value < NOISE_P_VALUE and self.ratio > NOISE_RATIO

    @property
    def repeats(self) -> bool:
        """Whether there is more noise than declared in several replicates: no event of one of them explains it."""
        return self.is_white_excess or (self.is_slow_excess and self.other_slow_p_value < NOISE_P_VALUE)


def noise_excess(record: UnitRecord, joint: JointFit, most: tuple[float, float, float] | None = None) -> NoiseExcess:
    """Compare the noise of the first record, as fitted and measured, with the centre of its prior.

    `most` is that which the unit's own Allan fits allow, see `ModelNoise`.
    """
    fitted, declared = joint.noises[0], record.prior.center
    columns = joint.hypothesis.designs[0]
    as_fitted, as_declared = evaluate(record, columns, fitted), evaluate(record, columns, declared)
    gain = as_fitted.log_likelihood - as_declared.log_likelihood
    gains = np.bincount(record.stack.replicate, as_fitted.of_blocks - as_declared.of_blocks)
    degrees = int(np.count_nonzero(as_array(declared)))
    slow, ratios = (
        [_variance_ratio(record, each, declared, s) for s in NOISE_AVERAGES_S]
        for each in (fitted, measured_noise(record, fitted))
    )
    allowed = from_array(np.maximum(as_array(declared), [*(most or (0.0, 0.0, 0.0)), 0.0]))
    # median of squares: efficiency 0.37; neighbouring differences correlate by half: 2 * 1.5 / 0.37
    deviation = math.sqrt(_LOG_VARIANCE_OF_PAIR / max(1, int(np.count_nonzero(record.steps > 0))))
    beyond = math.log(float(np.median(record.white))) - 2 * math.log(WHITE_EXCESS)
    return NoiseExcess(
        ratio=max(ratios),
        least_ratio=min(slow),
        slow_ratio=max(slow),
        slow_p_value=float(chi_square_sf(max(0.0, 2 * gain), degrees)),
        other_slow_p_value=float(chi_square_sf(max(0.0, 2 * (gain - float(gains.max()))), degrees)),
        white_p_value=float(normal_sf(beyond / deviation)),
        most_slow_ratio=max(_variance_ratio(record, fitted, allowed, s) for s in NOISE_AVERAGES_S),
    )


def _variance_ratio(record: UnitRecord, noise: ModelNoise, declared: ModelNoise, seconds: float) -> float:
    """Ratio of the variances of averages of a duration."""
    variance = record.noise_model.average_variance
    return variance(noise, seconds) / variance(declared, seconds)


def measured_noise(record: UnitRecord, noise: ModelNoise) -> ModelNoise:
    """The fitted noise with N scaled by the median white variance of the blocks.

    The filter weights each block by the scatter of its neighbours relative to the declared N, so that an error of the
    declared N appears in the weights, not in the fitted N.
    """
    return msgspec.structs.replace(noise, N=noise.N * math.sqrt(float(np.median(record.white))))


def disagreements(
    declared: ModelNoise, measured: ModelNoise, excess: NoiseExcess, scatter: RunScatter | None
) -> Iterator[Bilingual]:
    """Caveats on differences of declared and measured noise; `scatter` is None if turn-on scatter was not declared."""
    if not 1 / MOST_APART < measured.N / declared.N < MOST_APART:
        yield Bilingual(
            f"the white noise N declared, or else of the unit's own Allan curves, is {declared.N:.3g}, but "
            f"{measured.N:.3g} was measured in these runs",
            f"白噪声N声明为{declared.N:.3g}（未声明时取自产品自身Allan曲线），而这些试验中实测为{measured.N:.3g}：两者不符",
        )
    if excess.slow_p_value < NOISE_P_VALUE and excess.least_ratio < LEAST_OF_DECLARED:
        ratio = f"{excess.least_ratio:.2g}"
        yield Bilingual(
            "less noise at averages of 300 to 3600 s than declared, or else than the unit's own Allan curves have: the "
            f"variance is {ratio} times theirs, so that small effects may have been attributed to noise",
            f"在300至3600 s的平均时间上噪声小于声明值（未声明时为产品自身Allan曲线的值）：其方差为该值的{ratio}倍，"
            "较小的效应可能被当作噪声",
        )
    if excess.is_slow_excess_allowed:
        yield Bilingual(
            f"at averages of 300 to 3600 s the variance is {excess.slow_ratio:.2g} times that of the noise taken from "
            "the unit's own Allan curves, which do not bound slow noise to less: a slow effect of no recorded channel "
            "cannot be distinguished from it; measure longer runs, or declare the noise (--noise)",
            f"在300至3600 s的平均时间上方差为取自产品自身Allan曲线的噪声的{excess.slow_ratio:.2g}倍，这些曲线对慢噪声"
            "的上限并不更低：无法与未记录通道的慢变效应区分；请延长测试，或用--noise声明噪声",
        )
    if scatter is not None and scatter.disagrees_with(declared.turn_on):
        yield Bilingual(
            f"the declared turn-on scatter is {declared.turn_on:.3g}, but the runs scatter by {scatter.scatter:.3g}",
            f"逐次启动散布声明为{declared.turn_on:.3g}，而各次试验的散布为{scatter.scatter:.3g}：两者不符",
        )
