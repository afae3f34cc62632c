"""Laws that every metric keeps; a new one in the package is found by itself and compared with them.

Units are simulated in the tests of the standards: one that went through everything, one whose tests were cut short,
and one whose output is in mV and for which no scale factor is known.
"""

import json
import math
import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pytest

from analytics.evaluation.evaluation import COLUMNS
from analytics.metric_registry.registry import metrics
from analytics.specifications.entering import add_specification
from storage.store import Store
from stream.quantities import check_unit
from tests.bench.metric_steps import DAY_NS, Unit, metrics_of, records_of

NAMES = tuple(metrics())
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
PRODUCT = (
    '[product."FOG-70"]\nmax_rate_deg_per_s = 100.0\nnonlinearity_ppm = 500.0\nexpected_threshold_deg_per_h = 3.0\n'
)
Records = list[dict[str, Any]]
Rows = list[dict[str, Any]]


class Simulated(NamedTuple):
    """A store that holds a specification only, records of steps, and the metrics of them."""

    store: Store
    records: Records
    table: pa.Table

    def rows(self, metric: str, unit: str | None = None) -> Rows:
        found: Rows = self.table.to_pylist()
        return [row for row in found if row["metric"] == metric and unit in {None, row["unit"]}]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Simulated:
    store = Store.create(Path(tmp_path_factory.mktemp("laws")) / "store")
    path = store.folder.with_name("specification.toml")
    path.write_text(f'revision = "A"\n{PRODUCT}')
    add_specification(store, path)
    records = [each | {"product": "FOG-70"} for each in campaign()]
    return Simulated(store, records, metrics_of(store, records))


@cache
def campaign() -> tuple[dict[str, Any], ...]:
    rng = np.random.default_rng(20)
    whole = records_of([Unit("U1")], rng)
    short = records_of([Unit("U2")], rng, cut=1)
    scaleless = [each | {"unit_of_measure": "mV"} for each in records_of([Unit("U3")], rng, cut=7)]
    return (*whole, *short, *scaleless)


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
    reasons = {row["metric"] for row in simulated.table.to_pylist() if row["unit"] == unit and row["reason"]}
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
    reported = [tuple(str(row[name]) for name in keys) for row in simulated.table.to_pylist()]
    assert len(reported) == len(set(reported))


def comparable(table: pa.Table) -> list[tuple[str, ...]]:
    return sorted(tuple(repr(value) for value in row.values()) for row in table.to_pylist())


def test_the_order_of_the_records_does_not_matter(simulated: Simulated) -> None:
    order = np.random.default_rng(1).permutation(len(simulated.records))
    table = metrics_of(simulated.store, [simulated.records[i] for i in order])
    assert comparable(table) == comparable(simulated.table)


def test_a_unit_has_the_same_values_without_the_others(simulated: Simulated) -> None:
    alone = metrics_of(simulated.store, [each for each in simulated.records if each["unit"] == "U1"])
    of_unit = simulated.table.filter(pa.compute.equal(simulated.table["unit"], "U1"))
    assert comparable(alone) == comparable(of_unit)


def test_names_of_units_do_not_matter(simulated: Simulated) -> None:
    names = {"U1": "Ünit'; drop table x; --", "U2": "光纤 2", "U3": 'A"3'}
    renamed = metrics_of(simulated.store, [each | {"unit": names[each["unit"]]} for each in simulated.records])
    back = {new: old for old, new in names.items()}
    rows = [row | {"unit": back[row["unit"]]} for row in renamed.to_pylist()]
    assert comparable(pa.Table.from_pylist(rows, schema=COLUMNS)) == comparable(simulated.table)


def scaled(records: Records, factor: float) -> Records:
    """Records of an output that is so many times as large; powers of 2 are exact."""
    linear = ("mean", "sd", "standard_uncertainty", "sd_1s", "sd_10s", "sd_100s")
    square = ("white", "flicker", "walk")

    def times(each: dict[str, Any], names: tuple[str, ...], by: float) -> dict[str, Any]:
        return {name: None if each[name] is None else each[name] * by for name in names}

    return [each | times(each, linear, factor) | times(each, square, factor**2) for each in records]


def paired(simulated: Simulated, factor: float, records: Records) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Rows of a unit, and of an output that is so many times as large."""

    def rows(records: Records) -> Rows:
        found: Rows = metrics_of(simulated.store, records).to_pylist()
        found = [row for row in found if row["value"] is not None and row["metric"] not in ON_A_GRID]
        return sorted(found, key=lambda row: [str(row[name]) for name in ("metric", "run", "standard", "steps")])

    yield from zip(rows(records), rows(scaled(records, factor)), strict=True)


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


def is_scale_factor(record: dict[str, Any]) -> bool:
    return "scale_factor" in record["procedure"]


def of_whole_unit(simulated: Simulated) -> Records:
    """The unit that went through everything; the Earth's rate, which is not scaled, is not known."""
    return [each | {"latitude_deg": None} for each in simulated.records if each["unit"] == "U1"]


def test_an_output_twice_as_large_doubles_what_is_an_output_and_leaves_what_is_relative(simulated: Simulated) -> None:
    def factor_of(row: dict[str, Any]) -> float:
        is_output = row["unit_of_measure"].startswith(("deg/h", "deg/sqrt(h)"))
        return 2.0 if is_output or row["metric"] in DOUBLED else 1.0

    without = [each for each in of_whole_unit(simulated) if not is_scale_factor(each)]
    assert len(metrics_scaled(paired(simulated, 2.0, without), factor_of)) > 10


def test_a_scale_factor_that_was_measured_before_leaves_only_itself_to_be_scaled(simulated: Simulated) -> None:
    times = ("t_start_ns", "t_from_ns", "t_to_ns")
    later = [
        each if is_scale_factor(each) else each | {name: each[name] + 100 * DAY_NS for name in times}
        for each in of_whole_unit(simulated)
    ]
    found = metrics_scaled(paired(simulated, 1.25, later), lambda row: 1.25 if row["metric"] in SCALE_FACTORS else 1.0)
    assert len(found) > 15


def test_a_reversed_output_reverses_what_has_a_sign_and_nothing_else(simulated: Simulated) -> None:
    signed = {"bias", "polarity"}
    whole = [each for each in of_whole_unit(simulated) if each["procedure"] in {"static_bias", "polarity"}]

    def rows(records: Records) -> Rows:
        found: Rows = metrics_of(simulated.store, records).to_pylist()
        return sorted(
            found, key=lambda row: [str(row[name]) for name in ("metric", "run", "standard", "parameters", "steps")]
        )

    # what a parameter says of the rates differs by its sign: polarity has one row
    plain, reverse = rows(whole), rows([each | {"mean": -each["mean"]} for each in whole])
    assert len(plain) == len(reverse) > 50
    for before, after in zip(plain, reverse, strict=True):
        factor = -1.0 if before["metric"] in signed else 1.0
        if before["value"] is not None:
            assert after["value"] == pytest.approx(before["value"] * factor, rel=1e-9), before
