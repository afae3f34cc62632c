"""A thermometer that lags the temperature of the gyro, with and without an effect of the rate of temperature."""

import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.report.finding_sentences import alternative
from analytics.loop.report.wording import Wording
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import ConfoundedEffect, Diagnosis
from stream.batch import FloatArray

MODEL = ErrorModel.parse("rate = bias + temperature")
DAY_NS, BLOCK_S, SECONDS, WHITE = 86_400 * 10**9, 30, 3600, 0.11


def behind(value: FloatArray, lag_s: float) -> FloatArray:
    """What follows a value with a lag, second by second."""
    followed = np.empty_like(value)
    followed[0] = value[0]
    for at in range(1, value.size):
        followed[at] = followed[at - 1] - np.expm1(-1.0 / lag_s) * (value[at] - followed[at - 1])
    return followed


def lagging(sensor_s: float, shupe: float, inner_s: float = 0.0, inner: float = 0.0) -> Diagnosis:
    """Nine runs of an hour: 0.02 deg/h/degC, Shupe of the true temperature, and a part that lags behind it."""
    rng, runs = np.random.default_rng(1), []
    time_s, count = np.arange(float(SECONDS)), SECONDS // BLOCK_S
    for number in range(9):
        true = 25.0 + 15.0 * np.sin(2 * np.pi * time_s / (1200.0 + 200.0 * number) + rng.uniform(0.0, 6.0))
        read = behind(true, sensor_s) if sensor_s else true
        rate = 0.3 + 0.02 * (true - 25.0) + shupe * np.gradient(true)
        if inner:
            rate += inner * (behind(true, inner_s) - true)
        value, temperature = (each.reshape(count, BLOCK_S).mean(axis=1) for each in (rate, read))
        value += 0.05 * rng.standard_normal() + WHITE * rng.standard_normal(count)
        ones = np.ones(count)
        channel = Channel(temperature + 0.001 * rng.standard_normal(count), 0.001 * ones, "degC")
        runs.append(
            RunBlocks(
                "U1", f"r{number}", "rate", np.arange(count), float(BLOCK_S), number * DAY_NS, value,
                BLOCK_S * ones.astype(int), WHITE**2 * ones, "deg/h", {"temperature": channel},
            )
        )  # fmt: skip
    return diagnose(runs, MODEL)


def of_sensor(found: Diagnosis) -> ConfoundedEffect | None:
    return next((each for each in found.confounded if each.name == "temperature_sensor_lag"), None)


@pytest.mark.parametrize("shupe", [0.0, 30.0])
def test_the_lag_of_a_thermometer_is_among_the_names(shupe: float) -> None:
    """With an effect of the rate of temperature a thermal lag of 180 s had been the only other name."""
    found = lagging(60.0, shupe)
    assert found.names == (("temperature_rate", "thermal_lag") if shupe else ("temperature_rate",))
    rival = of_sensor(found)
    assert rival is not None
    assert rival.implied == pytest.approx(60.0, rel=0.2)
    assert rival.is_plausible
    assert alternative(rival, Wording("en")).startswith("lag of the temperature sensor: ")
    assert alternative(rival, Wording("zh")).startswith("温度传感器响应滞后: ")


def test_a_part_within_the_gyro_that_lags_is_no_lag_of_the_thermometer() -> None:
    found = lagging(0.0, 30.0, inner_s=600.0, inner=0.15)
    assert set(found.names) == {"temperature_rate", "thermal_lag"}
    assert of_sensor(found) is None
