"""Comparison of the declared noise with the fitted noise."""

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from scipy import stats

from analytics.loop.bilingual import Bilingual
from analytics.loop.model.noise import ModelNoise
from analytics.loop.tracing.verdict.run_scatter import RunScatter
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.unit_record import UnitRecord, as_array
from analytics.loop.tracing.whitening.whitened_fit import evaluate

NOISE_P_VALUE = 1e-3
NOISE_RATIO = 1.3
NOISE_AVERAGES_S = (300.0, 3600.0)
MOST_APART = 1.25
"""Ratio of declared to measured N, either way, that is reported; the filter accepts declared N within 10 %."""
LEAST_OF_DECLARED = 1 / 1.3
"""Ratio of variances of long averages below which the declared noise is too large."""


@dataclass(frozen=True)
class NoiseExcess:
    """Test of the declared noise: largest and least ratio of fitted to declared variance of averages, and p-value."""

    ratio: float
    p_value: float
    least_ratio: float

    @property
    def is_excess(self) -> bool:
        """Whether there is more noise than declared."""
        return self.p_value < NOISE_P_VALUE and self.ratio > NOISE_RATIO


def noise_excess(record: UnitRecord, joint: JointFit) -> NoiseExcess:
    """Compare the fitted noise of the first record with the centre of its prior."""
    fitted, declared = joint.noises[0], record.prior.center
    columns = joint.hypothesis.designs[0]
    gain = evaluate(record, columns, fitted).log_likelihood - evaluate(record, columns, declared).log_likelihood
    ratios = [
        record.noise_model.average_variance(fitted, seconds) / record.noise_model.average_variance(declared, seconds)
        for seconds in NOISE_AVERAGES_S
    ]
    degrees = int(np.count_nonzero(as_array(declared)))
    return NoiseExcess(max(ratios), float(stats.chi2.sf(max(0.0, 2 * gain), degrees)), min(ratios))


def measured_noise(record: UnitRecord, noise: ModelNoise) -> ModelNoise:
    """The fitted noise with N scaled by the median white variance of the blocks.

    The filter weights each block by the scatter of its neighbours relative to the declared N, so that an error of the
    declared N appears in the weights, not in the fitted N.
    """
    return msgspec.structs.replace(noise, N=noise.N * math.sqrt(float(np.median(record.white))))


def disagreements(
    declared: ModelNoise, measured: ModelNoise, excess: NoiseExcess, scatter: RunScatter | None
) -> list[Bilingual]:
    """Caveats on differences of declared and measured noise; `scatter` is None if turn-on scatter was not declared."""
    texts = []
    if not 1 / MOST_APART < measured.N / declared.N < MOST_APART:
        texts.append(
            Bilingual(
                f"the declared white noise N is {declared.N:.3g}, but {measured.N:.3g} was measured in these runs",
                f"白噪声N声明为{declared.N:.3g}，而这些试验中实测为{measured.N:.3g}：两者不符",
            )
        )
    if excess.p_value < NOISE_P_VALUE and excess.least_ratio < LEAST_OF_DECLARED:
        ratio = f"{excess.least_ratio:.2g}"
        texts.append(
            Bilingual(
                f"less noise than declared at averages of 300 to 3600 s: the variance is {ratio} times the declared "
                "one, so that small effects may have been attributed to noise",
                f"在300至3600 s的平均时间上噪声小于声明值：其方差为声明值的{ratio}倍，较小的效应可能被当作噪声",
            )
        )
    if scatter is not None and scatter.disagrees_with(declared.turn_on):
        texts.append(
            Bilingual(
                f"the declared turn-on scatter is {declared.turn_on:.3g}, but the runs scatter by "
                f"{scatter.scatter:.3g}",
                f"逐次启动散布声明为{declared.turn_on:.3g}，而各次试验的散布为{scatter.scatter:.3g}：两者不符",
            )
        )
    return texts
