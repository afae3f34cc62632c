"""A general function of the input rate, with straight pieces between knots that lie closer near zero rate."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Kind, Shape, ShapeParameter, range_over
from analytics.loop.effects.function_of_channel import KNOTS
from analytics.loop.effects.shape_values import numbers
from analytics.loop.effects.within_block import mean_excess
from stream.batch import FloatArray

_PARTS = (0.01, 0.025, 0.05, 0.25, 0.5, 1.0)


class FunctionOfInputRate(Effect):
    """Any function of the input rate that is zero at the knot nearest zero; beyond the knots it stays level."""

    name = "function_of_input_rate"
    en = "function of input rate"
    zh = "输入角速率的未知函数"
    needs = ("input_rate",)
    kind = Kind.FUNCTION
    parameters = (ShapeParameter(KNOTS, "{input_rate}", (), "knots", "节点"),)
    cause = (
        "The error follows the rate along a curve that no named effect has, such as steps of a converter. The curve "
        "tells at which rates to look."
    )
    cause_zh = "误差沿某一曲线随角速率变化，与已命名的效应均不符，例如转换器的台阶。曲线指出了应查的角速率。"
    reference = "IEEE 952-2020, scale-factor nonlinearity; GJB 2426A-2004 5.8"
    separating_test = "fine steps of rate over the whole range in both directions"
    separating_test_zh = "全量程内正反向细分角速率"

    def shapes(self, runs: Sequence[RunBlocks]) -> Sequence[Shape]:
        found = range_over("input_rate", runs)
        greatest = 0.0 if found is None else max(abs(found[0]), abs(found[1]))
        if greatest == 0.0:
            return []
        positive = [float(f"{part * greatest:.3g}") for part in _PARTS]
        return [{KNOTS: [*(-knot for knot in reversed(positive)), 0.0, *positive]}]

    def columns(self, shape: Shape) -> tuple[str, ...]:
        knots = numbers(shape, KNOTS)
        return tuple(f"at_{knot:g}" for knot in np.delete(knots, np.argmin(np.abs(knots))))

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        knots, rate = numbers(shape, KNOTS), run.channels["input_rate"]
        excess = np.stack([mean_excess(rate, float(knot)) for knot in knots], axis=1)
        # a hat over a knot climbs from the knot before it and falls to the knot after it
        climbed = -np.diff(excess, axis=1) / np.diff(knots)
        ones = np.where(np.isfinite(rate.mean), 1.0, np.nan)[:, None]
        hats = np.hstack([ones, climbed]) - np.hstack([climbed, 0.0 * ones])
        return np.delete(hats, np.argmin(np.abs(knots)), axis=1)

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        knots = numbers(shape, KNOTS)
        heights = np.insert(np.asarray(coefficients, np.float64), int(np.argmin(np.abs(knots))), 0.0)
        slopes = np.diff(heights) / np.diff(knots)
        # the height at the first knot, and then each piece as far as the rate goes into it
        climbed = np.clip(channels["input_rate"][:, None] - knots[:-1], 0.0, np.diff(knots))
        return np.asarray(heights[0] + climbed @ slopes)
