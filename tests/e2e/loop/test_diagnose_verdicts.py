"""Verdicts of `gyrofleet diagnose` on imported files: what the record cannot tell is not called absent."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from stream.batch import FloatArray

SECONDS = 2400
TIME_S = np.arange(float(SECONDS))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """A rate-table set, two runs at two temperatures, and seven runs of which one has no temperature."""
    folder = tmp_path_factory.mktemp("verdicts")
    rng = np.random.default_rng(2024)
    turning = np.where(TIME_S // 300 % 2 == 1, 40.0, 0.0)
    still = np.zeros(SECONDS)
    runs = [
        ("TABLE", name, {"rate[deg/h]": 3600.0 * rate + noise(rng), "input_rate[deg/s]": rate})
        for name, rate in (("X_up", still), ("Y_up", still), ("Z_up", turning))
    ]
    runs += [
        ("PAIR", name, {"rate[deg/h]": mean + noise(rng), "temperature[degC]": warm + 0.05 * np.sin(TIME_S / 200.0)})
        for name, mean, warm in (("cold", 0.0, 13.0), ("hot", 80.0, 48.0))
    ]
    for number in range(7):
        warm = 25.0 + 10.0 * np.sin(TIME_S / (150.0 + 20.0 * number))
        columns = {"rate[deg/h]": 0.3 * (warm - 25.0) + noise(rng), "temperature[degC]": warm}
        runs.append(("SEVEN", f"s{number}", columns if number != 2 else {"rate[deg/h]": noise(rng)}))
    for unit, run, columns in runs:
        written(folder / f"{unit}-{run}.parquet", unit, run, columns)
    files = sorted(folder.glob("*.parquet"))
    assert run_command("import", *files, "--store", folder / "store", cwd=folder).code == 0
    return folder / "store"


def noise(rng: np.random.Generator) -> FloatArray:
    """A bias of its own and white noise of 0.01 deg/sqrt(h)."""
    return np.asarray(0.1 * rng.standard_normal() + 0.6 * rng.standard_normal(SECONDS))


def written(path: Path, unit: str, run: str, columns: Mapping[str, FloatArray]) -> None:
    frame = {"time[s]": TIME_S, "unit": [unit] * SECONDS, "run": [run] * SECONDS, **columns}
    pl.DataFrame(frame).write_parquet(path)


@pytest.mark.long
def test_a_scale_factor_that_no_fitted_run_tells_is_not_nothing_missing(
    gyrofleet: Callable[..., Any], store: Path
) -> None:
    words = ("diagnose", "--unit", "TABLE", "--model", "rate = bias + scale_factor*input_rate", "--store", store)
    found = gyrofleet(*words, "--holdout", "runs=Z_up", "--json").json
    assert found["verdict"] == "not_enough_data"
    assert "term scale_factor" in found["missing"][0]
    assert "--holdout runs=" in found["missing"][0]
    assert found["error"]["before"]["rms_30s"] > 10_000  # deg/h, on the run that was held out
    reported = gyrofleet(*words, "--holdout", "runs=Z_up", "--lang", "zh")
    assert "数据不足" in reported.out
    # what the advice says helps
    again = gyrofleet(*words, "--holdout", "runs=X_up", "--json").json
    assert again["verdict"] == "nothing_missing"


@pytest.mark.long
def test_two_runs_that_differ_cannot_tell_temperature_from_turn_on(gyrofleet: Callable[..., Any], store: Path) -> None:
    words = ("diagnose", "--unit", "PAIR", "--model", "rate = bias", "--store", store)
    found = gyrofleet(*words, "--json").json
    assert found["verdict"] == "confounded"
    assert [each["name"] for each in found["effects"]] == ["turn_on"]
    others = {each["name"]: each["recorded"] for each in found["confounded"]}
    assert others["temperature"]
    assert others["gravity_i"] is False
    error = found["error"]
    assert error["floor"]["rms_300s"] > 20 * error["floor_within"]["rms_300s"]
    reported = gyrofleet(*words, "--report", "r.html", "--save")
    assert reported.code == 0
    assert "The runs differ by" in reported.out
    assert "2 runs cannot separate these causes" in reported.out
    # the scatter is the user's to declare; without it it is estimated, and still a finding
    estimated = gyrofleet(*words, "--noise", "N=0.01,B=0.01,K=0.01", "--json").json
    assert estimated["noise_source"] == "as given; turn-on scatter estimated from these runs"
    assert estimated["verdict"] == "confounded"
    declared = gyrofleet(*words, "--noise", "N=0.01,B=0.01,K=0.01,turn_on=60", "--json").json
    assert "turn_on" not in [each["name"] for each in declared["effects"]]


@pytest.mark.long
def test_a_run_without_a_channel_does_not_hide_its_effect(gyrofleet: Callable[..., Any], store: Path) -> None:
    found = gyrofleet("diagnose", "--unit", "SEVEN", "--model", "rate = bias", "--store", store, "--json").json
    names = [each["name"] for each in (*found["effects"], *found["confounded"])]
    assert "temperature" in names
    assert any(each["what"] == "runs (s2)" for each in found["left_out"])
    after = found["error"]["after"]["rms_300s"]
    assert after < 0.2 * found["error"]["before"]["rms_300s"]


@pytest.mark.long
@pytest.mark.measured
def test_bmi270_cold_and_hot_differ_and_two_runs_cannot_tell_why(
    gyrofleet: Callable[..., Any], measured: Path, tmp_path: Path
) -> None:
    files = [measured / f"bmi270_{name}.parquet" for name in ("cold", "hot")]
    assert gyrofleet("import", *files, "--unit", "BMI", "--store", "S").code == 0
    words = ("--model", "rate_x = bias", "--block", "10s", "--store", "S", "--json")
    found = gyrofleet("diagnose", "--unit", "BMI", *words).json
    assert found["verdict"] == "confounded"
    assert found["effects"][0]["name"] == "turn_on"
    # 0.65 deg/s apart; of two values the standard deviation is that over sqrt(2)
    assert found["effects"][0]["coefficient"] == pytest.approx(0.65 * 3600 / 2**0.5, rel=0.05)
    assert {"temperature", "gravity_i"} <= {each["name"] for each in found["confounded"]}
    error = found["error"]
    assert error["floor"]["rms_10s"] > 5 * error["floor_within"]["rms_10s"]
