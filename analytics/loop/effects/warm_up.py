"""Bias that settles after power-on."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Shape, ShapeParameter
from analytics.loop.effects.shape_values import positive
from stream.batch import FloatArray

WARM_UP_GRID_S = (300.0, 495.0, 817.0, 1350.0, 2230.0, 3680.0, 6080.0, 10000.0)


def decay_simulated(time_s: FloatArray, since_power_on_s: FloatArray, time_constant_s: float) -> FloatArray:
    """What is left of 1 after power-on, by integrating dx/dt = -x/time_constant; each power-on starts it again."""
    left = np.exp(-since_power_on_s[0] / time_constant_s)
    course = np.empty(time_s.size)
    course[0] = left
    for i in range(1, time_s.size):
        if since_power_on_s[i] < since_power_on_s[i - 1]:
            left = np.exp(-since_power_on_s[i] / time_constant_s)
        else:
            half = 0.5 * (since_power_on_s[i] - since_power_on_s[i - 1]) / time_constant_s
            left *= (1.0 - half) / (1.0 + half)
        course[i] = left
    return course


class WarmUp(Effect):
    """Bias that dies out as exp(-t/time_constant), t being the time since power-on."""

    name = "warm_up"
    en = "warm-up after power-on"
    zh = "通电预热"
    needs = ("time_since_power_on",)
    parameters = (ShapeParameter("time_constant", "s", WARM_UP_GRID_S, "warm-up time constant", "预热时间常数"),)
    cause = (
        "Source, electronics and drive heat themselves after power-on, where the temperature sensor hardly sees it. "
        "The bias settles as they come to equilibrium."
    )
    cause_zh = "通电后光源、电路和驱动自身发热，温度传感器几乎测不到。零偏随其达到热平衡而稳定。"
    reference = "IEEE 952-2020, warm-up time; GJB 2426A-2004, start-up time; JJF 2014-2022"
    aliases = ("temperature", "thermal_lag", "drift_in_run")
    separating_test = "power on when gyro and fixture are soaked already, at two temperatures"
    separating_test_zh = "在两个温度下，待陀螺与工装充分保温后再通电"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return np.exp(-run.mean("time_since_power_on") / positive(shape, "time_constant"))[:, None]

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        since_s = channels["time_since_power_on"]
        return coefficients[0] * decay_simulated(time_s, since_s, positive(shape, "time_constant"))
