"""Turn-on scatter: the bias differs from power-on to power-on."""

from collections.abc import Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, EffectKind, Inputs, Shape
from stream.batch import FloatArray

TURN_ON = "turn_on"


class TurnOnScatter(Effect):
    """One constant per run. It is noise and not searched for, but may explain a difference between runs."""

    name = TURN_ON
    en = "turn-on scatter"
    zh = "逐次启动散布"
    needs = ()
    kind = EffectKind.EVENT
    cause = (
        "Each power-on leaves the loop, the source or the suspension in a slightly different state. The bias then "
        "differs from run to run by an amount that no recorded channel predicts."
    )
    cause_zh = "每次上电后回路、光源或支承的状态略有不同。零偏因此逐次不同，其大小无法由任何记录预测。"
    reference = "IEEE 528-2019, turn-on to turn-on bias; JJF 2014-2022 7.2.15"
    separating_test = "power on six times or more with temperature, position and supply held"
    separating_test_zh = "保持温度、位置和供电不变，重复上电六次以上"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return np.ones((len(run), 1))

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        return np.full(time_s.size, float(coefficients[0]))
