"""Error that repeats with each turn of the table, in one of four harmonics."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import HARMONICS, RunBlocks
from analytics.loop.effects.angle_phasors import phasor, radians_per_unit
from analytics.loop.effects.base import Effect, Shape
from stream.batch import FloatArray
from stream.errors import BadInput

_ORDINAL = {1: ("once", "一"), 2: ("twice", "二"), 3: ("three times", "三"), 4: ("four times", "四")}


class TableAngleHarmonic(Effect):
    """Cosine and sine of a multiple of the table angle.

    Parameters
    ----------
    harmonic: Periods in one turn of the table, from 1 to 4.

    Examples
    --------
    >>> TableAngleHarmonic(2).name
    'table_angle_harmonic_2'
    """

    needs = ("table_angle",)
    coefficients = ("cos", "sin")
    cause = (
        "Wobble of the table's axis, errors of its encoder and the field that the gyro turns in repeat with every "
        "turn. Each harmonic has its own maker: levelling and earth rate one, field and bearings two, poles more."
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

    @classmethod
    def instances(cls) -> Sequence[Effect]:
        return tuple(cls(harmonic) for harmonic in range(1, HARMONICS + 1))

    def unavailable(self, runs: Sequence[RunBlocks]) -> str | None:
        return super().unavailable(runs) or angle_unit_reason(runs)

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        mean = phasor(run, "table_angle", self.harmonic)
        return np.stack([mean.real, mean.imag], axis=1)

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        cos, sin = coefficients
        crest = math.atan2(sin, cos)
        return math.hypot(cos, sin) * np.cos(self.harmonic * np.deg2rad(channels["table_angle"]) - crest)


def angle_unit_reason(runs: Sequence[RunBlocks]) -> str | None:
    """Why the table angle of these runs is none to take a cosine of; None where it is."""
    for run in runs:
        try:
            radians_per_unit(run.channels["table_angle"])
        except BadInput as error:
            return f"channel table_angle: {error}"
    return None
