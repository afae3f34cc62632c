"""What is left of the earth's rate when the heading of the gyro is not rightly taken into account."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.angle_phasors import phasor
from analytics.loop.effects.base import Effect, Shape
from analytics.loop.effects.table_angle_harmonic import angle_unit_reason
from stream.batch import FloatArray


class Heading(Effect):
    """Cosine and sine of the table angle, as far as the input axis is level."""

    name = "heading"
    en = "heading error (horizontal earth rate)"
    zh = "航向误差（地速水平分量）"
    needs = ("table_angle", "gravity_i")
    coefficients = ("cos", "sin")
    cause = (
        "A level input axis sees the horizontal part of the earth's rate by the cosine of its heading, up to "
        "15.04 deg/h times cos(latitude). A wrong north reference or a part not taken off stays as cosine and sine."
    )
    cause_zh = "水平放置的输入轴按航向余弦敏感地速水平分量。北向基准有误或扣除不净时留下余弦与正弦项。"
    reference = "IEEE 952-2020, earth-rate tests; GJB 2426A-2004 (bias by azimuth); HIT 2012 (3)"
    aliases = ("table_angle_harmonic_1", "gravity_o", "gravity_s")
    separating_test = "static at four or more headings with the input axis level, and again with it vertical"
    separating_test_zh = "输入轴水平时在四个以上航向静态测量，再竖直放置重复"

    def unavailable(self, runs: Sequence[RunBlocks]) -> str | None:
        return super().unavailable(runs) or angle_unit_reason(runs)

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        level = np.sqrt(np.maximum(1.0 - run.mean("gravity_i") ** 2, 0.0))
        mean = phasor(run, "table_angle", 1)
        return np.stack([level * mean.real, level * mean.imag], axis=1)

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        tilt = np.arcsin(np.clip(channels["gravity_i"], -1.0, 1.0))
        heading = np.deg2rad(channels["table_angle"])
        north, east = coefficients
        return np.cos(tilt) * (north * np.cos(heading) + east * np.sin(heading))
