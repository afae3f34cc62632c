"""Bias by the gyro's temperature: a polynomial about 25 degC, a threshold, a gradient."""

from collections.abc import Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, EffectKind, Inputs, Shape, ShapeParameter, number
from analytics.loop.effects.monomial import Monomial
from analytics.loop.effects.within_block import share_above
from stream.batch import FloatArray

EFFECTS = (
    Monomial(
        name="temperature",
        en="temperature",
        zh="温度（一次项）",
        cause="Optical source, coil and electronics change with temperature, and the bias with them. Near room "
        "temperature the change is linear.",
        cause_zh="光源、光纤环和电路参数随温度漂移，零偏随之变化。在常温附近近似为直线。",
        reference="IEEE 952-2020, bias temperature sensitivity; GJB 2426A-2004 5.12.4; JJF 2014-2022 7.2.16",
        aliases=("thermal_lag", "chamber_setpoint", "chamber_temperature", "warm_up", "drift_in_run"),
        separating_test="ramp the temperature up and down again within one run, with dwells long enough to soak",
        separating_test_zh="同一次测试内升温再降温，并在各温度点充分保温",
    ),
    Monomial(
        name="temperature_squared",
        en="temperature squared",
        zh="温度二次项",
        powers={"temperature": 2},
        cause="Over a wide range the bias is a curved function of temperature, because stresses of bonded parts and "
        "wavelength shift are not linear. The lowest order of this curvature is the square.",
        cause_zh="在宽温范围内，粘接应力和波长漂移使零偏随温度呈弯曲变化。其最低阶为二次项。",
        reference="IEEE 952-2020, bias temperature model; GJB 2426A-2004 5.12.4",
        aliases=("temperature_threshold", "temperature_cubed"),
        separating_test="slow ramp and soak over the full range, at five or more temperatures",
        separating_test_zh="全温范围内缓慢变温，在五个以上温度点保温测量",
    ),
    Monomial(
        name="temperature_cubed",
        en="temperature cubed",
        zh="温度三次项",
        powers={"temperature": 3},
        cause="At both ends of the range the bias departs from a parabola with opposite signs, because of the glass "
        "transition of adhesives and the efficiency of the source. The cube is the lowest order with this symmetry.",
        cause_zh="在温度范围两端，胶粘剂玻璃化和光源效率使零偏以相反符号偏离抛物线。三次项是其最低阶。",
        reference="IEEE 952-2020, bias temperature model; GJB 2426A-2004 5.12.4",
        aliases=("temperature_squared", "temperature_threshold"),
        separating_test="slow ramp and soak at seven or more temperatures up to both ends of the range",
        separating_test_zh="缓慢变温至范围两端，在七个以上温度点保温测量",
    ),
)


class TemperatureGradient(Effect):
    """Bias in proportion to case temperature minus gyro temperature."""

    name = "temperature_gradient"
    en = "temperature gradient"
    zh = "温度梯度"
    needs = ("temperature", "case_temperature")
    per = "{temperature}"
    cause = (
        "Heat that flows through the gyro strains the coil and its mounts unevenly. The difference between case and "
        "inner temperature measures that flow."
    )
    cause_zh = "热流穿过陀螺时使光纤环和安装座受力不均。壳体与内部温度之差反映该热流。"
    reference = "IEEE 952-2020, bias temperature gradient sensitivity; IEEE 1431-2004"
    aliases = ("temperature_rate", "case_temperature_rate", "thermal_lag")
    separating_test = "heat one side at constant mean temperature"
    separating_test_zh = "平均温度不变，单侧加热"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return (run.mean("case_temperature") - run.mean("temperature"))[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        heat_flow = channels["case_temperature"] - channels["temperature"]
        return coefficients[0] * heat_flow


_PARTS = tuple(round(0.1 + 0.05 * step, 2) for step in range(17))
_SHARES = tuple(round(0.05 * step, 2) for step in range(1, 20))


class TemperatureThreshold(Effect):
    """1 above the threshold, 0 below."""

    name = "temperature_threshold"
    en = "temperature threshold"
    zh = "温度阈值"
    needs = ("temperature",)
    kind = EffectKind.SECOND_TIER
    parameters = (ShapeParameter("threshold", "{temperature}", _PARTS, "threshold", "阈值"),)
    cause = (
        "A heater, a range switch or a mode hop of the source occurs at a certain temperature. The bias has two "
        "levels without a transition."
    )
    cause_zh = "加热器、量程切换或光源跳模在某一温度处发生。零偏只有两个电平，没有过渡。"
    reference = "IEEE 952-2020, bias temperature model"
    aliases = ("temperature_squared", "temperature_cubed", "jump")
    separating_test = "slow ramp through the threshold in both directions, several times"
    separating_test_zh = "缓慢变温，多次双向通过阈值"

    def shapes(self, runs: Sequence[RunBlocks]) -> Sequence[Shape]:
        """Thresholds evenly over the range, and at quantiles of the temperature."""
        means = np.concatenate([run.mean("temperature") for run in runs])
        means = means[np.isfinite(means)]
        (parameter,) = self.parameters
        low = np.quantile(means, 0.002)
        tried = np.concatenate([low + np.array(parameter.values(runs)), np.quantile(means, _SHARES)])
        return [{"threshold": value} for value in sorted({float(f"{each:.3g}") for each in tried})]

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return share_above(run.channels["temperature"], number(shape, "threshold"))[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        return np.where(channels["temperature"] > number(shape, "threshold"), coefficients[0], 0.0)
