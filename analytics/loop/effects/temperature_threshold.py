"""Bias that changes at once when the temperature passes a threshold."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Kind, Shape, ShapeParameter
from analytics.loop.effects.shape_values import number
from analytics.loop.effects.within_block import share_above
from stream.batch import FloatArray

_PARTS = tuple(round(0.1 + 0.05 * step, 2) for step in range(17))
_SHARES = tuple(round(0.05 * step, 2) for step in range(1, 20))


class TemperatureThreshold(Effect):
    """1 above the threshold, 0 below."""

    name = "temperature_threshold"
    en = "temperature threshold"
    zh = "温度阈值"
    needs = ("temperature",)
    kind = Kind.SECOND_TIER
    parameters = (ShapeParameter("threshold", "{temperature}", _PARTS, "threshold", "阈值", "temperature"),)
    cause = (
        "A heater, a range switch or a mode hop of the source comes in at a certain temperature. The bias has two "
        "levels and nothing between."
    )
    cause_zh = "加热器、量程切换或光源跳模在某一温度处发生。零偏只有两个电平，没有过渡。"
    reference = "IEEE 952-2020, bias temperature model"
    aliases = ("temperature_squared", "temperature_cubed", "jump")
    separating_test = "slow ramp through the threshold, both ways, several times"
    separating_test_zh = "缓慢变温，多次双向通过阈值"

    def shapes(self, runs: Sequence[RunBlocks]) -> Sequence[Shape]:
        """Evenly over the range, and closer where the runs spent more of their time."""
        means = np.concatenate([run.mean("temperature") for run in runs])
        means = means[np.isfinite(means)]
        (parameter,) = self.parameters
        low = np.quantile(means, 0.002)
        tried = np.concatenate([low + np.array(parameter.values(runs)), np.quantile(means, _SHARES)])
        return [{"threshold": value} for value in sorted({float(f"{each:.3g}") for each in tried})]

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return share_above(run.channels["temperature"], number(shape, "threshold"))[:, None]

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        return np.where(channels["temperature"] > number(shape, "threshold"), coefficients[0], 0.0)
