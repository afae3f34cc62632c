"""Events: a jump of the bias in one run, periodic lines that no channel shows, and turn-on scatter."""

from collections.abc import Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, EffectKind, Inputs, Shape, ShapeParameter, number, positive
from stream.batch import FloatArray

TURN_ON = "turn_on"
STATION = "station"


class Jump(Effect):
    """0 before `at_s` of the run named in the shape, 1 from then on; 0 in other runs."""

    name, en, zh = "jump", "bias jump", "零偏跳变"
    needs = ()
    kind = EffectKind.EVENT
    parameters = (ShapeParameter("at_s", "s", (), "moment from the run's start", "距测试开始的时刻"),)
    cause = (
        "A mode hop of the source, a contact that slips or a change of state in the electronics shifts the bias "
        "abruptly. Its time is random, so that it cannot be reproduced, only observed again."
    )
    cause_zh = "光源跳模、接触面滑移或电路状态切换使零偏突然移动。其发生时刻不定，无法复现，只能再次观察到。"
    reference = "IEEE 528-2019, random bias; GJB 2426A-2004, bias stability"
    aliases = ("temperature_threshold",)
    separating_test = (
        "repeat the run several times and check whether the jump recurs at the same temperature, time or command"
    )
    separating_test_zh = "多次重复测试，观察是否在相同温度、时间或指令处跳变"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        if shape.get("run") != run.run:
            return np.zeros((len(run), 1))
        end_s = (run.slot + 1) * run.block_s
        share = np.clip((end_s - number(shape, "at_s")) / run.block_s, 0.0, 1.0)
        return np.asarray(share, np.float64)[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        return np.where(time_s >= number(shape, "at_s"), coefficients[0], 0.0)


class PeriodicLine(Effect):
    """Cosine and sine of one frequency; the phase counts from each run's start."""

    name, en, zh = "periodic_line", "periodic line", "周期性谱线"
    needs = ()
    kind = EffectKind.LINE
    parameters = (ShapeParameter("frequency_hz", "Hz", (), "frequency", "频率"),)
    coefficients = ("cos", "sin")
    cause = (
        "A thermostat, a compressor, a beat of two clocks or an aliased vibration line repeats with a fixed period. "
        "Its phase differs from run to run, its frequency does not."
    )
    cause_zh = "恒温器、压缩机、两时钟差拍或混叠的振动谱线以固定周期重复。各次测试相位不同而频率不变。"
    reference = "IEEE 952-2020, annex on spectral analysis (sinusoidal noise)"
    aliases = ("table_angle_harmonic_1",)
    separating_test = (
        "record at the full sampling rate with each suspected source (chamber, pump, table) switched off in turn"
    )
    separating_test_zh = "以全采样率记录，依次关闭温箱、泵、转台等可疑源"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        frequency_hz = positive(shape, "frequency_hz")
        phase = 2.0 * np.pi * frequency_hz * run.time_s
        # averaging over a block attenuates the line
        left = np.sinc(frequency_hz * run.block_s)
        return np.stack([left * np.cos(phase), left * np.sin(phase)], axis=1)

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        amplitude = complex(coefficients[0], -coefficients[1])
        turning = np.exp(2j * np.pi * positive(shape, "frequency_hz") * time_s)
        return np.asarray((amplitude * turning).real)


class _Constant(Effect):
    """A constant within a run, another in others."""

    needs = ()
    kind = EffectKind.EVENT

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return np.ones((len(run), 1))

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        return np.full(time_s.size, float(coefficients[0]))


class TurnOnScatter(_Constant):
    """One constant per run. It is noise and not searched for, but may explain a difference between runs."""

    name, en, zh = TURN_ON, "turn-on scatter", "逐次启动散布"
    cause = (
        "Each power-on leaves the loop, the source or the suspension in a slightly different state. The bias then "
        "differs from run to run by an amount that no recorded channel predicts."
    )
    cause_zh = "每次上电后回路、光源或支承的状态略有不同。零偏因此逐次不同，其大小无法由任何记录预测。"
    reference = "IEEE 528-2019, turn-on to turn-on bias; JJF 2014-2022 7.2.15"
    separating_test = "power on six times or more with temperature, position and supply held"
    separating_test_zh = "保持温度、位置和供电不变，重复上电六次以上"


class StationChange(_Constant):
    """A constant for each station and period. It is no effect of a unit, and may explain a drift over days."""

    name, en, zh = STATION, "a difference between stations or a change of one", "试验台之间的差异或某台的变化"
    cause = (
        "A fixture that was levelled again, another reference or a moved table shifts what all units read there from "
        "one day on."
    )
    cause_zh = "夹具重新调平、更换基准或转台移位，使此后该台所测产品的读数一同改变。"
    reference = "ISO 5725-2:2019, between-laboratory differences"
    separating_test = (
        "measure the same units, or one kept as a reference, at another station on the same day; "
        "`gyrofleet trend bias --by station` shows the changes of each"
    )
    separating_test_zh = "同日在另一试验台测量同一产品或基准产品；gyrofleet trend bias --by station 显示各台的变化"
