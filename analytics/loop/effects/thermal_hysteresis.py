"""Bias that differs between heating and cooling and keeps the difference while the temperature rests."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Shape, ShapeParameter
from analytics.loop.effects.shape_values import positive
from analytics.loop.effects.time_kernels import played
from stream.batch import FloatArray


class ThermalHysteresis(Effect):
    """Bias in proportion to a play (backlash) of the temperature, minus the temperature.

    The loop is `width` wide; the first reading of a run stands in the middle of it.
    """

    name = "thermal_hysteresis"
    en = "thermal hysteresis"
    zh = "热回滞"
    needs = ("temperature",)
    parameters = (
        ShapeParameter(
            "width", "{temperature}", (0.04, 0.1, 0.18, 0.25, 0.4), "width of the loop", "回线宽度", "temperature"
        ),
    )
    per = "{temperature}"
    cause = (
        "Adhesive joints and preloaded contacts slip only when thermal strain exceeds friction. After each turn of "
        "the temperature the bias stays behind by up to half the width of the loop, for as long as one waits."
    )
    cause_zh = "胶接面和预紧接触面仅在热应变超过摩擦时滑移。温度每次反向后零偏落后，最多半个回线宽度，且不随等待消失。"
    reference = (
        "Krasnosel'skii and Pokrovskii, Systems with Hysteresis, Springer 1989; IEEE 952-2020, thermal hysteresis"
    )
    aliases = ("thermal_lag", "temperature_rate")
    separating_test = "closed temperature loops with different turning points, with dwells on both branches"
    separating_test_zh = "具有不同转折点的闭合温度循环，升降两支均保温"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return (played(run, "temperature", positive(shape, "width")) - run.mean("temperature"))[:, None]

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        stretch = positive(shape, "width") / 2
        elastic = np.zeros(time_s.size)
        for i, step in enumerate(np.diff(channels["temperature"]), 1):
            # the spring between sensor and slider stretches until the slider slips
            elastic[i] = min(max(elastic[i - 1] + step, -stretch), stretch)
        return -coefficients[0] * elastic
