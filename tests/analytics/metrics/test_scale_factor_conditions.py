"""Scale factors of rates that were measured instead of commanded, and of a temperature that moved meanwhile."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stream.batch import FloatArray
from tests.analytics.conftest import START_NS
from tests.analytics.metrics.rate_table import BOTH, RATES, Table, by_standard, cubic

METRICS = ("scale_factor", "scale_factor_nonlinearity", "scale_factor_asymmetry")


@pytest.mark.parametrize("metrics", [METRICS[:1], pytest.param(METRICS[1:], marks=pytest.mark.long)])
def test_measured_rates_in_the_column_of_commands_are_symmetric(
    tested: Any, table: Callable[..., Table], metrics: tuple[str, ...]
) -> None:
    jitter = 1 + 2e-4 * np.random.default_rng(3).uniform(-1, 1, len(BOTH))
    rate, mean = table(gyro=cubic, unit="V").rates((np.array(BOTH) * jitter).tolist(), procedure="scale_factor")
    for metric, rows in tested.metrics(*metrics).items():
        found = by_standard(rows)
        assert {standard: row["reason"] for standard, row in found.items()} == {"GJB2426A": None, "JJF2014": None}
        if metric == "scale_factor":
            line = np.polyfit(rate[1:-1], mean[1:-1], 1)
            assert found["GJB2426A"]["value"] == pytest.approx(line[0], rel=1e-9)


def test_a_rate_measured_twice_with_jitter_is_one_rate(tested: Any, table: Callable[..., Table]) -> None:
    few = [sign * rate * (1 + 1e-4 * turn) for rate in RATES[:6] for sign in (1, -1) for turn in (0, 1)]
    table(gyro=cubic, unit="V").rates(few, procedure="scale_factor")
    reason = by_standard(tested.metric("scale_factor"))["GJB2426A"]["reason"]
    assert reason.startswith("6 rates measured forwards and 6 backwards, 11 in each direction are asked for")


@pytest.mark.in_gate("both")
@pytest.mark.parametrize(
    ("moved_degc", "metrics"),
    [((0.5,), METRICS), ((12.0,), METRICS), ((0.5, 12.0), METRICS[2:])],
    ids=["little", "much", "both"],
)
def test_a_temperature_that_moves_with_the_rates_is_named(
    tested: Any, moved_degc: tuple[float, ...], metrics: tuple[str, ...]
) -> None:
    """From the largest negative rate to the largest positive one: the line takes the change of the zero into K."""
    rates = [0.0, *sorted(BOTH), 0.0]
    for moved in moved_degc:
        rng = np.random.default_rng(1)
        t_ns = START_NS
        for number, rate in enumerate(rates):
            degc = 20 + moved * number / (len(rates) - 1)
            values = rate + 0.01 * (degc - 20) + 1e-3 * rng.standard_normal(100)
            signals = {"rate": (values, "deg/s"), "temperature": (np.full(10, degc), "degC")}
            words = {"procedure": "scale_factor", "rate_command_deg_per_s": rate}
            t_ns = tested.step("r1", f"U{moved}", signals, t0_ns=t_ns, **words)
    for found in tested.metrics(*metrics).values():
        assert {row["unit"] for row in found} == {f"U{moved}" for moved in moved_degc}
        for row in found:
            is_named = row["unit"] == "U12.0"
            assert (row["remark"] or "").startswith("the temperature moved by 1") is is_named, row["remark"]


ALTERNATING = [sign * each for each in RATES for sign in (1, -1)]
ORDERS = {
    "positive first": [*RATES, *(-each for each in RATES)], "signs alternate": ALTERNATING,
    "and back again": ALTERNATING + ALTERNATING[::-1],
}  # fmt: skip


def drift_through(rates: list[float]) -> FloatArray:
    """Of 0.01 deg/s from the rest before to the rest after."""
    drift: FloatArray = 0.01 * np.arange(1, len(rates) + 1) / (len(rates) + 1)
    return drift


def test_a_zero_that_drifts_through_the_rates_is_named_with_what_it_changes(tested: Any) -> None:
    """By lines of numpy; a unit for each order of the rates."""
    for unit, rates in ORDERS.items():
        rng = np.random.default_rng(4)
        t_ns = START_NS
        for rate, moved in zip([0.0, *rates, 0.0], [0.0, *drift_through(rates), 0.01], strict=True):
            values = rate + moved + 1e-4 * rng.standard_normal(100)
            words = {"procedure": "scale_factor", "rate_command_deg_per_s": rate}
            t_ns = tested.step("r1", unit, {"rate": (values, "deg/s")}, t0_ns=t_ns, **words)
    found = tested.metrics("scale_factor", "scale_factor_asymmetry", "scale_factor_nonlinearity")
    for unit in ORDERS:
        check_drift({metric: [row for row in rows if row["unit"] == unit] for metric, rows in found.items()}, unit)


def check_drift(found: dict[str, list[dict[str, Any]]], order: str) -> None:
    """Remark on the drift of the zero in an order of rates, and on how it changes each metric."""
    rates = ORDERS[order]
    drift, x = drift_through(rates), np.array(rates)
    lines = [np.polyfit(x[side], drift[side], 1) for side in (x != 0, x > 0, x < 0)]
    slope, plus, minus = (line[0] for line in lines)
    expected = {
        "scale_factor": 1e6 * slope, "scale_factor_asymmetry": 1e6 * (plus - minus),
        "scale_factor_nonlinearity": 1e6 * np.abs(drift - np.polyval(lines[0], x)).max() / max(RATES),
    }  # fmt: skip
    for metric, ppm in expected.items():
        row = by_standard(found[metric])["GJB2426A"]
        remark = row["remark"] or ""
        if abs(ppm) > 0.6 * row["standard_uncertainty"] * (1e6 if metric == "scale_factor" else 1):
            assert remark.startswith("the output at rest moved by 0.01 deg/s through the rates: "), metric
            assert float(remark.split(" ppm in this order")[0].split()[-1]) == pytest.approx(ppm, rel=0.06)
        else:
            assert "in this order" not in remark, metric
    assert bool(abs(expected["scale_factor_asymmetry"]) < 1.0) is (order == "and back again")


def saturated(rate: float) -> float:
    return float(np.clip(1.00005 * rate + 0.003, -180.0, 180.0))


def test_an_output_that_no_longer_follows_the_rate_is_named(tested: Any, table: Callable[..., Table]) -> None:
    """Saturated at 180 deg/s with noise on top, clipped there, and a cube of 1000 ppm of the span without an edge."""
    table(gyro=saturated, run="saturated").rates(procedure="scale_factor")
    table(gyro=lambda rate: min(rate, 290.0), run="one way").rates(procedure="scale_factor")
    table(gyro=lambda rate: rate * (1 - 5e-3 * (rate / 300) ** 2), run="cubic").rates(procedure="scale_factor")
    few = [sign * rate for rate in RATES[-3:] for sign in (1, -1)]
    table(gyro=lambda rate: rate * (1 - 5e-3 * (rate / 300) ** 2), run="few").rates(few, procedure="scale_factor")
    clipped = table(gyro=saturated, run="clipped")
    for rate in (0.0, *BOTH, 0.0):
        clipped.step(rate, noise=1e-300 if abs(rate) > 180 else None, procedure="scale_factor")
    coarse = table(gyro=lambda rate: round(rate / 4.7) * 4.7, run="coarse")  # steps of a sixty-fourth, without noise
    for rate in (0.0, *BOTH, 0.0):
        coarse.step(rate, noise=1e-300, procedure="scale_factor")
    remarks = {(row["run"], row["standard"]): row["remark"] or "" for row in tested.metric("scale_factor")}
    both_ways = "the output no longer follows the rate at -300, -250, 250, 300 deg/s: it falls up to 40 % short"
    for standard in ("GJB2426A", "JJF2014"):
        assert remarks["saturated", standard].startswith(both_ways)
        assert remarks["one way", standard].startswith("the output no longer follows the rate at 300 deg/s: ")
        assert remarks["cubic", standard] == remarks["few", standard] == ""
        assert "no longer follows" not in remarks["coarse", standard]
        assert remarks["clipped", standard].startswith(both_ways)
        assert (
            "stands still at 4 of 22 rates, the largest ones: it is clipped at an end of"
            in remarks["clipped", standard]
        )
    named = tested.metric("scale_factor_repeatability")
    assert "largest rates of 3 of 5 scale factors the output no longer follows the rate" in named[0]["remark"]


@pytest.mark.long
def test_the_other_metrics_of_a_saturated_output_name_it_too(tested: Any, table: Callable[..., Table]) -> None:
    table(gyro=saturated).rates(procedure="scale_factor")
    for metric in ("scale_factor_nonlinearity", "scale_factor_asymmetry", "fitted_zero"):
        for row in tested.metric(metric):
            assert row["remark"].startswith("the output no longer follows the rate at -300, -250, 250, 300 deg/s")


@pytest.mark.long
def test_from_a_file_to_the_answer(tmp_path: Path, run_command: Callable[..., Any]) -> None:
    """A table that reports its rate to 0.01 %, in a chamber that warms by 8 degC."""
    rng = np.random.default_rng(2)
    rates = [0.0, *sorted(BOTH), 0.0]
    lines, at = ["time[s],rate[deg/s],rate_command[deg/s],temperature[degC],procedure,step"], 0
    for number, rate in enumerate(rates):
        measured = rate * (1 + 1e-4 * rng.uniform(-1, 1))
        for _ in range(30):
            output = 1.0001 * rate + 1e-3 * rng.standard_normal()
            step = "rest" if rate == 0 else "rate"
            lines.append(f"{at},{output:.6f},{measured:.5f},{20 + number * 8 / 23:.2f},scale_factor,{step}{number}")
            at += 1
    (tmp_path / "r1.csv").write_text("\n".join(lines))
    imported = run_command("import", "r1.csv", "--unit", "U1", "--start", "2026-01-05T08:00:00Z", cwd=tmp_path)
    assert imported.code == 0, imported.err
    found = run_command("metrics", "--metric", "scale_factor", "--json", cwd=tmp_path)
    assert found.code == 0, found.err
    (row,) = [each for each in found.json if each["standard"] == "GJB2426A"]
    assert row["reason"] is None
    assert row["value"] == pytest.approx(1.0001, rel=5e-5)
    assert "the temperature moved by" in row["parameters"]["remark"]
