"""Bias and bias stability of static records against NumPy and SciPy on the samples."""

import json
import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from tests.analytics.conftest import START_NS, Recorded
from tests.analytics.metrics.metric_rows import DT_NS, EARTH_DEG_PER_H, HOUR, Rows, exact, one


def drifting(rng: np.random.Generator, n: int = HOUR, mean: float = 5.0) -> np.ndarray:
    return rng.normal(mean, 3.0, n) + np.cumsum(rng.normal(0, 0.02, n))


def test_static_records_are_those_of_the_samples(tested: Any) -> None:
    rng = np.random.default_rng(11)
    volts = drifting(rng) * -2.9222e-3 / 3600 * 1000
    tested.product(
        '[product."FOG-70"]\nscale_factor = -2.9222\nscale_factor_unit = "mV"\naverage_s = 30.0\n'
        '[product."FOG-50"]\nscale_factor = -2.9222\nscale_factor_unit = "mV"\naverage_s = 2.5\n'
    )
    tested.run("r1", procedure="static_bias", latitude_deg=40.0)
    for unit, product in (("U1", "FOG-70"), ("U2", "FOG-50")):
        tested.mount("r1", unit, product=product)
        tested.step("r1", unit, volts, t0_ns=START_NS, dt_ns=DT_NS, unit_of_measure="mV", position="IRA_up")
    rates = volts * 3600 / -2.9222

    found = tested.metrics("bias", "bias_stability", "bias_stability_averaged")
    bias = [row for row in found["bias"] if row["unit"] == "U1"]
    earth = EARTH_DEG_PER_H * math.sin(math.radians(40.0))
    assert one(bias, earth_rate="none")["value"] == exact(rates.mean())
    assert one(bias, earth_rate="removed")["value"] == exact(rates.mean() - earth)
    half = stats.t.isf(0.025, bias[0]["freedom"]) * bias[0]["standard_uncertainty"]
    assert one(bias, earth_rate="none")["hi"] == exact(rates.mean() + half)

    stability = one(found["bias_stability"], unit="U1")
    assert stability["value"] == exact(rates.std(ddof=1))
    assert stability["n"] == HOUR
    assert 0 < stability["lo"] < stability["value"] < stability["hi"]

    averaged = found["bias_stability_averaged"]
    for unit, average_s in (("U1", 1.0), ("U1", 10.0), ("U1", 100.0), ("U1", 30.0), ("U2", 2.5), ("U2", 1.0)):
        means = rates[: HOUR - HOUR % round(average_s * 4)].reshape(-1, round(average_s * 4)).mean(axis=1)
        row = one(averaged, unit=unit, average_s=average_s)
        assert (row["value"], row["n"]) == (exact(means.std(ddof=1)), len(means))
        freedom = row["freedom"]
        assert row["lo"] == exact(row["value"] * math.sqrt(freedom / stats.chi2.isf(0.025, freedom)))
        assert row["hi"] == exact(row["value"] * math.sqrt(freedom / stats.chi2.ppf(0.025, freedom)))
        # of 1 s they are nearly white, over 100 s the walk makes neighbours alike
        assert freedom < len(means) - 1
    assert len(averaged) == 8


@pytest.mark.in_gate("count-LSB")
@pytest.mark.parametrize(("nominal", "output"), [("count", "LSB"), ("LSB", "count"), ("LSB", "LSB")])
def test_a_nominal_scale_factor_in_counts_holds_for_both_names_of_the_unit(
    tested: Any, nominal: str, output: str
) -> None:
    tested.product(f'[product."FOG-70"]\nscale_factor = 262.4\nscale_factor_unit = "{nominal}"\n')
    tested.run("r1", procedure="static_bias")
    tested.mount("r1", "U1", product="FOG-70")
    counts = np.random.default_rng(4).normal(6.5, 3.0, 4000).round()
    tested.step("r1", "U1", counts, t0_ns=START_NS, dt_ns=DT_NS, unit_of_measure=output)
    assert one(tested.metric("bias"), earth_rate="none")["value"] == exact(counts.mean() / 262.4 * 3600)


@pytest.mark.long
def test_a_short_record_is_flagged_an_empty_one_has_a_reason_and_the_others_go_on(recorded: Recorded) -> None:
    rows: Rows = [
        {"mean": 1.0, "sd": 2.0, "sd_freedom": 900.0, "procedure": "static_bias"},
        {"mean": 1.0, "sd": 2.0, "sd_freedom": 900.0, "duration_s": 600.0, "unit": "U2"},
        {"n": 0, "unit": "U3"},
        {"mean": 1.0, "unit": "U4", "unit_of_measure": "mV"},
        {"mean": 1.0, "unit": "U5", "rate_command": 0.0, "procedure": "own"},
        {"mean": 9.0, "unit": "U5", "rate_command": 9.0, "procedure": "own"},
        {"mean": 1.0, "unit": "U6", "phase": "before"},
        {"mean": 9.0, "unit": "U7", "input_rate": 10.0, "input_rate_source": "table"},
    ]
    found = recorded(rows, "bias_stability")
    assert (one(found, unit="U1")["value"], one(found, unit="U1")["remark"]) == (2.0, None)
    # by the note of JJF 2014-2022 7.2.13.1 the user chooses the time
    assert one(found, unit="U2")["value"] == 2.0
    assert one(found, unit="U2")["remark"] == "record of 600 s: the clauses ask for one hour as a rule"
    assert one(found, unit="U3")["reason"] == "no sample in the evaluated part of the step"
    assert "no scale factor for an output in mV" in one(found, unit="U4")["reason"]
    assert {row["unit"] for row in found} == {"U1", "U2", "U3", "U4"}
    averaged = recorded(rows[:1], "bias_stability_averaged")
    assert [row["reason"] for row in averaged] == [
        f"0 averages of {s} s in the record, at least 2 are needed" for s in (1, 10, 100)
    ]
    for row in found + averaged:
        assert (row["value"] is None) == (row["reason"] is not None)


@pytest.mark.long
def test_a_bias_is_of_the_standard_whose_attitude_it_has(recorded: Recorded) -> None:
    rows = [{"mean": 1.0, "unit": position, "position": position} for position in ("IRA_east", "IRA_up", "Z_down", "x")]
    found = {row["unit"]: row["standard"] for row in recorded(rows, "bias")}
    assert found == {"IRA_east": "GJB2426A", "IRA_up": "JJF2014", "Z_down": "JJF2014", "x": "GJB2426A, JJF2014"}


def test_a_long_record_that_begins_within_a_second_says_what_is_counted(recorded: Recorded) -> None:
    rows = [
        {
            "unit": unit,
            "position": "IRA_up",
            "n": 10 * whole,
            "expected": 10 * whole,
            "whole_seconds": whole,
            "duration_s": s,
        }
        for unit, whole, s in (("within", 7199, 7199.9), ("from", 7200, 7199.9))
    ]
    for metric in ("bias", "bias_stability", "angle_random_walk"):
        found = {
            row["unit"]: json.loads(row["parameters"])
            for row in recorded([r | {"sd": 1.0, "mean": 1.0} for r in rows], metric)
        }
        assert {unit: each.get("whole_seconds") for unit, each in found.items()} == {"within": 7199, "from": None}
