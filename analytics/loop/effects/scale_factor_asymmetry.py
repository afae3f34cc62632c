"""Scale factor that differs between the two directions of turning."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Shape
from analytics.loop.effects.within_block import mean_magnitude
from stream.batch import FloatArray


class ScaleFactorAsymmetry(Effect):
    """Error in proportion to the magnitude of the input rate."""

    name = "scale_factor_asymmetry"
    en = "scale-factor asymmetry"
    zh = "标度因数不对称"
    needs = ("input_rate",)
    per = "{input_rate}"
    cause = (
        "Modulation and digital-analogue conversion differ a little between the two signs of the feedback. The scale "
        "factor then differs between the directions, and half the difference times |rate| looks like a bias."
    )
    cause_zh = "反馈两个极性的调制和数模转换略有差异。正反转标度因数因此不同，其半差乘以角速率绝对值表现为零偏。"
    reference = "IEEE 952-2020, scale-factor asymmetry; GJB 2426A-2004 5.8; CN 102680005"
    aliases = ("scale_factor_quadratic",)
    separating_test = "pairs of equal rates in both directions, at three or more rates"
    separating_test_zh = "三档以上角速率，每档正反转成对测量"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return mean_magnitude(run.channels["input_rate"])[:, None]

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        rate = channels["input_rate"]
        forward, backward = coefficients[0], -coefficients[0]
        return np.where(rate >= 0.0, forward, backward) * rate
