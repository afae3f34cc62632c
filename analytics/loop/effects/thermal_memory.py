"""Bias by the history of the temperature: thermal lag and hysteresis."""

from collections.abc import Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Inputs, Shape, ShapeParameter, positive
from analytics.loop.effects.time_kernels import lagged, played
from stream.batch import FloatArray


class ThermalLag(Effect):
    """Bias in proportion to the temperature of a part that lags the sensor with a time constant, minus the sensor's.

    Both are equal at the first reading of a run.
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
        "The part that determines the bias lies deeper than the temperature sensor and follows it with a first-order "
        "lag. While the temperature changes, a model based on the sensor is in error in proportion to the difference."
    )
    cause_zh = "决定零偏的部件比温度传感器更靠内，以一阶滞后跟随其温度。温度变化期间，按传感器读数建模会差此温差。"
    reference = "IEEE 952-2020, bias temperature model; GJB 2426A-2004 5.12.4 (soak time)"
    aliases = ("temperature_rate", "case_temperature_rate", "temperature_gradient", "thermal_hysteresis", "warm_up")
    separating_test = "temperature steps with dwells of five time constants: a lag decays, hysteresis remains"
    separating_test_zh = "温度阶跃后保温五倍时间常数：滞后会消失，迟滞则保留"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        behind = lagged(run, "temperature", positive(shape, "time_constant"))
        return (behind - run.mean("temperature"))[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        sensor, time_constant_s = channels["temperature"], positive(shape, "time_constant")
        inner = sensor[0]
        difference = np.zeros(time_s.size)
        for i in range(1, time_s.size):
            # trapezoidal step of time_constant * d(inner)/dt = sensor - inner
            half = 0.5 * (time_s[i] - time_s[i - 1]) / time_constant_s
            inner = (inner * (1.0 - half) + half * (sensor[i - 1] + sensor[i])) / (1.0 + half)
            difference[i] = inner - sensor[i]
        return coefficients[0] * difference


class ThermalHysteresis(Effect):
    """Bias in proportion to the output of a play (backlash) on the temperature, minus the temperature.

    The loop is `width` wide and centred on the first reading of a run.
    """

    name = "thermal_hysteresis"
    en = "thermal hysteresis"
    zh = "热迟滞"
    needs = ("temperature",)
    parameters = (
        ShapeParameter("width", "{temperature}", (0.04, 0.1, 0.18, 0.25, 0.4), "width of the loop", "迟滞回线宽度"),
    )
    per = "{temperature}"
    cause = (
        "Adhesive joints and preloaded contacts slip only when thermal strain exceeds friction. After each reversal "
        "of the temperature the bias lags by up to half the width of the loop, and waiting does not reduce it."
    )
    cause_zh = (
        "胶接面和预紧接触面仅在热应变超过摩擦时滑移。温度每次反向后零偏落后，最多为迟滞回线宽度的一半，且不随等待消失。"
    )
    reference = (
        "Krasnosel'skii and Pokrovskii, Systems with Hysteresis, Springer 1989; IEEE 952-2020, thermal hysteresis"
    )
    aliases = ("thermal_lag", "temperature_rate")
    separating_test = "closed temperature loops with different turning points, with dwells on both branches"
    separating_test_zh = "具有不同转折点的闭合温度循环，升降两支均保温"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return (played(run, "temperature", positive(shape, "width")) - run.mean("temperature"))[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        stretch = positive(shape, "width") / 2
        elastic = np.zeros(time_s.size)
        for i, step in enumerate(np.diff(channels["temperature"]), 1):
            # the spring between sensor and slider stretches until the slider slips
            elastic[i] = min(max(elastic[i - 1] + step, -stretch), stretch)
        return -coefficients[0] * elastic
