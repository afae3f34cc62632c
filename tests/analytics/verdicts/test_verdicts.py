"""Verdicts: each value against the limit that was valid at its time, the units' worst, yield, what units fail by."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from scipy import stats

from analytics.evaluation.evaluation import COLUMNS, define_views
from analytics.evaluation.layer import VerdictsLayer, define_metric_tables
from analytics.metric_registry.registry import metrics
from analytics.specifications.entering import add_specification
from analytics.specifications.verdicts import rows_of, verdicts_of, yield_by
from analytics.step_records.step_table import step_means
from ingest.importing.entered import Entry, check_entered, enter
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import NotFound
from stream.events import Verdict

HOUR_NS = 3600 * 10**9
DAY_NS = 24 * HOUR_NS
JANUARY_NS = 1_767_225_600 * 10**9  # 2026-01-01 00:00 UTC

Rows = Sequence[Mapping[str, Any]]


class Judged:
    """A store with specifications, whose runs and values are what a test says."""

    def __init__(self, folder: Path) -> None:
        self.store = Store.create(folder / "store")
        self._folder = folder
        self._catalogs: list[Catalog] = []

    def specify(self, text: str, name: str = "fog.toml") -> None:
        path = self._folder / name
        path.write_text(text)
        add_specification(self.store, path)

    def catalog(self, runs: Rows, values: Rows) -> Catalog:
        catalog = Catalog(self.store)
        self._catalogs.append(catalog)
        catalog._unfilled.clear()  # what it would compute is what the test says
        plain = {
            "product": "X",
            "station": "S1",
            "date_known": True,
            "time_zone": "UTC",
            "t_start_ns": JANUARY_NS,
            "unit_of_measure": "deg/h",
        }
        rows = [plain | {"t_to_ns": row.get("t_start_ns", JANUARY_NS) + HOUR_NS} | dict(row) for row in runs]
        steps = pa.Table.from_pylist(rows, schema=step_means(catalog).schema)
        define_views(catalog, steps)
        catalog.put("unit_metrics", pa.Table.from_pylist([_value(row) for row in values], schema=COLUMNS))
        define_metric_tables(catalog)
        VerdictsLayer().fill(catalog)
        return catalog

    def close(self) -> None:
        for catalog in self._catalogs:
            catalog.close()


def _value(row: Mapping[str, Any]) -> dict[str, Any]:
    plain = {
        "metric": "bias", "unit": "U1", "signal": "rate", "run": "r1", "unit_of_measure": "deg/h", "n": 10,
        "standard": "GJB2426A, JJF2014", "clause": "5.12.1", "steps": [1],
    }  # fmt: skip
    reported: dict[str, Any] = plain | dict(row)
    reported.setdefault("runs", [reported["run"]])
    reported["parameters"] = json.dumps(reported.get("parameters", {}))
    return reported


@pytest.fixture
def judged(tmp_path: Path) -> Iterator[Judged]:
    made = Judged(tmp_path)
    yield made
    made.close()


def limits(*entries: str, revision: str = "A", head: str = "") -> str:
    body = "".join(f"[[limit]]\n{entry}\n" for entry in entries)
    return f'revision = "{revision}"\n{head}\n{body}'


BIAS = 'metric = "bias"\nlower = -1.0\nupper = 1.0\nunit_of_measure = "deg/h"'


def test_a_value_is_judged_by_its_interval(judged: Judged) -> None:
    cases = [
        (0.0, -0.5, 0.5, "PASS"),
        (0.9, 0.8, 1.0, "PASS"),  # at the limit is within it
        (0.9, 0.7, 1.1, "MARGINAL"),
        (1.1, 0.9, 1.3, "MARGINAL"),
        (-1.1, -1.3, -0.9, "MARGINAL"),
        (0.0, -2.0, 2.0, "MARGINAL"),
        (1.5, 1.4, 1.6, "FAIL"),
        (-1.5, -1.6, -1.4, "FAIL"),
        (0.9, None, None, "PASS"),
        (1.1, None, None, "FAIL"),
        (None, None, None, "NO_DATA"),
    ]
    judged.specify(limits(BIAS))
    units = [f"U{number:02d}" for number in range(len(cases))]
    values = [
        {"unit": unit, "value": value, "lo": lo, "hi": hi, "reason": "too short" if value is None else None}
        for unit, (value, lo, hi, _) in zip(units, cases, strict=True)
    ]
    found = verdicts_of(judged.catalog([{"unit": unit, "run": "r1"} for unit in units], values))
    rows = {row["unit"]: row for row in found.verdicts}
    assert len(rows) == len(found.verdicts) == len(cases)
    for unit, (value, lo, _, verdict) in zip(units, cases, strict=True):
        row = rows[unit]
        assert row["verdict"] == verdict, row
        assert (row["specification"], row["revision"], row["product"]) == ("fog", "A", "X")
        assert (row["reason"] is None) == (verdict in {"PASS", "FAIL"} and lo is not None)
        if value is None:
            assert row["reason"] == "too short"
    assert {unit["unit"]: unit["verdict"] for unit in found.units} == {
        unit: verdict for unit, (_, _, _, verdict) in zip(units, cases, strict=True)
    }


@pytest.mark.parametrize(("upper", "unit", "verdict"), [(1.0 / 3600, "deg/s", "PASS"), (0.9 / 3600, "deg/s", "FAIL")])
def test_a_limit_in_another_unit_is_the_same_limit(judged: Judged, upper: float, unit: str, verdict: str) -> None:
    judged.specify(limits(f'metric = "bias"\nupper = {upper!r}\nunit_of_measure = "{unit}"'))
    catalog = judged.catalog([{"unit": "U1", "run": "r1"}], [{"value": 0.95, "lo": 0.92, "hi": 0.98}])
    (row,) = verdicts_of(catalog).verdicts
    assert row["verdict"] == verdict
    assert row["value"] == pytest.approx(0.95 / 3600, rel=1e-12)
    assert row["unit_of_measure"] == unit


def test_a_value_in_a_unit_that_does_not_fit_has_no_verdict(judged: Judged) -> None:
    judged.specify(limits(BIAS))
    catalog = judged.catalog([{"unit": "U1", "run": "r1"}], [{"value": 0.0, "unit_of_measure": "mV"}])
    (row,) = verdicts_of(catalog).verdicts
    assert (row["verdict"], row["reason"]) == ("NO_DATA", "the value is in mV, the limit in deg/h")


def test_each_run_is_judged_by_the_revision_that_was_valid_when_it_began(judged: Judged) -> None:
    for revision, head, upper in (
        ("A", "valid_from = 2026-01-02", 3.0),
        ("B", "valid_from = 2026-01-03", 2.0),
        ("C", "valid_from = 2026-01-04\nvalid_until = 2026-01-04", 1.0),
    ):
        body = f'metric = "bias"\nupper = {upper}\nunit_of_measure = "deg/h"'
        judged.specify(limits(body, revision=revision, head=head))
    runs = [{"unit": "U1", "run": f"r{day}", "t_start_ns": JANUARY_NS + day * DAY_NS} for day in range(5)]
    values = [{"run": f"r{day}", "value": 1.5, "lo": 1.4, "hi": 1.6} for day in range(5)]
    found = {row["run"]: row for row in verdicts_of(judged.catalog(runs, values)).verdicts}
    assert [(found[f"r{day}"]["revision"], found[f"r{day}"]["verdict"]) for day in range(5)] == [
        (None, "NO_DATA"), ("A", "PASS"), ("B", "PASS"), ("C", "FAIL"), (None, "NO_DATA"),
    ]  # fmt: skip
    assert found["r0"]["reason"].startswith("no revision of fog was valid at 2026-01-01: there is A from 2026-01-02")
    assert "2026-01-05" in found["r4"]["reason"]


def test_a_value_over_several_runs_is_of_the_last_of_them(judged: Judged) -> None:
    judged.specify(limits(BIAS, revision="A"))
    judged.specify(limits(BIAS.replace("1.0", "5.0"), revision="B", head="valid_from = 2026-01-03"))
    runs = [{"unit": "U1", "run": f"r{day}", "t_start_ns": JANUARY_NS + day * DAY_NS} for day in range(4)]
    values = [{"run": None, "runs": ["r3", "r0", "r1"], "value": 2.0, "lo": 1.9, "hi": 2.1}]
    (row,) = verdicts_of(judged.catalog(runs, values)).verdicts
    assert (row["revision"], row["verdict"], row["day"]) == ("B", "PASS", "2026-01-04")


def test_a_run_without_a_date_has_a_verdict_only_where_there_is_one_revision(judged: Judged) -> None:
    runs = [{"unit": "U1", "run": "r1", "date_known": False, "t_start_ns": 0}]
    values = [{"value": 0.0, "lo": -0.1, "hi": 0.1}]
    judged.specify(limits(BIAS))
    assert verdicts_of(judged.catalog(runs, values)).verdicts[0]["verdict"] == "PASS"
    judged.specify(limits(BIAS, revision="B", head="valid_from = 2026-01-03"))
    (row,) = verdicts_of(judged.catalog(runs, values)).verdicts
    assert row["verdict"] == "NO_DATA"
    assert row["reason"].startswith("the date of the run is not known, so nobody can say which revision of fog held")


def test_a_limit_is_of_the_values_with_its_parameters_product_signal_and_standard(judged: Judged) -> None:
    ask = 'metric = "bias_stability_averaged"\nupper = 1.0\nunit_of_measure = "deg/h"\n'
    judged.specify(
        limits(
            ask + "parameters = { average_s = 100, position = 'X' }",
            ask + 'product = "Y"',
            ask + 'signal = "rate_z"\nproduct = "X"',
            'metric = "bias"\nupper = 1.0\nunit_of_measure = "deg/h"\nstandard = "JJF2014"',
        )
    )
    stability: dict[str, Any] = {
        "metric": "bias_stability_averaged",
        "value": 2.0,
        "lo": 1.9,
        "hi": 2.1,
        "standard": "JJF2014",
    }
    values: list[dict[str, Any]] = [
        {**stability, "parameters": {"average_s": 100.0, "position": "X"}},
        {**stability, "parameters": {"average_s": 10, "position": "X"}},
        {**stability, "parameters": {"average_s": 100, "position": "Y"}},
        {**stability, "parameters": {"average_s": "100 s", "position": "X"}},
        {**stability, "parameters": {"position": "X"}},
        {**stability, "signal": "rate_z", "parameters": {}},
        {"value": 2.0, "lo": 1.9, "hi": 2.1, "standard": "GJB2426A"},
        {"value": 2.0, "lo": 1.9, "hi": 2.1, "standard": "GJB2426A, JJF2014", "run": "r2"},
    ]
    runs = [{"unit": "U1", "run": "r1"}, {"unit": "U1", "run": "r2"}]
    found = verdicts_of(judged.catalog(runs, values)).verdicts
    assert sorted((row["metric"], row["signal"], row["run"], row["parameters"]) for row in found) == [
        ("bias", "rate", "r2", "{}"),
        ("bias_stability_averaged", "rate", "r1", '{"average_s": 100.0, "position": "X"}'),
        ("bias_stability_averaged", "rate_z", "r1", "{}"),
    ]
    assert {row["verdict"] for row in found} == {"FAIL"}


def test_what_a_specification_asks_for_and_nobody_measured_is_no_data(judged: Judged) -> None:
    judged.specify(
        limits(
            BIAS,
            'metric = "bias_stability_averaged"\nparameters = { average_s = 100 }\nupper = 1.0\n'
            'unit_of_measure = "deg/h"',
        )
    )
    runs = [{"unit": "U1", "run": "r1"}, {"unit": "U2", "run": "r1"}]
    values: list[dict[str, Any]] = [
        {"value": 0.0, "lo": -0.1, "hi": 0.1},
        {"metric": "bias_stability_averaged", "parameters": {"average_s": 10}, "value": 0.1, "lo": 0.1, "hi": 0.1},
        {"unit": "U2", "value": 0.0, "lo": -0.1, "hi": 0.1},
    ]
    found = verdicts_of(judged.catalog(runs, values))
    lacking = {row["unit"]: row for row in found.verdicts if row["metric"] == "bias_stability_averaged"}
    assert {row["verdict"] for row in lacking.values()} == {"NO_DATA"}
    assert lacking["U1"]["reason"] == (
        "values of bias_stability_averaged are there, but none of bias_stability_averaged (average_s = 100)"
    )
    assert lacking["U2"]["reason"].startswith("not measured: it needs ")
    assert [(row["unit"], row["verdict"], row["lacking"]) for row in found.units] == [
        ("U1", "NO_DATA", ["bias_stability_averaged"]), ("U2", "NO_DATA", ["bias_stability_averaged"]),
    ]  # fmt: skip


def test_a_unit_that_no_limit_applies_to_says_why(judged: Judged) -> None:
    judged.specify(limits(BIAS + '\nproduct = "X"'))
    runs: Rows = [{"unit": "U1", "run": "r1", "product": "Y"}, {"unit": "U2", "run": "r1", "product": None}]
    found = verdicts_of(judged.catalog(runs, [{"value": 0.0}]))
    assert [(row["verdict"], row["reason"]) for row in found.units] == [
        ("NO_DATA", "no limit applies to it: no specification is for product Y"),
        ("NO_DATA", "no limit applies to it: its product is not known"),
    ]


def test_a_store_without_limits_says_so(judged: Judged) -> None:
    found = verdicts_of(judged.catalog([{"unit": "U1", "run": "r1", "product": None}], [{"value": 0.0}]))
    assert [(row["verdict"], row["reason"]) for row in found.units] == [
        ("NO_DATA", "the store has no limits: add a specification with `gyrofleet limits add`")
    ]


def test_the_worst_counts_and_a_vain_attempt_only_where_there_is_no_other(judged: Judged) -> None:
    judged.specify(limits(BIAS))
    good, bad = {"value": 0.0, "lo": -0.1, "hi": 0.1}, {"value": 2.0, "lo": 1.9, "hi": 2.1}
    vain, near = {"value": None, "reason": "cut short"}, {"value": 1.0, "lo": 0.9, "hi": 1.1}
    histories: dict[str, Rows] = {
        "PASS": [vain, good], "FAIL then PASS": [bad, good], "PASS then FAIL": [good, bad], "MARGINAL": [good, near],
        "NO_DATA": [vain], "FAIL": [near, bad, vain],
    }  # fmt: skip
    runs: list[dict[str, Any]] = [
        {"unit": unit, "run": f"r{i}", "t_start_ns": JANUARY_NS + i * DAY_NS}
        for unit, values in histories.items()
        for i in range(len(values))
    ]
    values = [
        {"unit": unit, "run": f"r{i}", **value} for unit, each in histories.items() for i, value in enumerate(each)
    ]
    units = {row["unit"]: row for row in verdicts_of(judged.catalog(runs, values)).units}
    assert {unit: (row["verdict"], row["latest_verdict"]) for unit, row in units.items()} == {
        "PASS": ("PASS", "PASS"),
        "FAIL then PASS": ("FAIL", "PASS"),
        "PASS then FAIL": ("FAIL", "FAIL"),
        "MARGINAL": ("MARGINAL", "MARGINAL"),
        "NO_DATA": ("NO_DATA", "NO_DATA"),
        "FAIL": ("FAIL", "FAIL"),
    }
    assert units["FAIL"]["failures"] == ["bias"]


def test_yield_by_lot_station_fixture_and_day_with_wilsons_interval(judged: Judged) -> None:
    judged.specify(limits(BIAS))
    runs: list[dict[str, Any]] = []
    values: list[dict[str, Any]] = []
    for i in range(40):
        place = {"lot": "L1" if i < 30 else None, "station": f"S{i % 2}", "fixture": f"F{i % 4}"}
        runs.append({"unit": f"U{i:02}", "run": "r1", "t_start_ns": JANUARY_NS + (i % 5) * DAY_NS, **place})
        level = 2.0 if i < 6 else 1.0 if i < 8 else 0.0
        value = (
            {"value": None, "reason": "cut short"} if i == 8 else {"value": level, "lo": level - 0.1, "hi": level + 0.1}
        )
        values.append({"unit": f"U{i:02}", "run": "r1", **value})
    catalog = judged.catalog(runs, values)
    first, rest = yield_by(catalog, "lot")
    assert [first[name] for name in ("name", "units", "passed", "failed", "marginal", "no_data")] == [
        "L1",
        30,
        21,
        6,
        2,
        1,
    ]
    assert (rest["name"], rest["units"], rest["passed"]) == (None, 10, 10)
    interval = stats.binomtest(21, 29).proportion_ci(method="wilson")
    assert (first["yield"], first["yield_lo"], first["yield_hi"]) == pytest.approx((21 / 29, *interval), rel=1e-12)
    assert [row["name"] for row in yield_by(catalog, "station")] == ["S0", "S1"]
    assert [row["units"] for row in yield_by(catalog, "fixture")] == [10] * 4
    assert [row["name"] for row in yield_by(catalog, "day")] == [f"2026-01-0{day}" for day in range(1, 6)]
    assert sum(row["failed"] for row in yield_by(catalog, "day")) == 6


def test_a_unit_is_judged_in_each_station_by_what_was_measured_there(judged: Judged) -> None:
    judged.specify(limits(BIAS))
    runs = [{"unit": "U1", "run": "r1", "station": "S1"}, {"unit": "U1", "run": "r2", "station": "S2"}]
    values: Rows = [{"value": 0.0, "lo": -0.1, "hi": 0.1}, {"run": "r2", "value": 2.0, "lo": 1.9, "hi": 2.1}]
    catalog = judged.catalog(runs, values)
    assert [(row["name"], row["passed"], row["failed"]) for row in yield_by(catalog, "station")] == [
        ("S1", 1, 0), ("S2", 0, 1),
    ]  # fmt: skip
    assert verdicts_of(catalog).units[0]["verdict"] == "FAIL"


def test_the_most_frequent_failure_comes_first(judged: Judged) -> None:
    judged.specify(limits(BIAS, 'metric = "bias_stability"\nupper = 1.0\nunit_of_measure = "deg/h"'))
    runs = [{"unit": f"U{i}", "run": "r1"} for i in range(10)]
    bad, good = {"value": 2.0, "lo": 1.9, "hi": 2.1}, {"value": 0.5, "lo": 0.4, "hi": 0.6}
    values: list[dict[str, Any]] = [{"unit": f"U{i}", **(bad if i < 2 else good)} for i in range(10)]
    values += [{"unit": f"U{i}", "metric": "bias_stability", **(bad if i < 6 else good)} for i in range(10)]
    pareto = verdicts_of(judged.catalog(runs, values)).pareto
    assert [(row["place"], row["metric"], row["failed"], row["judged"]) for row in pareto] == [
        (1, "bias_stability", 6, 10), (2, "bias", 2, 10),
    ]  # fmt: skip
    assert [(row["share"], row["cumulative_share"]) for row in pareto] == [(0.75, 0.75), (0.25, 1.0)]
    assert pareto[1]["zh"] == "零偏"


def test_an_entered_check_counts_by_its_own_verdict(judged: Judged) -> None:
    for verdict, t_ns in ((Verdict.FAIL, JANUARY_NS), (Verdict.PASS, JANUARY_NS + DAY_NS)):
        entry = Entry("U1", "visual", "Li", verdict, note="scratch" if verdict is Verdict.FAIL else "polished")
        enter(judged.store.folder, [check_entered(entry, t_ns)], role="test")
    value = Entry("U1", "insulation", "Li", None, 80.0, "megaohm", 100.0)
    enter(judged.store.folder, [check_entered(value, JANUARY_NS)], role="test")
    found = verdicts_of(judged.catalog([], []))
    assert [(row["metric"], row["verdict"], row["reason"]) for row in found.verdicts] == [
        ("insulation", "FAIL", None), ("visual_check", "FAIL", "scratch"), ("visual_check", "PASS", "polished"),
    ]  # fmt: skip
    assert (found.verdicts[0]["value"], found.verdicts[0]["lower"]) == (80.0, 100.0)
    (unit,) = found.units
    assert (unit["verdict"], unit["failures"]) == ("FAIL", ["insulation", "visual_check"])
    assert found.has_failure


def check(judged: Judged, unit: str, verdict: Verdict = Verdict.PASS, **more: Any) -> None:
    enter(judged.store.folder, [check_entered(Entry(unit, "visual", "Li", verdict, **more), JANUARY_NS)], role="test")


def test_a_check_alone_passes_no_unit(judged: Judged) -> None:
    check(judged, "NOPE-9")
    check(judged, "NOPE-8", Verdict.FAIL)
    catalog = judged.catalog([], [])
    passing, failing = verdicts_of(catalog, ["NOPE-9"]).units[0], verdicts_of(catalog, ["NOPE-8"]).units[0]
    assert (passing["verdict"], passing["latest_verdict"], failing["verdict"]) == ("NO_DATA", "NO_DATA", "FAIL")
    assert passing["reason"].startswith("the store has no limits")
    (group,) = yield_by(catalog, "lot")
    assert (group["passed"], group["failed"], group["no_data"], group["yield"]) == (0, 1, 1, 0.0)


def test_limits_for_every_product_apply_to_a_unit_that_was_only_checked(judged: Judged) -> None:
    judged.specify(limits(BIAS, 'metric = "bias_stability"\nproduct = "X"\nupper = 1.0\nunit_of_measure = "deg/h"'))
    check(judged, "NOPE-9")
    found = verdicts_of(judged.catalog([], []))
    (unit,) = found.units
    assert (unit["verdict"], unit["passed"], unit["lacking"]) == ("NO_DATA", 1, ["bias", "product"])
    reasons = {row["metric"]: row["reason"] for row in found.verdicts if row["verdict"] == "NO_DATA"}
    assert reasons["bias"].startswith("not measured: it needs ")
    assert reasons["product"].startswith("its product is not known, so that no limit of X is applied")
    assert [row["passed"] for row in yield_by(judged.catalog([], []), "lot")] == [0]


def test_a_unit_of_unknown_product_passes_only_where_no_limit_asks_for_the_product(judged: Judged) -> None:
    runs: Rows = [{"unit": "U1", "run": "r1", "product": None}]
    values: Rows = [{"value": 0.0, "lo": -0.1, "hi": 0.1}]
    judged.specify(limits(BIAS))
    assert verdicts_of(judged.catalog(runs, values)).units[0]["verdict"] == "PASS"
    judged.specify(limits('metric = "bias_stability"\nproduct = "X"\nupper = 1.0\nunit_of_measure = "deg/h"'), "x.toml")
    (unit,) = verdicts_of(judged.catalog(runs, values)).units
    assert (unit["verdict"], unit["passed"], unit["lacking"]) == ("NO_DATA", 1, ["product"])
    assert unit["reason"].startswith("its product is not known, so that no limit of X is applied: name its product")


@pytest.mark.in_gate("FOG_0231", "FOG-02.31")
@pytest.mark.parametrize("other", ["fog-0231", "FOG_0231", "FOG0231", "FOG-02.31"])
def test_a_unit_under_two_names_is_warned_of(judged: Judged, other: str) -> None:
    runs = [{"unit": unit, "run": "r1"} for unit in ("FOG-0231", other, "FOG-0232")]
    warnings = verdicts_of(judged.catalog(runs, [])).warnings
    assert sorted(row["unit"] for row in warnings) == sorted(["FOG-0231", other])
    assert all(other in row["reason"] and "FOG-0231" in row["reason_zh"] for row in warnings)


def test_a_unit_that_is_not_there_is_refused_with_one_that_is(judged: Judged) -> None:
    catalog = judged.catalog([{"unit": "FOG-0231", "run": "r1"}], [])
    with pytest.raises(NotFound, match=r"did you mean FOG-0231\?"):
        verdicts_of(catalog, ["fog-0231"])
    assert verdicts_of(catalog, ["FOG-0231"]).units[0]["reason"] == (
        "the store has no limits: add a specification with `gyrofleet limits add`"
    )


def test_without_specifications_there_is_nothing_to_judge_by(judged: Judged) -> None:
    catalog = judged.catalog([], [])
    assert verdicts_of(catalog) == ([], [], [], [])
    assert yield_by(catalog, "lot") == []


def test_every_metric_has_names_in_two_languages(judged: Judged) -> None:
    rows = rows_of(judged.catalog([], []), "select * from metric_names order by metric")
    assert [row["metric"] for row in rows] == list(metrics())
    assert all(row["en"] and row["zh"] and not row["zh"].isascii() and row["needs"] for row in rows)
