"""A gap of a channel costs the effects that read it, and no others."""

from dataclasses import replace

import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import HARMONICS, Channel, RunBlocks
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.partial_channels import gapped_channels
from analytics.loop.tracing.result.diagnosis_result import ModelVerdict
from stream.batch import BoolArray, FloatArray

MODEL = ErrorModel.parse("rate = bias")
NOISE = ModelNoise(N=0.0046, B=0.01, K=0.01, turn_on=0.3)
BLOCKS, RUNS = 240, 6
DAY_NS = 86_400 * 10**9


def drives(rng: np.random.Generator) -> list[dict[str, FloatArray]]:
    """Rates in every second run, at which an angle goes round; humidity that wanders."""
    slot = np.arange(BLOCKS)
    return [
        {
            "input_rate": np.where(number % 2, 20.0 * np.sign(np.sin(slot / 8.0 + number)), 0.0),
            "humidity": 50.0 + 10.0 * np.sin(slot / (15.0 + number)) + rng.normal(0.0, 0.1, BLOCKS),
        }
        for number in range(RUNS)
    ]


def one_run(number: int, error: FloatArray, channels: dict[str, FloatArray], gap: BoolArray) -> RunBlocks:
    rng = np.random.default_rng((7, number))
    ones = np.ones(BLOCKS)
    phasors = np.exp(1j * rng.uniform(0.0, 2 * np.pi, (HARMONICS, BLOCKS)))
    phasors[:, gap] = np.nan
    angle = Channel(np.where(gap, np.nan, 1.0), 0.0 * ones, "deg", phasors)
    units = {"input_rate": "deg/s", "humidity": "percent"}
    found = {name: Channel(mean, 0.0 * ones, units[name]) for name, mean in channels.items()}
    return RunBlocks(
        "U1", f"{'rate' if number % 2 else 'rest'}-{number}", "rate", np.arange(BLOCKS), 30.0, number * DAY_NS,
        0.3 * rng.standard_normal() + error + 0.05 * rng.standard_normal(BLOCKS), 30 * ones.astype(int),
        0.0025 * ones, "deg/h", {**found, "table_angle": angle},
    )  # fmt: skip


def test_an_angle_that_no_reading_follows_costs_no_effect_of_a_rate() -> None:
    rng = np.random.default_rng(3)
    channels = drives(rng)
    runs = [
        one_run(number, 0.002 * each["input_rate"], each, each["input_rate"] != 0.0)
        for number, each in enumerate(channels)
    ]
    found = diagnose(runs, MODEL, declared_noise=NOISE)
    assert found.names == ("scale_factor",)
    (coefficient,) = found.effects[0].coefficients
    assert coefficient.lo < 0.002 < coefficient.hi
    # 4 runs of 240 blocks in the training: 0.05 / sqrt(480) / 20 from the rates alone
    assert coefficient.hi - coefficient.lo < 6 * 0.05 / np.sqrt(480) / 20
    (angle,) = [each for each in found.left_out if "table_angle" in each.what]
    assert 0.45 < angle.share <= 0.5
    assert not angle.is_grave


def test_an_effect_is_found_where_its_channel_has_readings() -> None:
    rng = np.random.default_rng(4)
    channels = drives(rng)
    runs = []
    for number, each in enumerate(channels):
        run = one_run(number, 0.02 * (each["humidity"] - 50.0), each, np.zeros(BLOCKS, dtype=np.bool_))
        gone = np.where(np.arange(BLOCKS) % 80 < 30, np.nan, each["humidity"])
        runs.append(replace(run, channels={**run.channels, "humidity": replace(run.channels["humidity"], mean=gone)}))
    found = diagnose(runs, MODEL, declared_noise=NOISE)
    assert "humidity" in found.names
    assert found.limits[0] == "channel humidity has gaps: this diagnosis is of the blocks in which it has a value"


SLOW = {"humidity": "percent", "supply_voltage": "V", "vibration": "g_0", "magnetic_i": "uT", "magnetic_o": "uT"}


def polled(*, alike: bool) -> list[RunBlocks]:
    """Runs with an effect of ``magnetic_o``, and five channels, perhaps alike, with gaps in blocks of their own."""
    rng = np.random.default_rng(6)
    runs = []
    for number in range(RUNS):
        slot = np.arange(BLOCKS)
        waves = {name: np.sin(slot / (9.0 + 3 * k + number)) for k, name in enumerate(SLOW)}
        levels = waves if alike else {name: rng.standard_normal(BLOCKS) for name in SLOW}
        run = one_run(number, (0.1 if alike else 0.02) * levels["magnetic_o"], {}, np.zeros(BLOCKS, dtype=np.bool_))
        channels = {}
        for k, (name, unit) in enumerate(SLOW.items()):
            gone = rng.random(BLOCKS) < 0.25 + 0.02 * k
            channels[name] = Channel(np.where(gone, np.nan, levels[name]), np.zeros(BLOCKS), unit)
        runs.append(replace(run, channels=channels))
    return runs


@pytest.mark.long
def test_each_of_five_channels_that_are_polled_by_themselves_is_looked_at() -> None:
    found = diagnose(polled(alike=True), MODEL, declared_noise=NOISE)
    assert found.names == ("magnetic_o",)


def test_what_no_trace_has_looked_for_is_reported_and_denies_that_nothing_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("analytics.loop.tracing.partial_channels.MOST_GROUPS", 4)
    found = diagnose(polled(alike=False), MODEL, declared_noise=NOISE)
    assert "has gaps in other blocks than" in found.not_tested["magnetic_o"]
    assert found.verdict is ModelVerdict.NOT_ENOUGH_DATA
    (lost,) = [each for each in found.left_out if each.is_grave]
    assert (lost.what, lost.share) == ("channel magnetic_o", 1.0)


def test_an_effect_of_two_channels_with_gaps_in_different_blocks_is_not_said_to_lack_them() -> None:
    rng = np.random.default_rng(8)
    runs = []
    for number, each in enumerate(drives(rng)):
        run = one_run(number, np.zeros(BLOCKS), each, np.zeros(BLOCKS, dtype=np.bool_))
        levels = {f"gravity_{axis}": np.cos(np.arange(BLOCKS) / 20.0 + k) for k, axis in enumerate("io")}
        gaps = {name: np.where(rng.random(BLOCKS) < 0.3, np.nan, value) for name, value in levels.items()}
        more = {name: Channel(value, np.zeros(BLOCKS), "g_0") for name, value in gaps.items()}
        runs.append(replace(run, channels={**run.channels, **more}))
    found = diagnose(runs, MODEL, declared_noise=NOISE)
    assert found.not_tested["gravity_product_io"] == "gravity_i, gravity_o have gaps in different blocks"
    assert "gravity_i" in found.detection_limits


def test_a_gap_that_costs_others_little_is_cut_out() -> None:
    rng = np.random.default_rng(5)
    runs = [
        one_run(number, np.zeros(BLOCKS), each, rng.random(BLOCKS) < 0.05) for number, each in enumerate(drives(rng))
    ]
    whole, gapped = gapped_channels(runs, MODEL)
    assert gapped == []
    assert all("table_angle" in run.channels for run in whole)
