"""Bias from the inside of the gyro being behind the temperature that is measured."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Shape, ShapeParameter
from analytics.loop.effects.shape_values import positive
from analytics.loop.effects.time_kernels import lagged
from stream.batch import FloatArray


class ThermalLag(Effect):
    """Bias in proportion to the temperature of a part that follows the sensor with a time constant, minus the sensor's.

    Both agree at the first reading of a run; a run starts soaked.
    """

    name = "thermal_lag"
    en = "thermal lag"
    zh = "热滞后（时间常数）"
    needs = ("temperature",)
    parameters = (
        ShapeParameter(
            "time_constant",
            "s",
            (600.0, 900.0, 1340.0, 2000.0, 3000.0, 4480.0, 6690.0, 10000.0),
            "thermal time constant",
            "热时间常数",
        ),
    )
    per = "{temperature}"
    cause = (
        "The part that sets the bias lies deeper than the temperature sensor and follows it as a first-order lag. "
        "While the temperature moves, a model of the sensor's reading is wrong by the difference."
    )
    cause_zh = "决定零偏的部件比温度传感器更靠内，以一阶滞后跟随其温度。温度变化期间，按传感器读数建模会差此温差。"
    reference = "IEEE 952-2020, bias temperature model; GJB 2426A-2004 5.12.4 (soak time)"
    aliases = ("temperature_rate", "case_temperature_rate", "temperature_gradient", "thermal_hysteresis", "warm_up")
    separating_test = "temperature steps with dwells of five time constants: the lag dies out, a loop stays"
    separating_test_zh = "温度阶跃后保温五倍时间常数：滞后会消失，回滞则保留"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        behind = lagged(run, "temperature", positive(shape, "time_constant"))
        return (behind - run.mean("temperature"))[:, None]

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        sensor, time_constant_s = channels["temperature"], positive(shape, "time_constant")
        inner = sensor[0]
        difference = np.zeros(time_s.size)
        for i in range(1, time_s.size):
            # trapezoidal step of time_constant * d(inner)/dt = sensor - inner
            half = 0.5 * (time_s[i] - time_s[i - 1]) / time_constant_s
            inner = (inner * (1.0 - half) + half * (sensor[i - 1] + sensor[i])) / (1.0 + half)
            difference[i] = inner - sensor[i]
        return coefficients[0] * difference
