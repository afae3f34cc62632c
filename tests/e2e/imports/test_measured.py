"""The measured recordings through the whole path, in real processes."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import allantools
import numpy as np
import polars as pl
import pytest

pytestmark = pytest.mark.measured

RATES = ("rate_x", "rate_y", "rate_z")


Stored = Callable[..., Path]


@pytest.fixture(scope="module")
def stored(measured: Path, tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Stored:
    """A store of static runs of the ADIS16405, by their numbers, as runs of one unit; made when it is first needed."""
    folder = tmp_path_factory.mktemp("adis")

    @cache
    def made(*runs: int) -> Path:
        store = folder / "-".join(map(str, runs))
        files = [measured / f"adis16405_static_run{run}.parquet" for run in runs]
        assert run_command("import", *files, "--unit", "ADIS16405", "--store", store, cwd=folder).code == 0
        return store

    return made


@pytest.fixture
def adis_store(stored: Stored) -> Path:
    """The first static run."""
    return stored(1)


@pytest.mark.long
@pytest.mark.parametrize("run", [1, 2])
@pytest.mark.parametrize("signal", RATES)
def test_allan_agrees_with_an_independent_computation(
    gyrofleet: Callable[..., Any], measured: Path, stored: Stored, signal: str, run: int
) -> None:
    name = f"adis16405_static_run{run}"
    curve = gyrofleet(
        "allan", "--unit", "ADIS16405", "--signal", signal, "--run", name, "--store", stored(run), "--json"
    )
    curve = curve.json
    assert curve["unit_of_measure"] == "deg/h"
    assert (curve["samples"], curve["missing"], curve["sample_interval_s"]) == (1_000_000, 0, 0.01)
    rate_deg_per_h = pl.read_parquet(measured / f"{name}.parquet")[f"{signal}[deg/s]"].to_numpy() * 3600.0
    tau_s = np.array([tau for tau in curve["tau_s"] if tau <= 1e4 / 10])
    factors, expected, _, _ = allantools.oadev(rate_deg_per_h, rate=100.0, data_type="freq", taus=tau_s)
    np.testing.assert_allclose(factors, tau_s)
    found = np.array(curve["value"][: len(tau_s)])
    np.testing.assert_allclose(found[tau_s <= 30], expected[tau_s <= 30], rtol=0.01)
    np.testing.assert_allclose(found, expected, rtol=0.03)
    assert np.all(np.array(curve["lo"]) <= np.array(curve["value"]))
    assert np.all(np.array(curve["value"]) <= np.array(curve["hi"]))
    # what is known of these recordings: angle random walk 2.3 to 2.8 deg/sqrt(h), read where the slope is -1/2
    at_1_s = float(np.interp(0.0, np.log(curve["tau_s"]), np.log(curve["value"])))
    assert 2.2 < np.exp(at_1_s) / 60.0 < 2.9


@pytest.mark.long
def test_every_sample_is_in_the_lake_once_with_its_value(
    gyrofleet: Callable[..., Any], measured: Path, stored: Stored
) -> None:
    counted = gyrofleet(
        "sql",
        "select run, signal, count(*) as n, count(distinct t_ns) as moments, "
        "sum(value) as total, sum(value * t_ns) as mixed from samples where signal like 'rate_%' "
        "group by all order by all",
        "--store", stored(1, 2), "--json",
    ).json  # fmt: skip
    assert len(counted) == 6
    assert sum(row["n"] for row in counted if row["run"].endswith("run1")) == 3_000_000
    for row in counted:
        assert row["n"] == row["moments"] == 1_000_000
        frame = pl.read_parquet(measured / f"{row['run']}.parquet", columns=["time[s]", f"{row['signal']}[deg/s]"])
        value = frame[f"{row['signal']}[deg/s]"].to_numpy()
        t_ns = np.round(frame["time[s]"].to_numpy() * 1e9)
        assert row["total"] == pytest.approx(value.sum(), rel=1e-9)
        assert row["mixed"] == pytest.approx((value * t_ns).sum(), rel=1e-9)


@pytest.mark.long
def test_what_was_estimated_live_is_what_the_store_gives(gyrofleet: Callable[..., Any], adis_store: Path) -> None:
    stored = gyrofleet(
        "sql",
        "select tau_s, value, lo, hi, edf from estimates where run = 'adis16405_static_run1' and signal = 'rate_x' "
        "and estimator = 'allan_deviation' and final order by tau_s",
        "--store", adis_store, "--json",
    ).json  # fmt: skip
    curve = gyrofleet(
        "allan", "--unit", "ADIS16405", "--signal", "rate_x", "--run", "adis16405_static_run1",
        "--store", adis_store, "--overlap", "strided", "--json",
    ).json  # fmt: skip
    assert [row["tau_s"] for row in stored] == curve["tau_s"]
    np.testing.assert_allclose([row["value"] for row in stored], curve["value"], rtol=1e-12)
    np.testing.assert_allclose([row["hi"] for row in stored], curve["hi"], rtol=1e-12)


@pytest.mark.long
def test_bias_stability_is_that_of_the_averages(
    gyrofleet: Callable[..., Any], measured: Path, adis_store: Path
) -> None:
    stored = gyrofleet(
        "sql",
        "select estimator, value, n from estimates where run = 'adis16405_static_run1' and signal = 'rate_z' "
        "and estimator similar to 'bias_stability_[0-9]+s' and final",
        "--store", adis_store, "--json",
    ).json  # fmt: skip
    rate = pl.read_parquet(measured / "adis16405_static_run1.parquet")["rate_z[deg/s]"].to_numpy() * 3600.0
    expected = {f"bias_stability_{p}s": rate.reshape(-1, 100 * p).mean(axis=1).std(ddof=1) for p in (1, 10, 100)}
    assert {row["estimator"]: row["value"] for row in stored} == pytest.approx(expected, rel=1e-9)
    assert {row["estimator"]: row["n"] for row in stored} == {
        "bias_stability_1s": 10_000, "bias_stability_10s": 1000, "bias_stability_100s": 100,
    }  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("run", [1, 2])
@pytest.mark.parametrize("signal", RATES)
def test_the_fitted_random_walk_is_that_of_the_device(
    gyrofleet: Callable[..., Any], stored: Stored, signal: str, run: int
) -> None:
    found = gyrofleet(
        "allan", "--unit", "ADIS16405", "--signal", signal, "--run", f"adis16405_static_run{run}",
        "--store", stored(run), "--fit", "--json",
    ).json["coefficients"]  # fmt: skip
    walk = found["angle_random_walk"]
    assert (walk["unit_of_measure"], walk["observable"]) == ("deg/sqrt(h)", True)
    assert found["angle_random_walk_normalised"]["value"] is None
    assert "asks for less than 0.01 s" in found["angle_random_walk_normalised"]["reason"]
    assert 2.0 < walk["value"] < 3.0


def test_steps_of_the_ferraris_session(gyrofleet: Callable[..., Any], measured: Path) -> None:
    done = gyrofleet("import", measured / "ferraris_session.parquet", "--unit", "IMU-1", "--json")
    assert done.json["files"][0]["steps"] == 9
    rows = gyrofleet(
        "sql",
        "select s.step, count(*) as n from steps s join samples x on x.run = s.run and x.unit = s.unit "
        "and x.t_ns between s.t_start_ns and s.t_end_ns where x.signal = 'rate_x' group by s.step, s.t_start_ns "
        "order by s.t_start_ns", "--json",
    ).json  # fmt: skip
    assert [(row["step"], row["n"]) for row in rows] == [
        ("x_p", 731), ("x_a", 741), ("y_p", 484), ("y_a", 412), ("z_p", 453), ("z_a", 607),
        ("x_rot", 323), ("y_rot", 324), ("z_rot", 307),
    ]  # fmt: skip


def test_a_gap_is_a_gap_in_the_cold_chamber(gyrofleet: Callable[..., Any], measured: Path) -> None:
    assert gyrofleet("import", measured / "psim_cold_chamber.parquet", "--unit", "PSIM").code == 0
    rows = gyrofleet(
        "sql",
        "select (t_ns - lag(t_ns) over (order by t_ns)) / 1e9 as step_s from samples where signal = 'rate_x' "
        "qualify step_s > 1", "--json",
    ).json  # fmt: skip
    assert len(rows) == 24
    assert all(300.0 <= row["step_s"] <= 300.1 for row in rows)
    (span,) = gyrofleet("sql", "select (max(t_ns) - min(t_ns)) / 1e9 as s from samples", "--json").json
    assert span["s"] == pytest.approx(7320, abs=5)
    (kind,) = gyrofleet(
        "sql", "select is_counts, sum(counts) is not null as has from signals join samples using (unit, signal, run) "
        "where signal = 'temperature' group by all", "--json",
    ).json  # fmt: skip
    assert kind == {"is_counts": True, "has": True}
    refused = gyrofleet("allan", "--unit", "PSIM", "--signal", "rate_x")
    assert refused.code == 1
    assert "--resample" in refused.err
    resampled = gyrofleet("allan", "--unit", "PSIM", "--signal", "rate_x", "--resample", "1", "--json").json
    assert resampled["sample_interval_s"] == 1.0
    assert max(resampled["tau_s"]) <= 4  # bursts of 5 s: longer averages have no data
    assert resampled["missing"] > 7000
