"""Bias by temperature: a polynomial about 25 degC, threshold, gradient, rate of change (Shupe), lag, hysteresis."""

from collections.abc import Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, EffectKind, Inputs, Role, Shape, ShapeParameter, number, positive
from analytics.loop.effects.block_kernels import lagged, played, share_above, slope_per_s
from analytics.loop.effects.monomial import Monomial
from stream.batch import FloatArray

SENSOR_LAG = "temperature_sensor_lag"
MOST_SENSOR_LAG_S = 120.0  # of a thermometer in still air

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

    name, en, zh = "temperature_gradient", "temperature gradient", "温度梯度"
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

    name, en, zh = "temperature_threshold", "temperature threshold", "温度阈值"
    needs = ("temperature",)
    is_late_in_one_run = True  # of some ten blocks, steps at thirty places make chance five times as likely
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


class TemperatureRate(Effect):
    """Bias in proportion to the rate of change of the gyro's temperature."""

    name, en, zh = "temperature_rate", "temperature rate (Shupe)", "温度变化率（Shupe效应）"
    needs = ("temperature",)
    per = "{temperature}/s"
    cause = (
        "The two beams pass a point of the coil at different times; if its temperature changes meanwhile, their "
        "phases differ. The bias is proportional to dT/dt, weighted by the distance from the midpoint of the coil."
    )
    cause_zh = "两束光在不同时刻经过光纤环同一点，其间温度变化使相位不同。零偏与dT/dt成正比，并按到环中点的距离加权。"
    reference = "Shupe, Applied Optics 19(5), 1980, 654-655; IEEE 952-2020, bias temperature ramp sensitivity"
    aliases = ("case_temperature_rate", "temperature_gradient", "thermal_lag", "temperature_time_offset")
    separating_test = "pass through the same temperatures at two or more ramp rates, up and down"
    separating_test_zh = "以两种以上变温速率升降通过同样的温度"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return slope_per_s(run, "temperature")[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        return coefficients[0] * np.gradient(channels["temperature"], time_s)


class CaseTemperatureRate(Effect):
    """Bias in proportion to the rate of change of the case's temperature after conduction to the coil."""

    name, en, zh = "case_temperature_rate", "case temperature rate (Shupe at the coil)", "壳体温度变化率（传至光纤环）"
    needs = ("case_temperature",)
    parameters = (
        ShapeParameter("time_constant", "s", (90.0, 300.0, 900.0, 2700.0), "heat conduction time", "热传导时间常数"),
    )
    per = "{case_temperature}/s"
    cause = (
        "Heat enters through the case and reaches the coil with the time constant of conduction. The Shupe bias "
        "follows the rate of change at the coil, where there is no sensor."
    )
    cause_zh = "热量由壳体经传导时间常数到达光纤环。Shupe零偏取决于未装传感器处的温度变化率。"
    reference = "Shupe, Applied Optics 19(5), 1980, 654-655; IEEE 952-2020, bias temperature ramp sensitivity"
    aliases = ("temperature_rate", "temperature_gradient", "thermal_lag")
    separating_test = "two or more ramp rates, with a second sensor at the coil"
    separating_test_zh = "两种以上变温速率，并在光纤环处加装第二个温度传感器"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        conducted = lagged(run, "case_temperature", positive(shape, "time_constant"))
        return slope_per_s(run, "case_temperature", conducted)[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        case, time_constant_s = channels["case_temperature"], positive(shape, "time_constant")
        coil = case[0]
        error = np.empty(time_s.size)
        for i, step_s in enumerate(np.diff(time_s, prepend=time_s[0])):
            coil += (case[i] - coil) * -np.expm1(-step_s / time_constant_s)
            error[i] = (case[i] - coil) / time_constant_s
        return coefficients[0] * error


_LAGS_S = (180.0, 270.0, 400.0, 600.0, 900.0, 1340.0, 2000.0, 3000.0, 4480.0, 6690.0, 10000.0)


class ThermalLag(Effect):
    """Bias by the temperature of a part that lags the sensor, minus the sensor's; equal at a run's first reading."""

    name, en, zh = "thermal_lag", "thermal lag", "热滞后（时间常数）"
    needs = ("temperature",)
    parameters = (ShapeParameter("time_constant", "s", _LAGS_S, "thermal time constant", "热时间常数"),)
    per = "{temperature}"
    cause = (
        "The part that determines the bias lies deeper than the temperature sensor and follows it with a first-order "
        "lag. While the temperature changes, a model based on the sensor is in error in proportion to the difference."
    )
    cause_zh = "决定零偏的部件比温度传感器更靠内，以一阶滞后跟随其温度。温度变化期间，按传感器读数建模会差此温差。"
    reference = "IEEE 952-2020, bias temperature model; GJB 2426A-2004 5.12.4 (soak time)"
    aliases = ("temperature_rate", "case_temperature_rate", "temperature_gradient", "thermal_hysteresis", "warm_up")
    separating_test = "temperature steps with dwells of five time constants: a lag decays, hysteresis remains"
    separating_test_zh = "温度阶跃后保温五倍时间常数：滞后会消失，迟滞则保留"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        behind = lagged(run, "temperature", positive(shape, "time_constant"))
        return (behind - run.mean("temperature"))[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        sensor, time_constant_s = channels["temperature"], positive(shape, "time_constant")
        inner = sensor[0]
        difference = np.zeros(time_s.size)
        for i in range(1, time_s.size):
            # trapezoidal step of time_constant * d(inner)/dt = sensor - inner
            half = 0.5 * (time_s[i] - time_s[i - 1]) / time_constant_s
            inner = (inner * (1.0 - half) + half * (sensor[i - 1] + sensor[i])) / (1.0 + half)
            difference[i] = inner - sensor[i]
        return coefficients[0] * difference


class SensorLag(Effect):
    """Second derivative of the temperature: what a thermometer with a lag leaves of an effect of the rate.

    The search does not try it: beside a coefficient of the temperature alone its lag is a time offset.
    """

    name, en, zh = SENSOR_LAG, "lag of the temperature sensor", "温度传感器响应滞后"
    needs = ("temperature",)
    role = Role.ALIAS
    kind = EffectKind.EVENT
    per = "{temperature}/s^2"
    cause = (
        "The sensor follows the temperature that it measures with a time constant. What the gyro does by its "
        "temperature is then due to the reading and its derivative, what it does by the rate of its temperature to "
        "the first and second derivative."
    )
    cause_zh = (
        "传感器以时间常数跟随所测温度。陀螺随温度的变化表现为读数及其导数，随温度变化率的变化表现为一阶与二阶导数。"
    )
    reference = "IEEE 952-2020, bias temperature model"
    aliases = ("temperature_rate", "temperature_time_offset", "thermal_lag")
    separating_test = "measure the time constant of the sensor by a step, or record a second, faster sensor beside it"
    separating_test_zh = "用温度阶跃测出传感器的时间常数，或在旁边加装响应更快的传感器"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return slope_per_s(run, "temperature", slope_per_s(run, "temperature"))[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        slope = np.gradient(channels["temperature"], time_s)
        return np.asarray(coefficients[0] * np.gradient(slope, time_s), np.float64)


class ThermalHysteresis(Effect):
    """Bias by the output of a play (backlash) on the temperature, minus the temperature.

    The loop is `width` wide and centred on the first reading of a run.
    """

    name, en, zh = "thermal_hysteresis", "thermal hysteresis", "热迟滞"
    needs = ("temperature",)
    parameters = (
        ShapeParameter("width", "{temperature}", (0.04, 0.1, 0.18, 0.25, 0.4), "width of the loop", "迟滞回线宽度"),
    )
    per = "{temperature}"
    cause = (
        "Adhesive joints and preloaded contacts slip only when thermal strain exceeds friction. After each reversal "
        "of the temperature the bias lags by up to half the width of the loop, and waiting does not reduce it."
    )
    cause_zh = (
        "胶接面和预紧接触面仅在热应变超过摩擦时滑移。温度每次反向后零偏落后，最多为迟滞回线宽度的一半，且不随等待消失。"
    )
    reference = (
        "Krasnosel'skii and Pokrovskii, Systems with Hysteresis, Springer 1989; IEEE 952-2020, thermal hysteresis"
    )
    aliases = ("thermal_lag", "temperature_rate")
    separating_test = "closed temperature loops with different turning points, with dwells on both branches"
    separating_test_zh = "具有不同转折点的闭合温度循环，升降两支均保温"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return (played(run, "temperature", positive(shape, "width")) - run.mean("temperature"))[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        stretch = positive(shape, "width") / 2
        elastic = np.zeros(time_s.size)
        for i, step in enumerate(np.diff(channels["temperature"]), 1):
            # the spring between sensor and slider stretches until the slider slips
            elastic[i] = min(max(elastic[i - 1] + step, -stretch), stretch)
        return -coefficients[0] * elastic
