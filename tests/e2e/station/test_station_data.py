"""What a procedure at a simulated station leaves in the store is what was planted in its units."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Bench = Any
Kept = Any
Gyrofleet = Callable[..., Any]

EARTH_DEG_PER_H = 15.041067


@pytest.mark.long
def test_a_scale_factor_is_measured_as_it_was_planted(
    gyrofleet: Gyrofleet, kept: Kept, bench: Bench, tmp_path: Path
) -> None:
    record_s, rate_hz = 10.0, 10.0
    done = gyrofleet(*bench.run("scale_factor"))
    assert done.code == 0, done.err
    last = json.loads(done.out.splitlines()[-1])
    assert (last["event"], last["outcome"], last["steps_done"], last["short_records"]) == ("ended", "completed", 25, 0)
    kept.sound()
    kept.completed()
    found = kept.rows(
        "select p.unit, p.rate_command, p.t_start_ns, s.epoch, list(s.value order by s.t_ns) as v, "
        "list(s.t_ns order by s.t_ns) as t from steps p join samples s on s.unit = p.unit and s.signal = 'rate' "
        "and s.t_ns >= p.t_start_ns + (p.settle * 1e9)::bigint and s.t_ns <= p.t_end_ns group by all order by all"
    )
    assert len(found) == 48  # of each step one epoch, of each epoch one step
    assert len({row["epoch"] for row in found}) == 48
    truths = [json.loads(line) for line in (bench.folder / "truth.jsonl").read_text().splitlines()]
    for unit in ("SIM-0001", "SIM-0002"):
        planted = next(each["parameters"] for each in truths if each["unit"] == unit)
        mine = [row for row in found if row["unit"] == unit]
        white = planted["noise"]["angle_random_walk_deg_per_sqrt_h"] / 60.0  # deg/sqrt(s)
        for row in mine:
            times = np.array(row["t"], np.int64)
            assert len(times) == record_s * rate_hz
            assert (np.diff(times) == round(1e9 / rate_hz)).all()
            # white noise, the table's ripple of 2e-4 deg/s, counts of 5e-5 deg/s; a ramp of 100 deg/s2 would show
            expected = math.sqrt(white**2 * rate_hz + 2e-4**2 / 2 + 5e-5**2 / 12)
            assert np.std(row["v"], ddof=1) == pytest.approx(expected, rel=5 / math.sqrt(2 * (len(times) - 1)))
        rate = np.array([row["rate_command"] for row in mine])
        mean = np.array([np.mean(row["v"]) for row in mine])
        earth = EARTH_DEG_PER_H / 3600.0 * math.sin(math.radians(bench.simulation["latitude_deg"]))
        x = rate + earth
        full = planted["scale"]["full_range_deg_per_s"]
        design = np.column_stack([np.ones_like(x), x, x**2 / full, x**3 / full**2, np.abs(x) / 2]) * [1, *[1e-6] * 4]
        fitted = np.linalg.lstsq(design, mean - x, rcond=None)[0]
        flicker = planted["noise"]["bias_instability_deg_per_h"] / 3600.0
        turn_on = planted["bias"]["turn_on_deg_per_h"] / 3600.0
        variance = white**2 / record_s + flicker**2 + turn_on**2
        bound = 5 * np.sqrt(variance * np.diag(np.linalg.inv(design.T @ design)))
        scale = planted["scale"]
        warm_up_deg_per_h = 0.3 * math.exp(-15.0 / 300.0)  # in the middle of a record, 10 s to 40 s after power-on
        bias = (planted["bias"]["constant_deg_per_h"] + warm_up_deg_per_h) / 3600.0
        bound[0] += 0.3 * (25.0 / 300.0) / 3600.0
        expected_terms = [bias, scale["error_ppm"], *scale["nonlinearity_ppm"], scale["asymmetry_ppm"]]
        assert (np.abs(fitted - expected_terms) < bound).all(), (fitted, expected_terms, bound)
        assert bound[1] < 10.0, "the bound is to tell a scale factor error of 500 ppm from none"
    kinds = "select unit, document->>'$.epoch' as epoch from events where kind = 'PowerOn'"
    powered = kept.rows(kinds)
    assert len({(row["unit"], row["epoch"]) for row in powered}) == len(powered) == 50
    assert {row["epoch"] for row in found} < {row["epoch"] for row in powered}
    turned = kept.rows(
        "select p.rate_command as r, max(abs(s.value - p.rate_command)) as off, count(*) as n from steps p "
        "join samples s on s.unit = 'table' and s.signal = 'table_rate' and s.t_ns between p.t_start_ns and p.t_end_ns "
        "where p.unit = 'SIM-0001' group by all"
    )
    assert len(turned) == 23  # at rest before and after
    assert all(row["off"] <= 2.1e-4 and row["n"] >= 1 for row in turned), turned  # ripple, and rounding to 1e-6
