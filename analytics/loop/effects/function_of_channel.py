"""General smooth functions of one channel, for what has no name: cubic splines with knots over the channel's range."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Kind, Shape, ShapeParameter, range_over
from analytics.loop.effects.channel_names import channel_name
from analytics.loop.effects.shape_values import numbers
from analytics.loop.effects.spline_basis import spline_columns, spline_value
from stream.batch import FloatArray

KNOTS = "knots"


class FunctionOfChannel(Effect):
    """Any smooth function of one channel, up to a constant; named ``function_of_CHANNEL``.

    The columns are cubic B-splines but the first, which the bias stands for. Beyond the knots the function stays at
    its value there.

    Parameters
    ----------
    channel: Standard channel.
    parts: Where the knots lie, in parts of the channel's range over all runs.
    """

    kind = Kind.FUNCTION
    cause = (
        "The error follows this channel along a curve that no named effect has. What makes it, the record does not "
        "tell; the curve does tell where to look."
    )
    cause_zh = "误差沿某一曲线随该通道变化，与已命名的效应均不符。记录无法说明成因，但曲线指出了应查的范围。"
    reference = "de Boor, A Practical Guide to Splines, Springer 1978"
    separating_test = "step this channel finely over its range, both ways, with all others held"
    separating_test_zh = "保持其他条件不变，在该通道全范围内双向细分步进"

    def __init__(self, channel: str, parts: tuple[float, ...]) -> None:
        en, zh = channel_name(channel)
        self.name = f"function_of_{channel}"
        self.en = f"function of {en}"
        self.zh = f"{zh}的未知函数"
        self.needs = (channel,)
        self.parts = parts
        self.parameters = (ShapeParameter(KNOTS, f"{{{channel}}}", (), "knots", "节点"),)

    @classmethod
    def instances(cls) -> Sequence[Effect]:
        even = tuple(float(part) for part in np.linspace(0.0, 1.0, 7))
        early = (0.0, 0.016, 0.04, 0.1, 0.25, 0.5, 1.0)
        return (
            cls("temperature", even),
            cls("supply_voltage", even[::2]),
            cls("vibration", even[::2]),
            cls("time_since_power_on", early),
        )

    def shapes(self, runs: Sequence[RunBlocks]) -> Sequence[Shape]:
        found = range_over(self.needs[0], runs)
        if found is None or found[0] == found[1]:
            return []
        low, high = found
        knots = [float(f"{low + part * (high - low):.6g}") for part in self.parts]
        if len(set(knots)) < len(knots):  # it moves by less than the digits of its knots
            return []
        return [{KNOTS: knots}]

    def columns(self, shape: Shape) -> tuple[str, ...]:
        return tuple(f"spline_{k}" for k in range(1, len(numbers(shape, KNOTS)) + 2))

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        channel, knots = run.channels[self.needs[0]], numbers(shape, KNOTS)
        # two points have the mean and spread of the block
        low = spline_columns(channel.mean - channel.spread, knots)
        return (0.5 * (low + spline_columns(channel.mean + channel.spread, knots)))[:, 1:]

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        return spline_value(channels[self.needs[0]], numbers(shape, KNOTS), [0.0, *coefficients])
