"""Errors over time: drift over days and within each run, and settling of bias and scale factor after power-on."""

from collections.abc import Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Inputs, Shape, ShapeParameter, positive
from analytics.loop.effects.monomial import Monomial
from stream.batch import FloatArray

EFFECTS = (
    Monomial(
        name="ageing",
        en="ageing over days",
        zh="长期老化",
        powers={"day": 1},
        per="day",
        cause="Source power, adhesive and getter age over days to years, on the shelf and in use. The bias shifts "
        "from run to run in one direction.",
        cause_zh="光源功率、胶粘剂和吸气剂在存放与使用中逐日老化。零偏在各次测试之间朝一个方向移动。",
        reference="IEEE 952-2020, bias stability over time; GJB 2426A-2004, long-term repeatability",
        aliases=("drift_in_run",),
        separating_test="repeat the same power-on test on eight or more days spread over weeks",
        separating_test_zh="在数周内分八天以上重复同样的通电测试",
    ),
)


class DriftInRun(Effect):
    """Bias in proportion to the time since the run's start, alike in every run."""

    name, en, zh = "drift_in_run", "drift within the run", "测试内漂移"
    needs = ()
    per = "h"
    cause = (
        "A relaxation such as outgassing or the decay of mounting stress proceeds in the same direction in each run. "
        "Over hours it appears as a rate ramp."
    )
    cause_zh = "每次测试中某些因素（放气、装夹应力等）沿同一方向松弛。数小时内表现为速率斜坡。"
    reference = "IEEE 952-2020, rate ramp; IEEE 528-2019"
    aliases = ("warm_up", "temperature", "ageing")
    separating_test = "long static run at constant temperature, started at different times after power-on"
    separating_test_zh = "恒温长时间静态测试，并在通电后不同时间开始"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return (run.time_s / 3600.0)[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        return coefficients[0] / 3600.0 * time_s


_TRIED_S = (300.0, 495.0, 817.0, 1350.0, 2230.0, 3680.0, 6080.0, 10000.0)


class WarmUp(Effect):
    """Bias that decays as exp(-t/time_constant), t being the time since power-on."""

    name, en, zh = "warm_up", "warm-up after power-on", "通电预热"
    needs = ("time_since_power_on",)
    parameters = (ShapeParameter("time_constant", "s", _TRIED_S, "warm-up time constant", "预热时间常数"),)
    cause = (
        "Source, electronics and drive heat themselves after power-on, which the temperature sensor hardly measures. "
        "The bias settles as they reach thermal equilibrium."
    )
    cause_zh = "通电后光源、电路和驱动自身发热，温度传感器几乎测不到。零偏随其达到热平衡而稳定。"
    reference = "IEEE 952-2020, warm-up time; GJB 2426A-2004, start-up time; JJF 2014-2022"
    aliases = ("temperature", "thermal_lag", "drift_in_run")
    separating_test = "power on after gyro and fixture have soaked, at two temperatures"
    separating_test_zh = "在两个温度下，待陀螺与工装充分保温后再通电"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        return np.exp(-run.mean("time_since_power_on") / positive(shape, "time_constant"))[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        since_s = channels["time_since_power_on"]
        return coefficients[0] * _simulated_decay(time_s, since_s, positive(shape, "time_constant"))


class ScaleFactorWarmUp(Effect):
    """Input rate times exp(-t/time_constant), t being the time since power-on."""

    name, en, zh = "scale_factor_warm_up", "scale-factor warm-up", "标度因数通电预热"
    needs = ("input_rate", "time_since_power_on")
    parameters = (
        ShapeParameter("time_constant", "s", (600.0, 1800.0, 5400.0), "warm-up time constant", "预热时间常数"),
    )
    per = "{input_rate}"
    cause = (
        "The source's wavelength and the gain of the electronics settle after power-on as they heat themselves. "
        "The scale factor settles with them."
    )
    cause_zh = "通电后光源波长和电路增益随自身发热逐渐稳定。标度因数随之稳定。"
    reference = "IEEE 952-2020, scale factor and warm-up; GJB 2426A-2004 5.8"
    aliases = ("scale_factor_temperature", "warm_up")
    separating_test = "repeat the same rates early and late after power-on at a soaked temperature"
    separating_test_zh = "充分保温后通电，在通电初期与后期重复相同的角速率"

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        left = np.exp(-run.mean("time_since_power_on") / positive(shape, "time_constant"))
        return (run.mean("input_rate") * left)[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        left = _simulated_decay(time_s, channels["time_since_power_on"], positive(shape, "time_constant"))
        return coefficients[0] * channels["input_rate"] * left


def _simulated_decay(time_s: FloatArray, since_power_on_s: FloatArray, time_constant_s: float) -> FloatArray:
    """Decay from 1 after power-on by integration of dx/dt = -x/time_constant; each power-on restarts it."""
    left = np.exp(-since_power_on_s[0] / time_constant_s)
    course = np.empty(time_s.size)
    course[0] = left
    for i in range(1, time_s.size):
        if since_power_on_s[i] < since_power_on_s[i - 1]:
            left = np.exp(-since_power_on_s[i] / time_constant_s)
        else:
            half = 0.5 * (since_power_on_s[i] - since_power_on_s[i - 1]) / time_constant_s
            left *= (1.0 - half) / (1.0 + half)
        course[i] = left
    return course
