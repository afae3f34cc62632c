"""A periodic line in the signal that no channel shows."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Kind, Shape, ShapeParameter
from analytics.loop.effects.shape_values import positive
from stream.batch import FloatArray


class PeriodicLine(Effect):
    """Cosine and sine of one frequency, with their phase counted from each run's start."""

    name = "periodic_line"
    en = "periodic line"
    zh = "周期性谱线"
    needs = ()
    kind = Kind.LINE
    parameters = (ShapeParameter("frequency_hz", "Hz", (), "frequency", "频率"),)
    coefficients = ("cos", "sin")
    cause = (
        "A thermostat, a compressor, a beat of two clocks or an aliased vibration line repeats with a fixed period. "
        "Its phase differs from run to run, its frequency does not."
    )
    cause_zh = "恒温器、压缩机、两时钟差拍或混叠的振动谱线以固定周期重复。各次测试相位不同而频率不变。"
    reference = "IEEE 952-2020, annex on spectral analysis (sinusoidal noise)"
    aliases = ("table_angle_harmonic_1",)
    separating_test = "record at the full sampling rate with each suspect (chamber, pump, table) switched off in turn"
    separating_test_zh = "以全采样率记录，依次关闭温箱、泵、转台等可疑源"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        frequency_hz = positive(shape, "frequency_hz")
        phase = 2.0 * np.pi * frequency_hz * run.time_s
        # a block's mean of the line is smaller than the line
        left = np.sinc(frequency_hz * run.block_s)
        return np.stack([left * np.cos(phase), left * np.sin(phase)], axis=1)

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        amplitude = complex(coefficients[0], -coefficients[1])
        turning = np.exp(2j * np.pi * positive(shape, "frequency_hz") * time_s)
        return np.asarray((amplitude * turning).real)
