"""The campaigns that prove the closed loop in a short form: some of each row of `tests/bench/residual_tracing.py`."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.loop.effects.registry import effects
from tests.bench.loop_campaign import MISSPECIFIED
from tests.bench.residual_tracing import run
from tests.bench.tracing_cases import DESIGN_Z, MODEL, ROWS, SIZES, Case, cases, plantable, standard
from tests.bench.tracing_outcomes import RIGHT, traced
from tests.bench.tracing_peers import PEERS, lasso, ordinary, peers
from tests.bench.tracing_tables import at_least, at_most, tables


@pytest.mark.in_gate("bursts")
@pytest.mark.parametrize("misspecified", ["random_walk_3x", "heavy_tails", "bursts"])
def test_nothing_is_invented(misspecified: str) -> None:
    line = traced(Case("null", misspecified, 0.0, 1000))
    assert line["found"] == []


@pytest.mark.long
@pytest.mark.parametrize(
    "name", ["gravity_product_is", "thermal_lag", "scale_factor_warm_up", "table_angle_harmonic_2", "stale_input_rate"]
)
def test_a_planted_effect_is_named(name: str) -> None:
    line = traced(Case("planted", name, 12.0, 2001))
    assert line["outcome"] in RIGHT, line
    assert line["error"]["fraction"] is None or line["error"]["fraction"] > 0.8


def test_a_threshold_is_found_though_nothing_else_is_left() -> None:
    """Two levels of the bias: no smooth function of the temperature stands out, so that no second tier would open."""
    line = traced(Case("planted", "temperature_threshold", 7.0, 2060))
    assert line["outcome"] in RIGHT, line


@pytest.mark.long
def test_two_effects_are_told_apart() -> None:
    line = traced(Case("two", "vibration_squared + scale_factor_cubic", 14.0, 3000))
    assert line["outcome"] in RIGHT, line


@pytest.mark.long
def test_a_ramp_does_not_tell_and_a_single_test_does_not_repeat() -> None:
    ramp = traced(Case("ramp", "warm_up", 14.0, 4000))
    assert ramp["outcome"] != "wrong", ramp
    once = traced(Case("once", "magnetic_o", 14.0, 4000))
    assert once["verdict"] == "unreplicated"
    assert once["outcome"] == "unreplicated"


@pytest.mark.long
def test_what_was_seen_in_one_run_does_not_explain_noise_in_all_but_in_that_run() -> None:
    """Noise of 1/f**3 has fifty times the declared variance in each run, whatever one of them seems to show."""
    line = traced(Case("excess", "steep_flicker", 0.0, 1630))
    assert (line["verdict"], line["seen_once"]) == ("unexplained", ["function_of_time_since_power_on", "warm_up"])
    line = traced(Case("once", "magnetic_o", DESIGN_Z, 4300))
    assert (line["verdict"], line["seen_once"]) == ("unreplicated", ["magnetic_o"])


@pytest.mark.long
def test_what_has_no_name_is_a_function() -> None:
    line = traced(Case("outside", "resonance of vibration", 16.0, 4000))
    assert line["verdict"] == "unknown_function"
    assert line["found"][0]["unknown_function_of"] == ["vibration"]


@pytest.mark.long
def test_a_promoted_effect_that_goes_away_is_rolled_back() -> None:
    line = traced(Case("removed", "gravity_o", 16.0, 4001))
    assert line["watch"]["kept"] is None
    assert line["watch"]["removed"] is not None


@pytest.mark.long
def test_ordinary_ways_do_worse_on_the_same_data() -> None:
    """Thermal walk and turn-on scatter, no effect: all of them name one; of a strong effect they find more than it."""
    chosen = peers(standard(1000).runs(misspecified="random_walk_3x"), MODEL, np.random.default_rng(0))
    assert set(chosen) == set(PEERS)
    assert sum(bool(names) for names in chosen.values()) >= 4
    made = ordinary(standard(1000).runs(), MODEL)
    column = made.names.index("gravity_product_os")
    strong = type(made)(1e3 * made.columns[:, column], made.columns, made.names, made.run)
    assert lasso(strong, np.random.default_rng(0))[0] == "gravity_product_os"


def test_every_effect_is_planted_and_every_row_has_cases() -> None:
    left_out = {name for name in effects() if "*" not in name} - set(plantable())
    assert left_out == {"scale_factor", "temperature", "function_of_position"}
    assert len(plantable()) >= 32
    assert len(cases("null", 40)) == 40 * len(MISSPECIFIED) == 360
    assert len(cases("planted", 10)) == 10 * len(SIZES) * len(plantable())
    for row in ROWS:
        every = cases(row, 2)
        assert len({case.key for case in every}) == len(every)


def test_a_rate_fails_only_beyond_its_bound() -> None:
    assert at_most(0, 360, 0.01)
    assert at_most(9, 360, 0.01)
    assert not at_most(20, 360, 0.01)
    assert at_least(530, 560, 0.97)
    assert not at_least(480, 560, 0.97)


def a_line(case: Case, outcome: str, **more: Any) -> dict[str, Any]:
    return {
        "key": case.key, "row": case.row, "name": case.name, "z": case.z, "seed": case.seed, "outcome": outcome,
        "verdict": "effect_found", "found": [], "refused": [], "seen_once": [], "error": None, "seconds": 1.0, **more,
    }  # fmt: skip


def test_results_are_resumed_and_judged(tmp_path: Path) -> None:
    """Lines that are there are not traced again; a wrong name among few is reported, and fails among many."""
    wanted = cases("planted", 2, (10.0,))
    results = tmp_path / "results.jsonl"
    lines = [a_line(case, "exact") for case in wanted]
    results.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert run(wanted, results) == lines
    text, kept = tables(lines)
    assert kept
    assert any("100.00%" in row for row in text)
    found = [{"name": "ageing", "confounded": [], "replicates": True}]
    bad = [a_line(case, "wrong", found=found) for case in wanted[:20]] + lines[20:]
    text, kept = tables(bad)
    assert not kept
    assert any("wrong" in row and "effect_found: ageing" in row for row in text)
