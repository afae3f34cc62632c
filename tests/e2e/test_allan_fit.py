"""Noise coefficients by `gyrofleet allan --fit`, from a file on disk to JSON, table and plot."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

COEFFICIENTS = ["quantization_noise", "angle_random_walk", "bias_instability", "rate_random_walk", "rate_ramp"]
CURVE = [
    "unit", "signal", "run", "unit_of_measure", "sample_interval_s", "samples", "missing",
    "tau_s", "value", "lo", "hi", "edf", "deviation", "overlap", "plausible", "longest_still",
    "left_out_tau_s", "longest_tau_s", "rate_changes",
]  # fmt: skip
WALK, INTERVAL_S = 0.02, 0.005


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """Five minutes of white noise at 200 Hz with a temperature, and a minute at 50 Hz."""

    folder = tmp_path_factory.mktemp("fit")
    rng = np.random.default_rng(2426)
    for name, n, interval_s in (("fast", 60_000, INTERVAL_S), ("slow", 3000, 0.02)):
        rate_deg_per_h = rng.standard_normal(n) * WALK * 60 / np.sqrt(interval_s)
        i = np.arange(n)
        pl.DataFrame(
            {"time[s]": i * interval_s, "rate[deg/s]": rate_deg_per_h / 3600, "temperature[degC]": 25 + i * 1e-4}
        ).write_parquet(folder / f"{name}.parquet")
    files = (folder / "fast.parquet", folder / "slow.parquet")
    assert run_command("import", *files, "--unit", "FOG-1", "--store", folder / "store", cwd=folder).code == 0
    return folder / "store"


def ask(store: Path, *more: object, run: str = "fast", signal: str = "rate") -> tuple[object, ...]:
    return ("allan", "--unit", "FOG-1", "--signal", signal, "--run", run, "--store", store, *more)


def test_the_planted_random_walk_is_within_its_limits(gyrofleet: Callable[..., Any], store: Path) -> None:
    result = gyrofleet(*ask(store, "--fit", "--json")).json
    assert list(result) == [
        *CURVE, "coefficients", "coefficients_reason", "misfit", "misfit_probability", "misfit_level", "confidence",
        "outliers",
    ]  # fmt: skip
    found = result["coefficients"]
    assert list(found) == [*COEFFICIENTS, "markov", "angle_random_walk_normalised"]
    for key in ("angle_random_walk", "angle_random_walk_normalised"):
        assert found[key]["unit_of_measure"] == "deg/sqrt(h)"
        assert found[key]["observable"]
        assert found[key]["lo"] < WALK < found[key]["hi"]
        assert found[key]["hi"] / found[key]["lo"] < 1.3
    assert not found["quantization_noise"]["observable"]
    assert "at most" in found["quantization_noise"]["reason"]
    assert found["quantization_noise"]["value"] is None
    assert 0.0 < result["misfit_probability"] <= 1.0
    assert (result["misfit"] > 0.0) == (result["misfit_probability"] < result["misfit_level"])
    assert found["markov"] is None
    assert list(gyrofleet(*ask(store, "--json")).json) == CURVE


@pytest.mark.long
def test_the_second_table_is_bilingual(gyrofleet: Callable[..., Any], store: Path) -> None:
    done = gyrofleet(*ask(store, "--fit"))
    assert done.code == 0
    for words in ("Overlapping Allan deviation", "Angle random walk 角度随机游走", "量化噪声", "归一化法"):
        assert words in done.out
    assert "not observable (不可观测): at most" in done.out
    assert "归一化法" not in gyrofleet(*ask(store)).out


@pytest.mark.long
def test_what_the_normalised_method_cannot_use_is_said(gyrofleet: Callable[..., Any], store: Path) -> None:
    found = gyrofleet(*ask(store, "--fit", "--json", run="slow")).json["coefficients"]
    assert found["angle_random_walk"]["lo"] < WALK < found["angle_random_walk"]["hi"]
    assert found["angle_random_walk_normalised"]["value"] is None
    assert "less than 0.01 s" in found["angle_random_walk_normalised"]["reason"]


@pytest.mark.long
def test_a_temperature_has_a_curve_and_no_coefficients(
    gyrofleet: Callable[..., Any], store: Path, tmp_path: Path
) -> None:
    done = gyrofleet(*ask(store, "--fit", "--json", signal="temperature"))
    assert done.code == 0
    assert done.json["coefficients"] is None
    assert "unit FOG-1, signal temperature, run fast: the signal is in degC" in done.json["coefficients_reason"]
    assert len(done.json["tau_s"]) > 6
    reported = gyrofleet(*ask(store, "--fit", "--plot", "t.svg", signal="temperature"))
    assert reported.code == 0
    assert "No noise coefficients (无噪声系数)" in reported.out
    assert (tmp_path / "t.svg").exists()


@pytest.mark.long
def test_the_fit_is_drawn(gyrofleet: Callable[..., Any], store: Path, tmp_path: Path) -> None:
    assert gyrofleet(*ask(store, "--fit", "--plot", "fit.png")).code == 0
    assert (tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG")
    for options in (("--fit", "--plot", "fit.svg"), ("--plot", "plain.svg")):
        assert gyrofleet(*ask(store, *options)).code == 0
    assert "legend_1" in (tmp_path / "fit.svg").read_text()
    assert "legend_1" not in (tmp_path / "plain.svg").read_text()
