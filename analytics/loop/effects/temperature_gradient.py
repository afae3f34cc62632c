"""Bias from a temperature difference across the gyro."""

from collections.abc import Mapping, Sequence

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Shape
from stream.batch import FloatArray


class TemperatureGradient(Effect):
    """Bias in proportion to case temperature minus gyro temperature."""

    name = "temperature_gradient"
    en = "temperature gradient"
    zh = "温度梯度"
    needs = ("temperature", "case_temperature")
    per = "{temperature}"
    cause = (
        "Heat that flows through the gyro strains coil and mounts unevenly. The difference between case and inner "
        "temperature measures that flow."
    )
    cause_zh = "热流穿过陀螺时使光纤环和安装座受力不均。壳体与内部温度之差反映该热流。"
    reference = "IEEE 952-2020, bias temperature gradient sensitivity; IEEE 1431-2004"
    aliases = ("temperature_rate", "case_temperature_rate", "thermal_lag")
    separating_test = "heat one side at constant mean temperature"
    separating_test_zh = "平均温度不变，单侧加热"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return (run.mean("case_temperature") - run.mean("temperature"))[:, None]

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        heat_flow = channels["case_temperature"] - channels["temperature"]
        return coefficients[0] * heat_flow
