"""Small rates that the gyro does not see."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Shape, ShapeParameter
from analytics.loop.effects.shape_values import positive
from analytics.loop.effects.within_block import mean_inside
from stream.batch import FloatArray


class DeadZone(Effect):
    """Error in proportion to the input rate where its magnitude is below `half_width`."""

    name = "dead_zone"
    en = "dead zone about zero rate"
    zh = "零速率死区"
    needs = ("input_rate",)
    parameters = (
        ShapeParameter(
            "half_width",
            "{input_rate}",
            (0.001, 0.0014, 0.002, 0.0028, 0.004, 0.0057, 0.008, 0.011, 0.016, 0.023, 0.032),
            "half width of the dead zone",
            "死区半宽",
            "input_rate",
        ),
    )
    per = "{input_rate}"
    cause = (
        "Backscatter locks counter-running beams together, or electric crosstalk locks the loop, while the rate is "
        "small. Below this threshold the output stays at zero or falls short; above it the error is gone."
    )
    cause_zh = "角速率很小时，背向散射使两束光锁定，或电串扰使环路锁定。低于该阈值时输出为零或偏小，超过后误差消失。"
    reference = "IEEE 647-2006, lock-in; IEEE 952-2020, dead band; GJB 2426A-2004, threshold; JJF 2014-2022, threshold"
    aliases = ("scale_factor_cubic",)
    separating_test = "fine steps of rate about zero in both directions, below and above the threshold"
    separating_test_zh = "在零速率附近正反向细分角速率，覆盖阈值上下"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return mean_inside(run.channels["input_rate"], positive(shape, "half_width"))[:, None]

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        rate = channels["input_rate"]
        seen = np.where(np.abs(rate) >= positive(shape, "half_width"), rate, 0.0)
        return coefficients[0] * (rate - seen)
