"""Scale factor that settles after power-on."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Shape, ShapeParameter
from analytics.loop.effects.shape_values import positive
from analytics.loop.effects.warm_up import decay_simulated
from stream.batch import FloatArray


class ScaleFactorWarmUp(Effect):
    """Input rate times exp(-t/time_constant), t being the time since power-on."""

    name = "scale_factor_warm_up"
    en = "scale-factor warm-up"
    zh = "标度因数通电预热"
    needs = ("input_rate", "time_since_power_on")
    parameters = (
        ShapeParameter("time_constant", "s", (600.0, 1800.0, 5400.0), "warm-up time constant", "预热时间常数"),
    )
    per = "{input_rate}"
    cause = (
        "The source's wavelength and the gain of the electronics settle after power-on as they heat themselves. "
        "The scale factor settles with them."
    )
    cause_zh = "通电后光源波长和电路增益随自身发热逐渐稳定。标度因数随之稳定。"
    reference = "IEEE 952-2020, scale factor and warm-up; GJB 2426A-2004 5.8"
    aliases = ("scale_factor_temperature", "warm_up")
    separating_test = "repeat the same rates early and late after power-on at a soaked temperature"
    separating_test_zh = "充分保温后通电，在通电初期与后期重复相同的角速率"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        left = np.exp(-run.mean("time_since_power_on") / positive(shape, "time_constant"))
        return (run.mean("input_rate") * left)[:, None]

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        left = decay_simulated(time_s, channels["time_since_power_on"], positive(shape, "time_constant"))
        return coefficients[0] * channels["input_rate"] * left
