"""A general periodic function of the table angle."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.angle_phasors import phasor
from analytics.loop.effects.base import Effect, Kind, Shape
from analytics.loop.effects.table_angle_harmonic import angle_unit_reason
from stream.batch import FloatArray

_CENTRES = 16
_ORDERS = 16
_WIDTH_RAD = np.deg2rad(16.0)


class FunctionOfTableAngle(Effect):
    """Any smooth function of the table angle up to a constant: sixteen bells around the circle but the first."""

    name = "function_of_table_angle"
    en = "function of table angle"
    zh = "转台角度的未知函数"
    needs = ("table_angle",)
    kind = Kind.FUNCTION
    coefficients = tuple(f"at_{360.0 * k / _CENTRES:g}_deg" for k in range(1, _CENTRES))
    cause = (
        "The error repeats with the table angle along a curve with more than four harmonics, such as one faulty "
        "sector of an encoder or a cable that pulls. The curve tells at which angles to look."
    )
    cause_zh = "误差随转台角度重复，且高于四次谐波，例如编码器某一扇区故障或电缆牵扯。曲线指出了应查的角度。"
    reference = "JJF 2014-2022, rate table; IEEE 952-2020, rate table tests"
    separating_test = "static at 32 table angles, forwards and backwards"
    separating_test_zh = "在32个台面角度静态测量，正反向各一遍"

    def unavailable(self, runs: Sequence[RunBlocks]) -> str | None:
        return super().unavailable(runs) or angle_unit_reason(runs)

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        orders = np.arange(1, _ORDERS + 1)
        phasors = np.stack([phasor(run, "table_angle", int(order)) for order in orders], axis=1)
        # Fourier series of a bell; where the table turns within a block the phasors vanish and all bells are alike
        series = 2.0 * np.exp(-0.5 * (orders * _WIDTH_RAD) ** 2)
        centres = 2.0 * np.pi * np.arange(_CENTRES) / _CENTRES
        bells = 1.0 + ((phasors * series) @ np.exp(-1j * np.outer(orders, centres))).real
        return np.asarray(bells / _CENTRES, np.float64)[:, 1:]

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        heights = np.array([0.0, *coefficients])
        angle = np.deg2rad(channels["table_angle"])
        weighted, total = np.zeros(time_s.size), np.zeros(time_s.size)
        for k, height in enumerate(heights):
            off = np.arctan2(np.sin(angle - 2.0 * np.pi * k / _CENTRES), np.cos(angle - 2.0 * np.pi * k / _CENTRES))
            bell = np.exp(-0.5 * (off / _WIDTH_RAD) ** 2)
            weighted += height * bell
            total += bell
        return np.asarray(weighted / total)
