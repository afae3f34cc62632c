"""Readings far outside: a fill value or a flipped bit costs its block and is reported, motion never does."""

import numpy as np
import pytest

from tests.analytics.conftest import SECOND_NS, START_NS, TestedUnits, reduced


@pytest.mark.long
@pytest.mark.parametrize("block_s", [30.0, 0.8])
def test_a_reading_far_outside_costs_its_block_and_is_told(tested: TestedUnits, block_s: float) -> None:
    rng = np.random.default_rng(15)
    clean = {}
    for run, fill in (("r1", None), ("r2", -99999.0), ("r3", 1e6)):
        tested.run(run)
        rate, warm = rng.normal(10.0, 1.0, 6000), 25.0 + np.cumsum(rng.normal(0.0, 0.002, 6000))
        clean[run] = rate.copy(), warm.copy()
        if fill is not None:
            rate[[455, 3000, 5999]], warm[1234] = fill, fill
        tested.step(run, "U1", {"rate": (rate, "deg/h"), "temperature": (warm, "degC")}, t0_ns=START_NS)
        tested.power_on(run, "U1", START_NS)
    reduction = reduced(tested, block_s=block_s)
    far = {note.channel: note for note in reduction.notes if note.what == "far_outside"}
    assert far["rate"].runs == far["temperature"].runs == ("r2", "r3")
    assert far["rate"].text.startswith("6 blocks or readings of rate are left out in 2 of 3 runs (r2, r3)")
    assert "up to 1e+06 deg/h" in far["rate"].text
    assert not [note for note in reduction.notes if note.what == "not_finite"]
    per_block = round(10 * block_s)
    for blocks in reduction.runs:
        rate, warm = clean[blocks.run]
        gone = {455 // per_block, 3000 // per_block, 5999 // per_block} if blocks.run != "r1" else set()
        assert blocks.slot.tolist() == [slot for slot in range(6000 // per_block) if slot not in gone]
        np.testing.assert_array_equal(blocks.n, per_block)
        np.testing.assert_allclose(blocks.value, rate.reshape(-1, per_block).mean(axis=1)[blocks.slot], rtol=1e-12)
        heat = warm.reshape(-1, per_block).mean(axis=1)[blocks.slot]
        if blocks.run != "r1":
            heat[blocks.slot == 1234 // per_block] = np.nan
        np.testing.assert_allclose(blocks.mean("temperature"), heat, rtol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("what", ["pulses", "sweep", "vibration"])
def test_motion_is_never_far_outside(tested: TestedUnits, what: str) -> None:
    """A unit that rests most of the time and moves for a second, with a quiet encoder and a noisy gyro."""
    rng = np.random.default_rng(17)
    time_s = np.arange(0.0, 600.0, 0.02)
    motion = {
        "pulses": 10.0 * np.sin(np.pi * np.clip((time_s % 60.0 - 30.05) / 0.9, 0.0, 1.0)),
        "sweep": np.where(time_s % 60.0 < 8.0, 50.0 - np.abs(time_s % 4.0 - 2.0) * 25.0, 0.0),
        "vibration": np.where(time_s % 60.0 < 10.0, 30.0 * np.sin(2 * np.pi * 0.1 * time_s), 0.0),
    }[what]
    tested.run("r1")
    tested.power_on("r1", "U1", START_NS)
    signals = {
        "rate": (3600.0 * motion + rng.normal(0.0, 1.0, time_s.size), "deg/h"),
        "input_rate": (motion + rng.normal(0.0, 1e-4, time_s.size), "deg/s"),
    }
    tested.step("r1", "U1", signals, t0_ns=START_NS, dt_ns=20_000_000)
    assert not [note for note in reduced(tested).notes if note.what == "far_outside"]


@pytest.mark.long
@pytest.mark.parametrize(("dt_s", "quantum"), [(1.0, 1.0), (10.0, 0.01), (20.0, 1.0)])
def test_a_fill_value_of_a_slow_or_coarse_channel_is_no_reading(
    tested: TestedUnits, dt_s: float, quantum: float
) -> None:
    rng = np.random.default_rng(18)
    tested.run("r1")
    tested.power_on("r1", "U1", START_NS)
    tested.samples("r1", "U1", "rate", rng.normal(0.0, 1.0, 36_000), t0_ns=START_NS)
    at_s = np.arange(0.0, 3600.0, dt_s)
    warm = np.round((25.0 + 5.0 * np.sin(at_s / 600.0) + rng.normal(0.0, 0.02, at_s.size)) / quantum) * quantum
    filled = warm.copy()
    filled[len(at_s) // 2] = -9999.0
    tested.samples(
        "r1", "U1", "temperature", filled, t0_ns=START_NS, dt_ns=round(dt_s * SECOND_NS), unit_of_measure="degC"
    )
    reduction = reduced(tested)
    (note,) = [note for note in reduction.notes if note.what == "far_outside"]
    assert "up to -9999 degC" in note.text
    (run,) = reduction.runs
    assert np.nanmin(run.mean("temperature")) >= warm.min()


def test_what_lasts_longer_than_a_second_stays(tested: TestedUnits) -> None:
    tested.run("r1")
    rate = np.random.default_rng(16).normal(10.0, 1.0, 6000)
    rate[1005:1025] += 1e4  # two seconds across three
    rate[3000:] += 1e4
    tested.samples("r1", "U1", "rate", rate, t0_ns=START_NS)
    reduction = reduced(tested)
    assert not [note for note in reduction.notes if note.what == "far_outside"]
    np.testing.assert_array_equal(reduction.runs[0].n, 300)


@pytest.mark.in_gate("degF-1.8-32.0--999.0")
@pytest.mark.parametrize(
    ("unit_of_measure", "scale", "zero", "fill"), [("degC", 1.0, 0.0, -999.0), ("degF", 1.8, 32.0, -999.0)]
)
def test_a_temperature_below_absolute_zero_is_left_out_however_long(
    tested: TestedUnits, unit_of_measure: str, scale: float, zero: float, fill: float
) -> None:
    rng = np.random.default_rng(15)
    tested.run("r1")
    warm = 25.0 + np.cumsum(rng.normal(0.0, 0.002, 6000))
    read = warm * scale + zero
    read[1200:2450] = fill  # two minutes of ten samples a second
    tested.step(
        "r1",
        "U1",
        {"rate": (rng.normal(10.0, 1.0, 6000), "deg/h"), "temperature": (read, unit_of_measure)},
        t0_ns=START_NS,
    )
    tested.power_on("r1", "U1", START_NS)
    reduction = reduced(tested, block_s=10.0)
    (note,) = [note for note in reduction.notes if note.what == "far_outside"]
    assert note.channel == "temperature"
    assert f"outliers of up to -999 {unit_of_measure}" in note.text
    heat = warm.reshape(-1, 100).mean(axis=1)
    heat[12:25] = np.nan  # of the last block a half is bad
    (run,) = reduction.runs
    np.testing.assert_allclose(run.mean("temperature"), heat, rtol=1e-9)
