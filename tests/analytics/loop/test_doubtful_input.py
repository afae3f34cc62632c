"""What looks wrong in a record is reported, and true motion does not look wrong; what is lost forbids a denial."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from analytics.loop.unit_diagnosis import diagnose_units
from analytics.loop.unit_reduction import Question
from stream.batch import FloatArray
from tests.analytics.conftest import SECOND_NS, START_NS, TestedUnits, reduced

N_SAMPLES = 3600


def one_hertz(tested: TestedUnits, run: str, **signals: tuple[FloatArray, str]) -> None:
    tested.run(run)
    tested.power_on(run, "U1", START_NS)
    for name, (values, unit) in signals.items():
        tested.samples(run, "U1", name, values, t0_ns=START_NS, dt_ns=SECOND_NS, unit_of_measure=unit)


def reported(tested: TestedUnits, what: str) -> list[str]:
    return [note.text for note in reduced(tested).notes if note.what == what]


@pytest.mark.long
@pytest.mark.parametrize("hz", [0.05, 0.2, 1 / 3, 0.45])
def test_swings_between_rests_are_no_fill_values(tested: TestedUnits, hz: float) -> None:
    rng = np.random.default_rng(2)
    time_s = np.arange(float(N_SAMPLES))
    swings = np.where(time_s % 600.0 < 20.0, 30.0 * np.sin(2 * np.pi * hz * time_s + 0.3), 0.0)
    one_hertz(tested, "r1", rate=(3600.0 * swings + rng.normal(0.0, 1.0, time_s.size), "deg/h"))
    assert reported(tested, "far_outside") == []


def test_a_turn_of_one_second_is_borne_out_by_the_table(tested: TestedUnits) -> None:
    rng = np.random.default_rng(3)
    turns = np.zeros(N_SAMPLES)
    turns[300::600] = [12.0, -7.0, 30.0, 5.0, -15.0, 9.0]
    rate = 3600.0 * turns + rng.normal(0.0, 1.0, turns.size)
    one_hertz(tested, "r1", rate=(rate, "deg/h"), input_rate=(turns + rng.normal(0.0, 1e-6, turns.size), "deg/s"))
    (run,) = (reduction := reduced(tested)).runs
    assert [note.what for note in reduction.notes if note.what == "far_outside"] == []
    assert len(run) == N_SAMPLES // 30
    np.testing.assert_allclose(run.value, 3600.0 * run.mean("input_rate"), atol=2.0)


@pytest.mark.long
@pytest.mark.parametrize("fill", [-9999.0, 1e6])
def test_a_fill_value_is_no_motion_though_every_column_has_it(tested: TestedUnits, fill: float) -> None:
    rng = np.random.default_rng(4)
    rate, table = rng.normal(0.0, 1.0, N_SAMPLES), rng.normal(0.0, 1e-6, N_SAMPLES)
    rate[[455, 2000]] = table[[455, 2000]] = fill
    one_hertz(tested, "r1", rate=(rate, "deg/h"), input_rate=(table, "deg/h"), table_rate=(table, "deg/s"))
    (run,) = (reduction := reduced(tested)).runs
    far = {note.channel for note in reduction.notes if note.what == "far_outside"}
    assert far == {"rate", "input_rate", "table_rate"}
    assert set(range(N_SAMPLES // 30)) - set(run.slot.tolist()) == {15, 66}
    (blocks,) = reduction.left_out
    assert blocks.document() == {
        "what": "120 blocks",
        "share": 2 / 120,
        "why": "a reading of the signal lies far outside its neighbours",
    }


@pytest.mark.long
@pytest.mark.parametrize(("label", "factor", "is_wrong"), [
    ("deg/h", 1.0, True),
    ("deg/h", 3600.0, False),
    ("rad/s", 1.0, True),
    ("rad/s", np.pi / 180.0, False),
    ("deg/s", 1.0, False),
    ("deg/s", 1000.0, True),
])  # fmt: skip
def test_a_rate_under_the_label_of_another_unit_is_reported(
    tested: TestedUnits, label: str, factor: float, is_wrong: bool
) -> None:
    rng = np.random.default_rng(5)
    turned = np.repeat([0.0, 10.0, -10.0, 0.0, 60.0, -60.0], N_SAMPLES // 6)
    rate = 3600.4 * turned + rng.normal(0.0, 1.0, turned.size)
    one_hertz(tested, "r1", rate=(rate, "deg/h"), input_rate=(factor * turned, label))
    found = reported(tested, "unit_label")
    assert bool(found) is is_wrong
    assert all("correct the label and import again" in text for text in found)


@pytest.mark.long
def test_isolated_outliers_that_raise_n_are_reported(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    """One sample in ten thousand, 35 times the noise: N is 6 % higher for it."""
    rng = np.random.default_rng(6)
    noise = rng.normal(0.0, 1.0, 20_000)
    for name, far in (("clean", 0.0), ("struck", 35.0)):
        values = noise.copy()
        values[[6000, 14_000]] += far
        frame = pl.DataFrame({"time[s]": np.arange(20_000.0), "rate[deg/h]": values})
        frame.write_csv(tmp_path / f"{name}.csv")
    files = [tmp_path / "clean.csv", tmp_path / "struck.csv"]
    assert gyrofleet("import", *files, "--unit", "FOG-1", "--store", "S").code == 0
    words = ("allan", "--unit", "FOG-1", "--signal", "rate", "--fit", "--store", "S", "--run")
    documents = {name: gyrofleet(*words, name, "--json").json for name in ("clean", "struck")}
    assert documents["clean"]["outliers"]["count"] == 0
    assert documents["struck"]["outliers"]["count"] == 2
    found = {name: each["coefficients"]["angle_random_walk"]["value"] for name, each in documents.items()}
    raised = found["struck"] / found["clean"] - 1.0
    assert documents["struck"]["outliers"]["raise_n_by"] == pytest.approx(0.06, abs=0.01)
    assert raised == pytest.approx(0.06, abs=0.02)
    assert "2 isolated outliers, up to" in gyrofleet(*words, "struck").out
    notes = gyrofleet("diagnose", "--unit", "FOG-1", "--model", "rate = bias", "--store", "S", "--json").json[
        "reduction"
    ]
    (text,) = [note["text"] for note in notes if note["what"] == "outliers"]
    assert "2 samples of rate are isolated outliers in 1 of 2 runs (struck)" in text


@pytest.mark.long
@pytest.mark.parametrize("is_recorded", [True, False])
def test_a_turn_of_the_table_is_no_outlier(tested: TestedUnits, is_recorded: bool) -> None:
    rng = np.random.default_rng(7)
    turned = np.zeros(N_SAMPLES)
    turned[N_SAMPLES // 3] = turned[2 * N_SAMPLES // 3] = 0.5
    rate = 3600.0 * turned + rng.normal(0.0, 1.0, N_SAMPLES)
    channels = {"table_rate": (turned, "deg/s")} if is_recorded else {}
    one_hertz(tested, "r1", rate=(rate, "deg/h"), **channels)
    assert bool(reported(tested, "outliers")) is not is_recorded


@pytest.mark.long
@pytest.mark.parametrize("part", [0.5, 1.0])
def test_rates_that_are_polled_too_seldom_forbid_to_say_that_nothing_is_missing(
    tested: TestedUnits, part: float
) -> None:
    """A table that swings for half of a run or all of it, read once in 30 s at one moment, beside means of the gyro."""
    rng = np.random.default_rng(7)
    fine_s = np.arange(0.0, 7200.0, 1.0)
    for number in range(6):
        run = f"{number}-{'swing' if number % 2 else 'rest'}"
        swing = (number % 2) * 20.0 * np.sin(2 * np.pi * fine_s / 100.0) * (fine_s >= 7200.0 * (1.0 - part))
        rate = (3600.0 * swing + rng.normal(0.0, 1.0, fine_s.size)).reshape(-1, 30).mean(axis=1)
        tested.run(run, t_ns=START_NS + number * 86_400 * SECOND_NS)
        polled = swing[::30] + rng.normal(0.0, 1e-6, 240)
        for name, values, unit in (("rate", rate, "deg/h"), ("input_rate", polled, "deg/s")):
            t0_ns = START_NS + number * 86_400 * SECOND_NS
            tested.samples(run, "U1", name, values, t0_ns=t0_ns, dt_ns=30 * SECOND_NS, unit_of_measure=unit)
    with tested.catalog() as catalog:
        traced = diagnose_units(catalog, ["U1"], Question("rate = bias + scale_factor*input_rate")).units["U1"]
    diagnosis = traced.diagnosis
    lost = {each["what"]: each["share"] for each in diagnosis.document()["left_out"]}
    assert lost["the excitation of input_rate"] > 0.95
    assert lost["runs 'swing'"] == pytest.approx(part, abs=0.02)
    assert diagnosis.verdict.value == "not_enough_data"
    assert "of the excitation of input_rate left out: the reference rate changes" in " ".join(diagnosis.missing)
    first = diagnosis.limits[0]
    assert "left out: the reference rate changes within them faster than its readings show" in first
    (advice,) = [note.text for note in traced.data.notes if note.what == "unresolved"]
    assert "record it more often than once in 30 s, or as means" in advice


@pytest.mark.parametrize(("resolution", "share"), [(1e-3, 0.5), (1e-3, 0.1), (1.0, 0.5)])
def test_a_thermometer_that_stops_for_half_a_run_is_reported(
    tested: TestedUnits, resolution: float, share: float
) -> None:
    rng = np.random.default_rng(8)
    time_s = np.arange(float(N_SAMPLES))
    for run in ("r1", "r2"):
        degrees = 25.0 + 0.001 * time_s + rng.normal(0.0, 0.01, N_SAMPLES)
        if run == "r2":
            degrees[: int(share * N_SAMPLES)] = degrees[0]
        degrees = resolution * np.round(degrees / resolution)
        one_hertz(tested, run, rate=(rng.normal(0.0, 1.0, N_SAMPLES), "deg/h"), temperature=(degrees, "degC"))
    expected = ["in 1 of 2 runs (r2)"] if (resolution, share) == (1e-3, 0.5) else []
    # a thermometer of 1 degC stands still by its resolution, and a tenth of a run is no long stretch
    assert [text.partition(" of a run ")[2].partition(",")[0] for text in reported(tested, "stopped")] == expected
