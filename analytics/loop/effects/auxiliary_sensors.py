"""Faults of auxiliary sensors that look like effects on the gyro: clocks that disagree, channels that freeze."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.edge_slope import mean_slope_per_s
from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.effects.base import Effect, Inputs, Role, Shape
from analytics.loop.effects.block_kernels import slope_per_s
from stream.batch import FloatArray

_OFFSET_S = 5.0
_RATE_ERROR = 2e-4
_PER_HOUR = 3600.0
_MOST_OFFSET_S, _MOST_GROWTH_S_PER_H = 120.0, 3.6  # of a clock not set for months, and of a poor quartz, 0.1 %
Mask = npt.NDArray[np.bool_]
_LEAST_BLOCKS = 4
_LEAST_REACH_BLOCKS = 40
_HANGS_FROM_TO = ((0.03, 0.07), (0.23, 0.27), (0.63, 0.67), (0.82, 0.86))
_SLOPE_BLOCKS = 12
_GRAVITY = ("gravity_i", "gravity_o", "gravity_s")
_SAME_ATTITUDE_G = 0.02
_LEAST_TURNING = 0.1  # of the table's rate in the gap; the ratio is not taken from the noise of a table at rest


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
        self.needs = (self.channel,)
        term = "scale_factor" if self.channel == "input_rate" else self.channel
        self.clock_bound = (term, _MOST_GROWTH_S_PER_H, "s/h") if self.is_growing else (term, _MOST_OFFSET_S, "s")
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


def frozen_blocks(channel: Channel) -> Mask:
    """Blocks in which the channel repeats one reading, four blocks or more in a row; a drop-out to zero is one case.

    >>> frozen_blocks(Channel(np.array([1.0, 2, 2, 2, 2, 3]), np.zeros(6), "degC"))
    array([False,  True,  True,  True,  True, False])
    """
    mean = channel.mean
    repeats = np.zeros(mean.size, bool)
    repeats[1:] = (mean[1:] == mean[:-1]) & (channel.spread[1:] <= 1e-9 * np.abs(mean[1:]))
    frozen = repeats.copy()
    frozen[:-1] |= repeats[1:]
    for first, end in _stretches(frozen):
        frozen[first:end] = end - first >= _LEAST_BLOCKS
    return frozen


class _StaleChannel(Effect):
    """Reading minus true value of a channel, in the blocks where it is frozen."""

    role = Role.ALIAS
    reference = "IEEE 1431-2004, test instrumentation; IEEE 952-2020, data acquisition"

    @abstractmethod
    def _truth(self, run: RunBlocks, is_frozen: Mask) -> FloatArray:
        """Estimate of the true values in the frozen blocks."""

    def unavailable(self, runs: Sequence[RunBlocks]) -> Bilingual | None:
        reason = super().unavailable(runs)
        if reason is None and not any(np.any(self.regressors(run, {})) for run in runs):
            reason = Bilingual(
                f"channel {self.needs[0]} is nowhere frozen while it should move in these runs",
                f"通道{self.needs[0]}在应当变化时从未停滞",
            )
        return reason

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        channel = run.channels[self.needs[0]]
        is_frozen = frozen_blocks(channel)
        error = np.where(np.isfinite(channel.mean), 0.0, np.nan)
        if is_frozen.any():
            error[is_frozen] = channel.mean[is_frozen] - self._truth(run, is_frozen)
        return error[:, None]

    def recorded(self, time_s: FloatArray, channels: Inputs) -> Inputs:
        held = channels[self.needs[0]].copy()
        for hang in _HANGS_FROM_TO:
            first, end = np.searchsorted(time_s, np.quantile(time_s, hang))
            held[first:end] = held[first]
        return {**channels, self.needs[0]: held}

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        return coefficients[0] * (self.recorded(time_s, channels)[self.needs[0]] - channels[self.needs[0]])


class StaleTemperature(_StaleChannel):
    """Frozen gyro temperature; its true values are estimated by a cubic from the readings before to those after."""

    name, en, zh = "stale_temperature", "temperature reading frozen or dropped out", "温度读数停滞或中断"
    needs = ("temperature",)
    per = "{temperature}"
    cause = (
        "The data acquisition of the sensor hangs or its line drops out, and the last reading (or zero) is repeated. "
        "The model then uses the wrong temperature until the sensor recovers."
    )
    cause_zh = "传感器读取挂起或线路中断，上一读数（或零）被重复记录。恢复之前模型扣除的是错误的温度。"
    aliases = ("thermal_lag", "temperature")
    separating_test = "repeat the run with a second temperature sensor on another acquisition channel"
    separating_test_zh = "用另一采集通道的第二个温度传感器重复测试"

    def _truth(self, run: RunBlocks, is_frozen: Mask) -> FloatArray:
        from scipy.interpolate import CubicHermiteSpline

        mean, slot = run.mean("temperature"), run.slot.astype(np.float64)
        # the first frozen block is the last true reading, unless the line dropped out to zero
        held_on = is_frozen & (np.concatenate(([False], is_frozen[:-1])) | (mean == 0.0))
        good = np.flatnonzero(np.isfinite(mean) & ~held_on)
        truth = mean.copy()
        for first, end in _stretches(held_on):
            # the block in which the sensor recovers is frozen in part
            before, after = good[good < first], good[good > end]
            if not (before.size and after.size):
                continue  # unknown without a reading on both sides
            left, right = before[-1], after[0]
            slopes = [_slope(slot[near], mean[near]) for near in (before[-_SLOPE_BLOCKS:], after[:_SLOPE_BLOCKS])]
            bridge = CubicHermiteSpline(slot[[left, right]], mean[[left, right]], slopes)
            truth[first:end] = bridge(slot[first:end])
        return truth[is_frozen]


class StaleInputRate(_StaleChannel):
    """Frozen rate reference; its true values are estimated from the table rate, by their ratio in the same attitude.

    The blocks beside the gap give the ratio, or others of the run if the gyro has another attitude there. Without
    gravity channels the attitude is taken to be that beside the gap.
    """

    name, en, zh = "stale_input_rate", "rate reference frozen or dropped out", "速率基准停滞或中断"
    needs = ("input_rate", "table_rate")
    per = "{input_rate}"
    cause = (
        "The link to the rate reference hangs and its last value is repeated while the table keeps moving. The model "
        "then uses a wrong rate, which leaves the difference times the scale factor."
    )
    cause_zh = "与速率基准的通信挂起，转台仍在运动而上一数值被重复。模型扣除的角速率已不真实，留下标度因数乘以其差。"
    aliases = ("rate_time_offset", "dead_zone")
    separating_test = "repeat the run with the rate derived from the table angle by a second acquisition channel"
    separating_test_zh = "用第二采集通道由转台角度求得速率并重复测试"

    def _truth(self, run: RunBlocks, is_frozen: Mask) -> FloatArray:
        rate, table = run.mean("input_rate"), run.mean("table_rate")
        good = ~is_frozen & np.isfinite(rate) & np.isfinite(table)
        truth, moved = rate.copy(), np.abs(np.nan_to_num(table))
        attitude = _attitude(run)
        for first, end in _stretches(is_frozen):
            reach = max(end - first, _LEAST_REACH_BLOCKS)
            near = good & (np.abs(np.arange(len(run)) - (first + end - 1) / 2) <= reach + (end - first) / 2)
            for start, stop in _of_one_attitude(attitude, first, end):
                same = (np.abs(attitude - np.median(attitude[start:stop], axis=0)) < _SAME_ATTITUDE_G).all(axis=1)
                least = _LEAST_TURNING * moved[start:stop].max()
                beside = next((of for of in (near & same, good & same) if moved[of].max(initial=0.0) > least), None)
                if beside is None:
                    continue  # unknown, the table only ever turned in other attitudes
                along = float(rate[beside] @ table[beside]) / float(table[beside] @ table[beside])
                estimated = along * table[start:stop]
                truth[start:stop] = np.where(np.isfinite(estimated), estimated, rate[start:stop])
        return truth[is_frozen]


def _slope(at: FloatArray, value: FloatArray) -> float:
    off = at - at.mean()
    return float(off @ value / (off @ off)) if at.size > 1 else 0.0


def _attitude(run: RunBlocks) -> FloatArray:
    """Components of gravity of each block, (blocks, 0 to 3), in g_0; of the channels that have readings in all."""
    recorded = [run.mean(name) for name in _GRAVITY if name in run.channels]
    return np.column_stack([np.zeros((len(run), 0)), *(each for each in recorded if np.isfinite(each).all())])


def _of_one_attitude(attitude: FloatArray, first: int, end: int) -> list[tuple[int, int]]:
    """Parts of the blocks from `first` to before `end` in which gravity does not change."""
    turned = (np.abs(np.diff(attitude[first:end], axis=0)) >= _SAME_ATTITUDE_G).any(axis=1)
    edges = [first, *(first + 1 + np.flatnonzero(turned)).tolist(), end]
    return list(pairwise(edges))


def _stretches(is_true: Mask) -> list[tuple[int, int]]:
    """First block of each unbroken stretch, and the one after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], is_true, [False]))))
    return [(int(first), int(end)) for first, end in zip(edges[::2], edges[1::2], strict=True)]
