"""The spectrum by `gyrofleet spectrum`, from a file on disk to lines, JSON and plot."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

INTERVAL_S, SIGMA = 0.005, 20.0
LEVEL = 2.0 * SIGMA**2 * INTERVAL_S
LINE_HZ, AMPLITUDE = 12.3456, 3.0
WARM_HZ, WARM_AMPLITUDE = 0.111, 0.05


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """A rate with a sine and a quiet one, a temperature that hunts; one of uneven times, one of a second, one holed."""
    folder = tmp_path_factory.mktemp("spectrum")
    rng = np.random.default_rng(1967)
    n = 60_000
    t_s = np.arange(n) * INTERVAL_S
    noise_x, noise_y = SIGMA * rng.standard_normal((2, n))
    rate_x = noise_x + AMPLITUDE * np.sin(2.0 * np.pi * LINE_HZ * t_s + 1.0)
    frame = pl.DataFrame({"time[s]": t_s, "rate_x[deg/s]": rate_x / 3600.0, "rate_y[deg/s]": noise_y / 3600.0})
    frame.write_parquet(folder / "long.parquet")
    faulty = np.delete(noise_x + 60.0 * np.sin(2.0 * np.pi * (50.0 * t_s + 0.5 * 0.2 / 300.0 * t_s**2)), [777, 40_000])
    faulty[30_000] = 99_999.0
    times = np.delete(t_s, [777, 40_000])
    pl.DataFrame({"time[s]": times, "rate_x[deg/h]": faulty}).write_parquet(folder / "faulty.parquet")
    frame[:100].write_parquet(folder / "short.parquet")
    frame[:300].write_parquet(folder / "one_segment.parquet")
    frame.filter(pl.Series(np.arange(n) % 1000 < 996)).write_parquet(folder / "holed.parquet")
    seconds = np.arange(3600.0)
    hunting = 25.0 + 0.05 * rng.standard_normal(3600) + WARM_AMPLITUDE * np.sin(2.0 * np.pi * WARM_HZ * seconds)
    pl.DataFrame({"time[s]": seconds, "temperature[degC]": hunting}).write_parquet(folder / "warm.parquet")
    uneven = np.cumsum(rng.uniform(0.2, 1.8, 2000))
    pl.DataFrame({"time[s]": uneven, "rate_x[deg/s]": rng.standard_normal(2000)}).write_csv(folder / "uneven.csv")
    files = sorted([*folder.glob("*.parquet"), *folder.glob("*.csv")])
    assert run_command("import", *files, "--unit", "FOG-1", "--store", folder / "store", cwd=folder).code == 0
    return folder / "store"


def ask(store: Path, *more: object, run: str = "long", signal: str = "rate_x") -> tuple[object, ...]:
    return ("spectrum", "--unit", "FOG-1", "--signal", signal, "--run", run, "--store", store, *more)


def test_the_planted_sine_is_found_within_its_limits(gyrofleet: Callable[..., Any], store: Path) -> None:
    result = gyrofleet(*ask(store, "--json")).json
    assert list(result)[:7] == [
        "unit", "signal", "run", "unit_of_measure", "sample_interval_s", "samples", "missing",
    ]  # fmt: skip
    assert (result["samples"], result["missing"], result["sample_interval_s"]) == (60_000, 0, INTERVAL_S)
    assert (result["unit_of_measure"], result["psd_unit"]) == ("deg/h", "(deg/h)^2/Hz")
    assert (result["segments"], result["segment_samples"]) == (13, 8192)
    (line,) = result["lines"]
    assert line["frequency_lo_hz"] <= LINE_HZ <= line["frequency_hi_hz"]
    assert line["frequency_hi_hz"] - line["frequency_lo_hz"] < 0.01
    assert line["lo"] <= AMPLITUDE <= line["hi"]
    assert line["hi"] / line["lo"] < 1.5
    assert line["unit_of_measure"] == "deg/h"
    columns = [result[name] for name in ("frequency_hz", "lo", "psd", "hi")]
    frequency_hz, lo, psd, hi = (np.array(column) for column in columns)
    quiet = np.abs(frequency_hz - LINE_HZ) > 1.0
    assert psd[quiet].mean() == pytest.approx(LEVEL, rel=0.03)
    assert np.mean((lo <= LEVEL) & (hi >= LEVEL)) == pytest.approx(0.95, abs=0.02)


def test_lines_and_levels_are_told(gyrofleet: Callable[..., Any], store: Path) -> None:
    done = gyrofleet(*ask(store))
    assert done.code == 0
    reported = " ".join(done.out.split())
    for words in (
        "Lines (谱线) of FOG-1 rate_x, run long",
        "Power spectral density (功率谱密度)",
        "13 segments of 8,192 samples (40.96 s)",
        "Searched from 0.7324 to 99.29 Hz; of spectra without any line, at most 1 % show one",
    ):
        assert words in reported
    assert re.search(r"│ 12\.34\d+ ± 0\.000\d+ │ [23]\.\d+ │", reported)


def test_a_line_that_moves_an_outlier_and_lost_samples_are_named(gyrofleet: Callable[..., Any], store: Path) -> None:
    result = gyrofleet(*ask(store, "--json", run="faulty")).json
    (line,) = result["lines"]
    assert line["is_steady"] is False
    assert line["lo"] <= 60.0 <= line["hi"]
    assert line["frequency_lo_hz"] <= 50.1 <= line["frequency_hi_hz"]
    assert 0.15 < line["frequency_hi_hz"] - line["frequency_lo_hz"] < 0.25  # it moves by 0.2 Hz
    assert (result["outliers"], result["bridged"], result["segments_left_out"]) == (1, 3, 0)
    assert np.median(result["psd"]) == pytest.approx(LEVEL, rel=0.1)
    done = gyrofleet(*ask(store, run="faulty"))
    reported = " ".join(done.out.split())
    assert reported.index("isolated outliers are left out: 1, up to") < reported.index("Lines (谱线)")
    assert "Hz there is not one steady sinusoid over the record" in reported
    assert "not steady 不稳定" in reported


@pytest.mark.long
def test_without_a_line_that_is_said_with_what_was_tested(gyrofleet: Callable[..., Any], store: Path) -> None:
    assert gyrofleet(*ask(store, "--json", signal="rate_y")).json["lines"] == []
    done = gyrofleet(*ask(store, signal="rate_y"))
    assert done.code == 0
    assert "No line stands out (无显著谱线) of FOG-1 rate_y, run long." in done.out
    assert "Searched from 0.7324 to 99.29 Hz; of spectra without any line, at most 1 % show one" in done.out
    assert "line seen from deg/h" in done.out
    assert "Lines (谱线)" not in done.out


def test_a_temperature_stays_in_its_own_unit(gyrofleet: Callable[..., Any], store: Path) -> None:
    result = gyrofleet(*ask(store, "--json", run="warm", signal="temperature")).json
    assert (result["unit_of_measure"], result["psd_unit"]) == ("degC", "(degC)^2/Hz")
    (line,) = result["lines"]
    assert line["frequency_lo_hz"] <= WARM_HZ <= line["frequency_hi_hz"]
    assert line["lo"] <= WARM_AMPLITUDE <= line["hi"]
    assert line["unit_of_measure"] == "degC"


@pytest.mark.long
def test_segments_are_shortened_until_gaps_leave_some_whole(gyrofleet: Callable[..., Any], store: Path) -> None:
    result = gyrofleet(*ask(store, "--json", run="holed")).json
    assert (result["samples"], result["missing"]) == (59_760, 236)
    assert result["segment_samples"] == 512
    assert result["segments"] >= 60
    assert result["segments_left_out"] > 0
    assert "left out for missing samples" in gyrofleet(*ask(store, run="holed")).out


@pytest.mark.long
def test_what_has_no_spectrum_is_refused_with_the_reason(gyrofleet: Callable[..., Any], store: Path) -> None:
    for run, reason in (
        ("uneven", "the samples are irregular, and it needs equal intervals; gyrofleet allan --resample SECONDS"),
        ("short", "a segment of 128 samples without a gap needed, 100 samples seen"),
    ):
        refused = gyrofleet(*ask(store, "--plot", "none.png", run=run))
        assert refused.code == 1
        assert f"unit FOG-1, signal rate_x, run {run}: no power spectral density: {reason}" in refused.err
        assert refused.err.count("\n") == 1
    answer = gyrofleet(*ask(store, "--json", run="uneven"))
    assert answer.json["error"]["kind"] == "NotEnoughData"
    assert "it holds rate_x, rate_y, temperature" in gyrofleet(*ask(store, signal="rate")).err


@pytest.mark.long
def test_a_single_segment_will_do(gyrofleet: Callable[..., Any], store: Path) -> None:
    result = gyrofleet(*ask(store, "--json", run="one_segment")).json
    assert (result["segments"], result["segment_samples"], result["edf"]) == (1, 256, 2.0)
    assert gyrofleet(*ask(store, "--plot", "one.png", run="one_segment")).code == 0


@pytest.mark.long
def test_the_plot_is_written(gyrofleet: Callable[..., Any], store: Path, tmp_path: Path) -> None:
    done = gyrofleet(*ask(store, "--plot", "a.png"))
    assert done.code == 0
    assert "plot: a.png" in done.err
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert gyrofleet(*ask(store, "--plot", "a.svg", "--json")).json["lines"]
    assert "<svg" in (tmp_path / "a.svg").read_text(encoding="utf-8")
    refused = gyrofleet(*ask(store, "--plot", "a.pdf"))
    assert refused.code == 1
    assert ".png or .svg" in refused.err
