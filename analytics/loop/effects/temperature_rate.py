"""Shupe effect: bias by the rate of change of temperature."""

from collections.abc import Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Inputs, Shape, ShapeParameter, positive
from analytics.loop.effects.time_kernels import lagged, slope_per_s
from stream.batch import FloatArray


class TemperatureRate(Effect):
    """Bias in proportion to the rate of change of the gyro's temperature."""

    name = "temperature_rate"
    en = "temperature rate (Shupe)"
    zh = "温度变化率（Shupe效应）"
    needs = ("temperature",)
    per = "{temperature}/s"
    cause = (
        "The two beams pass a point of the coil at different times; if its temperature changes meanwhile, their "
        "phases differ. The bias is proportional to dT/dt, weighted by the distance from the midpoint of the coil."
    )
    cause_zh = "两束光在不同时刻经过光纤环同一点，其间温度变化使相位不同。零偏与dT/dt成正比，并按到环中点的距离加权。"
    reference = "Shupe, Applied Optics 19(5), 1980, 654-655; IEEE 952-2020, bias temperature ramp sensitivity"
    aliases = ("case_temperature_rate", "temperature_gradient", "thermal_lag", "temperature_time_offset")
    separating_test = "pass through the same temperatures at two or more ramp rates, up and down"
    separating_test_zh = "以两种以上变温速率升降通过同样的温度"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return slope_per_s(run, "temperature")[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        return coefficients[0] * np.gradient(channels["temperature"], time_s)


class CaseTemperatureRate(Effect):
    """Bias in proportion to the rate of change of the case's temperature after conduction to the coil."""

    name = "case_temperature_rate"
    en = "case temperature rate (Shupe at the coil)"
    zh = "壳体温度变化率（传至光纤环）"
    needs = ("case_temperature",)
    parameters = (
        ShapeParameter("time_constant", "s", (90.0, 300.0, 900.0, 2700.0), "heat conduction time", "热传导时间常数"),
    )
    per = "{case_temperature}/s"
    cause = (
        "Heat enters through the case and reaches the coil with the time constant of conduction. The Shupe bias "
        "follows the rate of change at the coil, where there is no sensor."
    )
    cause_zh = "热量由壳体经传导时间常数到达光纤环。Shupe零偏取决于未装传感器处的温度变化率。"
    reference = "Shupe, Applied Optics 19(5), 1980, 654-655; IEEE 952-2020, bias temperature ramp sensitivity"
    aliases = ("temperature_rate", "temperature_gradient", "thermal_lag")
    separating_test = "two or more ramp rates, with a second sensor at the coil"
    separating_test_zh = "两种以上变温速率，并在光纤环处加装第二个温度传感器"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        conducted = lagged(run, "case_temperature", positive(shape, "time_constant"))
        return slope_per_s(run, "case_temperature", conducted)[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        case, time_constant_s = channels["case_temperature"], positive(shape, "time_constant")
        coil = case[0]
        error = np.empty(time_s.size)
        for i, step_s in enumerate(np.diff(time_s, prepend=time_s[0])):
            coil += (case[i] - coil) * -np.expm1(-step_s / time_constant_s)
            error[i] = (case[i] - coil) / time_constant_s
        return coefficients[0] * error
