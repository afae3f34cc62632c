"""Clocks of auxiliary sensors that disagree with the gyro's: they look like effects of a derivative on the gyro.

A model that uses the channel is wrong by its coefficient times the change of the channel in the meantime.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Inputs, Role, Shape
from analytics.loop.effects.time_kernels import mean_slope_per_s, slope_per_s
from stream.batch import FloatArray

_OFFSET_S = 5.0
_RATE_ERROR = 2e-4
_PER_HOUR = 3600.0


@dataclass(kw_only=True, eq=False)
class SensorClock(Effect):
    """Error in proportion to a channel's derivative, times a constant offset or one that grows from the run's start.

    The coefficient is the channel's coefficient in the model times the offset in s, or times its growth in an hour.
    """

    name: str
    en: str
    zh: str
    channel: str
    is_growing: bool = False
    cause: str
    cause_zh: str
    aliases: tuple[str, ...]
    separating_test: str
    separating_test_zh: str
    role: Role = field(default=Role.ALIAS, init=False)
    reference: str = "IEEE 952-2020, data acquisition; IEEE 1431-2004, test instrumentation timing"

    def __post_init__(self) -> None:
        """Derive channels and unit."""
        self.needs = (self.channel,)
        self.per = f"{{{self.channel}}}/s" + ("*h" if self.is_growing else "")

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        slope = mean_slope_per_s if self.channel == "input_rate" else slope_per_s
        column = slope(run, self.channel)
        return (column * run.time_s / _PER_HOUR if self.is_growing else column)[:, None]

    def recorded(self, time_s: FloatArray, channels: Inputs) -> Inputs:
        late_by = _RATE_ERROR * time_s if self.is_growing else np.full(time_s.size, _OFFSET_S)
        return {**channels, self.channel: np.interp(time_s - late_by, time_s, channels[self.channel])}

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        missed = channels[self.channel] - self.recorded(time_s, channels)[self.channel]
        return coefficients[0] / (_RATE_ERROR * _PER_HOUR if self.is_growing else _OFFSET_S) * missed


EFFECTS = (
    SensorClock(
        name="temperature_time_offset",
        en="time offset of the temperature sensor",
        zh="温度传感器时间偏移",
        channel="temperature",
        cause="The temperature is time-stamped by another clock or read late, so that the model uses the temperature "
        "of another time. The error is the model's temperature coefficient times offset times dT/dt, the same form as "
        "the Shupe effect.",
        cause_zh="温度由另一时钟打标或读取滞后，模型使用了其他时刻的温度。误差形式与Shupe效应相同。",
        aliases=("temperature_rate", "thermal_lag", "temperature_clock_rate"),
        separating_test="record gyro and temperature on one clock, or repeat the ramp with a known offset",
        separating_test_zh="陀螺与温度用同一时钟记录，或以已知时间偏移重复变温",
    ),
    SensorClock(
        name="temperature_clock_rate",
        en="clock-rate error of the temperature recorder",
        zh="温度记录器时钟频率误差",
        channel="temperature",
        is_growing=True,
        cause="The clock of the temperature recorder runs fast or slow relative to the gyro's clock, so that the time "
        "stamps drift apart over the run. The error grows with time and dT/dt.",
        cause_zh="温度记录器时钟相对陀螺时钟偏快或偏慢，时间戳在测试中逐渐错开。误差随时间和dT/dt增大。",
        aliases=("temperature_rate", "temperature_time_offset"),
        separating_test="compare both clocks at start and end of a run, or discipline them by one source",
        separating_test_zh="在测试开始与结束时比对两时钟，或统一由一个时钟源驯服",
    ),
    SensorClock(
        name="rate_time_offset",
        en="time offset of the rate reference",
        zh="速率基准时间偏移",
        channel="input_rate",
        cause="Table rate and gyro output are time-stamped by different clocks. While the rate changes, the "
        "difference is the scale factor times offset times angular acceleration, the same form as a delay of the gyro.",
        cause_zh="转台速率与陀螺输出由不同时钟打标。角速率变化时差值等于标度因数乘偏移时间乘角加速度，"
        "与陀螺延时形式相同。",
        aliases=("angular_acceleration", "rate_clock_rate"),
        separating_test="trigger table and gyro from one clock, and repeat the same profile",
        separating_test_zh="转台与陀螺由同一时钟触发，重复同样的速率曲线",
    ),
    SensorClock(
        name="rate_clock_rate",
        en="clock-rate error of the rate reference",
        zh="速率基准时钟频率误差",
        channel="input_rate",
        is_growing=True,
        cause="The clock of the table's recorder runs fast or slow relative to the gyro's clock, so that changes of "
        "rate drift apart over the run. The error grows with time and angular acceleration.",
        cause_zh="转台记录器时钟相对陀螺时钟偏快或偏慢，角速率变化时刻逐渐错开。误差随时间和角加速度增大。",
        aliases=("rate_time_offset", "angular_acceleration"),
        separating_test="repeat the same change of rate early and late in one run, on one clock",
        separating_test_zh="同一次测试的前后段重复同样的速率变化，并统一时钟",
    ),
)
