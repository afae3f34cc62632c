"""Laws that every metric keeps; a new one in the package is found by itself and compared with them.

The units are those of `simulated_units`.
"""

import json
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from analytics.evaluation import evaluation
from analytics.evaluation.evaluation import COLUMNS
from analytics.evaluation.type_b import NO_SENSITIVITY
from analytics.metric_registry.registry import metrics
from storage.store import Store
from stream.quantities import check_unit
from tests.bench.metric_steps import metrics_of
from tests.laws.simulated_units import OWN, STATED, Rows, Simulated, simulated_units

NAMES = tuple(metrics())
INFLUENCED = tuple(name for name, metric in metrics().items() if metric.header.influences)
EVERY = pytest.mark.parametrize("name", NAMES)
STANDARDS = {"GJB2426A", "JJF2014", "JJF1536", "HIT", "CN102680005"}
# Named in the standards' own words; what is not among them is one of IEEE 952 or of the separation methods.
TERMS = {
    "bias", "bias_stability", "bias_stability_averaged", "bias_repeatability", "bias_temperature_sensitivity",
    "bias_acceleration_sensitivity", "bias_shock_change", "bias_vibration_change", "angle_random_walk", "scale_factor",
    "fitted_zero", "scale_factor_nonlinearity", "scale_factor_asymmetry", "scale_factor_repeatability",
    "scale_factor_temperature_sensitivity", "scale_factor_acceleration_sensitivity", "scale_factor_shock_change",
    "scale_factor_vibration_change", "range", "threshold", "resolution", "polarity", "startup_time", "warmup_time",
    "power", "misalignment", "misalignment_repeatability", "gyro_separation", "accelerometer_separation", "bandwidth",
    "output_delay", "visual_check", "electrical_check", "quantization_noise", "bias_instability", "rate_random_walk",
    "rate_ramp", "attitude_unit_bias", "attitude_unit_misalignment",
}  # fmt: skip
# They read samples, estimates or entered checks besides the records, which the simulated units do not have.
ELSEWHERE = {
    "accelerometer_separation", "bandwidth", "output_delay", "startup_time", "warmup_time", "power", "visual_check",
    "electrical_check", "quantization_noise", "bias_instability", "rate_random_walk", "rate_ramp", "allan_deviation",
    "system_level_scale_factor_asymmetry", "system_level_scale_factor_error", "system_level_accelerometer_bias",
    "system_level_gyro_bias",
}  # fmt: skip
# what a doubled output doubles: all that is in deg/h, and these
DOUBLED = {"gyro_separation", "misalignment", "misalignment_repeatability", "attitude_unit_misalignment"}
# what a measured scale factor is itself
SCALE_FACTORS = {
    "scale_factor", "scale_factor_acceleration_sensitivity", "scale_factor_shock_change",
    "scale_factor_vibration_change",
}  # fmt: skip
# Their points are tested inputs, their differences those of the input and the output.
ON_A_GRID = {"threshold", "resolution"}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Simulated:
    return simulated_units(Path(tmp_path_factory.mktemp("laws")))


def read(row: dict[str, Any]) -> dict[str, Any]:
    parameters: dict[str, Any] = json.loads(row["parameters"] or "{}")
    return parameters


@EVERY
def test_a_metric_says_what_it_is(name: str) -> None:
    header = metrics()[name].header
    assert re.fullmatch(r"[a-z][a-z_]*", name)
    assert re.search(r"[A-Za-z]{3}", header.en)
    assert not re.search(r"[\u4e00-\u9fff]", header.en)
    assert re.search(r"[\u4e00-\u9fff]{2}", header.zh)
    assert check_unit(header.unit.replace("sqrt(h)", "h**0.5").replace("ppm", "1"))
    assert header.sources
    others = {each.standard for each in header.sources} - STANDARDS - {"HIT2012"}
    assert all(re.fullmatch("[A-Z]+", each) for each in others), "neither a known standard nor a document of a house"
    assert all(re.search(r"\d", each.clause) for each in header.sources)
    assert all((header.grain, header.needs, header.equation))
    assert "unit" in header.grain


@EVERY
def test_a_metric_says_how_errors_of_the_standards_enter(name: str) -> None:
    header = metrics()[name].header
    assert bool(header.influences) != bool(header.no_influence)
    quantities = [each.quantity for each in header.influences]
    assert len(set(quantities)) == len(quantities)


@EVERY
def test_no_uncertainty_is_a_silent_zero(simulated: Simulated, name: str) -> None:
    """The simulated stations state no uncertainty: no row has U, and each says why.

    A value of exactly 0 may have one: an error in proportion to it is none.
    """
    for row in simulated.rows(name):
        if row["value"] == 0:
            continue
        assert (row["U"], row["k"]) == (None, None)
        assert (row["value"] is not None) == (row["uncertainty_reason"] is not None), row


def test_the_standards_characteristics_are_all_there() -> None:
    assert set(NAMES) >= TERMS


def test_an_empty_store_has_no_metrics(tmp_path: Path) -> None:
    table = metrics_of(Store.create(tmp_path / "store"), [])
    assert (table.num_rows, table.schema) == (0, COLUMNS)


@EVERY
def test_a_unit_that_went_through_everything_has_values(simulated: Simulated, name: str) -> None:
    values = [row for row in simulated.rows(name, "U1") if row["value"] is not None]
    assert values or name in ELSEWHERE


@EVERY
def test_parameters_of_values_are_those_that_the_header_names(simulated: Simulated, name: str) -> None:
    found = {key for row in simulated.rows(name) for key in read(row)}
    assert found <= set(metrics()[name].header.parameters)
    assert len(set(metrics()[name].header.parameters)) == len(metrics()[name].header.parameters) > 0


@EVERY
def test_a_value_is_missing_just_where_a_reason_says_why(simulated: Simulated, name: str) -> None:
    for row in simulated.rows(name):
        assert (row["value"] is None) == (row["reason"] is not None), row
        if row["value"] is None:
            assert len(row["reason"]) > 10
            assert (row["lo"], row["hi"]) == (None, None), row


@pytest.mark.parametrize("unit", ["U2", "U3"])
def test_what_was_cut_short_or_has_no_scale_says_so_and_the_others_go_on(simulated: Simulated, unit: str) -> None:
    reasons = {row["metric"] for row in simulated.listed if row["unit"] == unit and row["reason"]}
    asked = {"scale_factor", "misalignment", "bias_acceleration_sensitivity", "bias_shock_change", "range"}
    assert asked <= reasons | ({"scale_factor"} if unit == "U3" else set())
    assert all(row["reason"] is None for row in simulated.rows("bias", "U1"))


@EVERY
def test_limits_enclose_the_value_and_numbers_are_finite(simulated: Simulated, name: str) -> None:
    for row in simulated.rows(name):
        numbers = [
            row[each] for each in ("value", "lo", "hi", "standard_uncertainty", "freedom") if row[each] is not None
        ]
        assert all(math.isfinite(each) for each in numbers), row
        if row["value"] is not None:
            assert row["lo"] is None or row["lo"] <= row["value"], row
            assert row["hi"] is None or row["value"] <= row["hi"], row
            assert row["standard_uncertainty"] is None or row["standard_uncertainty"] >= 0, row


@EVERY
def test_a_row_says_what_it_rests_on(simulated: Simulated, name: str) -> None:
    steps: dict[tuple[str, str], set[int]] = {}
    for each in simulated.records:
        steps.setdefault((each["unit"], each["run"]), set()).add(each["index"])
    for row in simulated.rows(name):
        assert isinstance(read(row), dict)
        assert row["runs"], row
        assert row["value"] is None or (row["steps"] and row["n"] > 0), row
        assert row["run"] is None or row["runs"] == [row["run"]]
        own = [steps[row["unit"], run] for run in row["runs"]]
        assert set(row["steps"]) <= set().union(*own), row
        assert all(row[each] for each in ("unit_of_measure", "standard", "clause")), row


def test_rows_are_distinguished_by_what_they_say(simulated: Simulated) -> None:
    keys = ["metric", "unit", "signal", "run", "parameters", "standard", "clause", "steps"]
    reported = [tuple(str(row[name]) for name in keys) for row in simulated.listed]
    assert len(reported) == len(set(reported))


def comparable(table: pa.Table) -> list[tuple[str, ...]]:
    return sorted(tuple(repr(value) for value in row.values()) for row in table.to_pylist())


@pytest.mark.in_gate("all of it")
@pytest.mark.parametrize(
    ("is_shuffled", "is_renamed", "left"),
    [(True, False, OWN), (False, True, OWN), (False, False, ("U1",)), (True, True, ("U1", "U3"))],
    ids=["order", "names", "alone", "all of it"],
)
def test_neither_the_order_of_records_nor_names_nor_other_units_matter(
    simulated: Simulated, is_shuffled: bool, is_renamed: bool, left: tuple[str, ...]
) -> None:
    names = {"U1": "Ünit'; drop table x; --", "U2": "光纤 2", "U3": 'A"3'} if is_renamed else {}
    records = [each | {"unit": names.get(each["unit"], each["unit"])} for each in simulated.records]
    records = [each for each, own in zip(records, simulated.records, strict=True) if own["unit"] in left]
    if is_shuffled:
        records = [records[i] for i in np.random.default_rng(1).permutation(len(records))]
    back = {new: old for old, new in names.items()}
    rows = [
        row | {"unit": back.get(row["unit"], row["unit"])} for row in metrics_of(simulated.store, records).to_pylist()
    ]
    expected = simulated.table.filter(pa.compute.is_in(simulated.table["unit"], pa.array(left)))
    assert comparable(pa.Table.from_pylist(rows, schema=COLUMNS)) == comparable(expected)


@pytest.mark.long
def test_what_a_header_asks_for_leaves_no_row_out(simulated: Simulated, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of each procedure alone: with every statement run, the rows are the same."""
    procedures = sorted({str(each["procedure"]) for each in simulated.records})
    for procedure in procedures:
        records = [each for each in simulated.records if str(each["procedure"]) == procedure]
        found = metrics_of(simulated.store, records)
        with monkeypatch.context() as patched:
            patched.setattr(evaluation, "_with_rows", lambda _catalog, chosen, _pool: (chosen, []))
            assert comparable(metrics_of(simulated.store, records)) == comparable(found), procedure


def paired(simulated: Simulated, name: str) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Rows of a unit, and of a changed output of it."""

    def rows(unit: str) -> Rows:
        found = simulated.rows_of_other(unit)
        found = [row for row in found if row["value"] is not None and row["metric"] not in ON_A_GRID]
        return sorted(found, key=lambda row: [str(row[name]) for name in ("metric", "run", "standard", "steps")])

    yield from zip(rows(f"{name}, plain"), rows(f"{name}, changed"), strict=True)


def metrics_scaled(
    pairs: Iterator[tuple[dict[str, Any], dict[str, Any]]], factor_of: Callable[[dict[str, Any]], float]
) -> set[str]:
    """Metrics whose values and limits are so many times as large in the second row of each pair."""
    seen = set()
    for before, after in pairs:
        for each in ("value", "lo", "hi", "standard_uncertainty"):
            if before[each] is not None:
                expected = before[each] * factor_of(before)
                assert after[each] == pytest.approx(expected, rel=1e-6, abs=1e-6), (before, after)
        seen.add(before["metric"])
    return seen


def test_an_output_twice_as_large_doubles_what_is_an_output_and_leaves_what_is_relative(simulated: Simulated) -> None:
    def factor_of(row: dict[str, Any]) -> float:
        is_output = row["unit_of_measure"].startswith(("deg/h", "deg/sqrt(h)"))
        return 2.0 if is_output or row["metric"] in DOUBLED else 1.0

    assert len(metrics_scaled(paired(simulated, "doubled"), factor_of)) > 10


def test_a_scale_factor_that_was_measured_before_leaves_only_itself_to_be_scaled(simulated: Simulated) -> None:
    pairs = paired(simulated, "calibrated")
    found = metrics_scaled(pairs, lambda row: 1.25 if row["metric"] in SCALE_FACTORS else 1.0)
    assert len(found) > 15


def test_a_reversed_output_reverses_what_has_a_sign_and_nothing_else(simulated: Simulated) -> None:
    signed = {"bias", "polarity"}

    def rows(unit: str) -> Rows:
        found = simulated.rows_of_other(unit)
        return sorted(
            found, key=lambda row: [str(row[name]) for name in ("metric", "run", "standard", "parameters", "steps")]
        )

    # what a parameter says of the rates differs by its sign: polarity has one row
    plain, reverse = rows("reversed, plain"), rows("reversed, changed")
    assert len(plain) == len(reverse) > 50
    for before, after in zip(plain, reverse, strict=True):
        factor = -1.0 if before["metric"] in signed else 1.0
        if before["value"] is not None:
            assert after["value"] == pytest.approx(before["value"] * factor, rel=1e-9), before


@pytest.mark.parametrize("name", INFLUENCED)
def test_a_value_has_u_where_every_standard_is_stated(simulated: Simulated, name: str) -> None:
    """Where the station states every quantity, each value has U, or says what is lacking."""
    for row in simulated.rows_of_other(STATED):
        if row["metric"] != name or row["value"] is None:
            continue
        assert NO_SENSITIVITY not in (row["uncertainty_reason"] or ""), row
        assert (row["U"] is None) == (row["uncertainty_reason"] is not None), row
        if row["U"] is not None:
            combined = math.hypot(row["u_type_a"], row["u_type_b"])
            assert math.isclose(row["U"], row["k"] * combined, rel_tol=1e-12)
            assert row["k"] >= 2.0 - 1e-9
