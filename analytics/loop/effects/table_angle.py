"""Errors that repeat with the table angle: harmonics, heading, and a general periodic function."""

import math
from collections.abc import Sequence

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import HARMONICS, RunBlocks
from analytics.loop.effects.base import Effect, EffectKind, Inputs, Shape
from analytics.loop.effects.block_kernels import phasor, radians_per_unit
from stream.batch import FloatArray
from stream.errors import BadInput

_ORDINAL = {1: ("once", "一"), 2: ("twice", "二"), 3: ("three times", "三"), 4: ("four times", "四")}
_CENTRES = 16
_ORDERS = 16
_WIDTH_RAD = np.deg2rad(16.0)


class _OfTableAngle(Effect):
    """Effect that needs the table angle in a unit of angle."""

    def unavailable(self, runs: Sequence[RunBlocks]) -> Bilingual | None:
        if (reason := super().unavailable(runs)) is not None:
            return reason
        for run in runs:
            try:
                radians_per_unit(run.channels["table_angle"])
            except BadInput as error:
                return Bilingual(f"channel table_angle: {error}", f"通道table_angle：{error}")
        return None


class TableAngleHarmonic(_OfTableAngle):
    """Cosine and sine of a multiple of the table angle: `harmonic` periods in one revolution, from 1 to 4."""

    needs = ("table_angle",)
    coefficients = ("cos", "sin")
    cause = (
        "Wobble of the table axis, errors of its encoder and the magnetic field in which the gyro turns repeat with "
        "every revolution. Each harmonic has its own source: levelling and earth rate the first, field and bearings "
        "the second, motor poles the higher ones."
    )
    cause_zh = (
        "台轴晃动、角编码器误差和陀螺所处磁场随每圈重复。各次成因不同：调平和地速为一次，轴承为二次，电机极对为高次。"
    )
    reference = "JJF 2014-2022, rate table; IEEE 952-2020, rate table tests; GJB 2426A-2004"
    separating_test = "static at 16 or more table angles, and again with the gyro turned by 90 deg on the table"
    separating_test_zh = "在16个以上台面角度静态测量，并将陀螺在台面上转过90度重复"

    def __init__(self, harmonic: int) -> None:
        times, times_zh = _ORDINAL[harmonic]
        self.harmonic = harmonic
        self.name = f"table_angle_harmonic_{harmonic}"
        self.en = f"table angle, {times} per turn"
        self.zh = f"转台角度{times_zh}次谐波"
        self.aliases = ("heading", "periodic_line") if harmonic == 1 else ("periodic_line",)

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        mean = phasor(run, "table_angle", self.harmonic)
        return np.stack([mean.real, mean.imag], axis=1)

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        cos, sin = coefficients
        crest = math.atan2(sin, cos)
        return math.hypot(cos, sin) * np.cos(self.harmonic * np.deg2rad(channels["table_angle"]) - crest)


EFFECTS = tuple(TableAngleHarmonic(harmonic) for harmonic in range(1, HARMONICS + 1))


class Heading(_OfTableAngle):
    """Cosine and sine of the table angle, times the horizontal component of the input axis."""

    name, en, zh = "heading", "heading error (horizontal earth rate)", "航向误差（地速水平分量）"
    needs = ("table_angle", "gravity_i")
    coefficients = ("cos", "sin")
    cause = (
        "A horizontal input axis senses the horizontal earth rate times the cosine of its heading, up to 15.04 deg/h "
        "times cos(latitude). A wrong north reference or incomplete compensation remains as cosine and sine."
    )
    cause_zh = "水平放置的输入轴按航向余弦敏感地速水平分量。北向基准有误或扣除不净时留下余弦与正弦项。"
    reference = "IEEE 952-2020, earth-rate tests; GJB 2426A-2004 (bias by azimuth); HIT 2012 (3)"
    aliases = ("table_angle_harmonic_1", "gravity_o", "gravity_s")
    separating_test = "static at four or more headings with the input axis horizontal, and again with it vertical"
    separating_test_zh = "输入轴水平时在四个以上航向静态测量，再竖直放置重复"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        level = np.sqrt(np.maximum(1.0 - run.mean("gravity_i") ** 2, 0.0))
        mean = phasor(run, "table_angle", 1)
        return np.stack([level * mean.real, level * mean.imag], axis=1)

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        tilt = np.arcsin(np.clip(channels["gravity_i"], -1.0, 1.0))
        heading = np.deg2rad(channels["table_angle"])
        north, east = coefficients
        return np.cos(tilt) * (north * np.cos(heading) + east * np.sin(heading))


class FunctionOfTableAngle(_OfTableAngle):
    """Any smooth function of the table angle, up to a constant: sixteen bells around the circle except the first."""

    name, en, zh = "function_of_table_angle", "function of table angle", "转台角度的未知函数"
    needs = ("table_angle",)
    kind = EffectKind.FUNCTION
    coefficients = tuple(f"at_{360.0 * k / _CENTRES:g}_deg" for k in range(1, _CENTRES))
    cause = (
        "The error repeats with the table angle and has more than four harmonics, as from a faulty encoder sector or "
        "a cable under tension. The curve shows which angles to examine."
    )
    cause_zh = "误差随转台角度重复，且高于四次谐波，例如编码器某一扇区故障或电缆牵扯。曲线指出了应查的角度。"
    reference = "JJF 2014-2022, rate table; IEEE 952-2020, rate table tests"
    separating_test = "static at 32 table angles, in both directions"
    separating_test_zh = "在32个台面角度静态测量，正反向各一遍"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        orders = np.arange(1, _ORDERS + 1)
        phasors = np.stack([phasor(run, "table_angle", int(order)) for order in orders], axis=1)
        # Fourier series of a bell; if the table rotates within a block, the phasors vanish and all bells are equal
        series = 2.0 * np.exp(-0.5 * (orders * _WIDTH_RAD) ** 2)
        centres = 2.0 * np.pi * np.arange(_CENTRES) / _CENTRES
        bells = 1.0 + ((phasors * series) @ np.exp(-1j * np.outer(orders, centres))).real
        return np.asarray(bells / _CENTRES, np.float64)[:, 1:]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        heights = np.array([0.0, *coefficients])
        angle = np.deg2rad(channels["table_angle"])
        weighted, total = np.zeros(time_s.size), np.zeros(time_s.size)
        for k, height in enumerate(heights):
            off = np.arctan2(np.sin(angle - 2.0 * np.pi * k / _CENTRES), np.cos(angle - 2.0 * np.pi * k / _CENTRES))
            bell = np.exp(-0.5 * (off / _WIDTH_RAD) ** 2)
            weighted += height * bell
            total += bell
        return np.asarray(weighted / total)
