"""Yield of lots, stations, fixtures and days, and what units fail by."""

from collections.abc import Sequence
from datetime import date, timedelta
from typing import Any

import pytest
from scipy import stats

from analytics.specifications.verdicts import Group, failures_in, verdicts_of, yield_by
from tests.analytics.verdicts.judged_store import BIAS, DAY_NS, JANUARY_NS, Judged, Rows, limits


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
    (without,) = yield_by(catalog, "all", Group(lot="(not given)"))
    assert (without["units"], without["passed"]) == (10, 10)
    interval = stats.binomtest(21, 29).proportion_ci(method="wilson")
    assert (first["yield"], first["yield_lo"], first["yield_hi"]) == pytest.approx((21 / 29, *interval), rel=1e-12)
    assert [row["name"] for row in yield_by(catalog, "station")] == ["S0", "S1"]
    assert [row["units"] for row in yield_by(catalog, "fixture")] == [10] * 4
    assert [row["name"] for row in yield_by(catalog, "day")] == [f"2026-01-0{day}" for day in range(1, 6)]
    assert sum(row["failed"] for row in yield_by(catalog, "day")) == 6


@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.long)])
def test_the_yield_of_all_and_of_parts_of_a_group(judged: Judged, every: bool) -> None:
    judged.specify(limits(BIAS))
    made: list[dict[str, Any]] = []
    for i in range(60):
        where = {"product": "XY"[i % 2], "lot": f"L{i % 3}", "station": f"S{i % 4}", "fixture": None}
        made.append({"unit": f"U{i:02}", "run": "r1", "t_start_ns": JANUARY_NS + i * DAY_NS, **where})
    levels = [2.0 if i % 7 == 0 else 0.0 for i in range(60)]
    values = [
        {"unit": run["unit"], "run": "r1", "value": x, "lo": x - 0.1, "hi": x + 0.1}
        for run, x in zip(made, levels, strict=True)
    ]
    catalog = judged.catalog(made, values)
    dates = [date(2026, 1, 1) + timedelta(days=i) for i in range(60)]
    weeks = [f"{each.isocalendar().year}-W{each.isocalendar().week:02}" for each in dates]
    groups: dict[Group, Sequence[int]] = {
        Group(): range(60),
        Group(product="X"): range(0, 60, 2),
        Group(product="Y", lot="L1"): range(1, 60, 6),
        Group(station="S3", month="2026-02"): [i for i in range(3, 60, 4) if dates[i].month == 2],
        Group(week="2026-W02", units=("U05", "U07", "U40")): [5, 7],
        Group(day="2026-01-08"): [7],
        Group(since_ns=JANUARY_NS + 50 * DAY_NS): range(50, 60),
        Group(since_day="2026-02-20"): range(50, 60),
    }
    for group, members in list(groups.items())[:: 1 if every else 2]:
        names = {
            "all": ["all"] * 60, "product": [run["product"] for run in made], "lot": [run["lot"] for run in made],
            "week": weeks, "month": [f"{each:%Y-%m}" for each in dates],
        }  # fmt: skip
        for kind, levels_of in names.items():
            expected = {
                name: (
                    sum(levels_of[i] == name for i in members),
                    sum(levels_of[i] == name and levels[i] > 1 for i in members),
                )
                for name in sorted({levels_of[i] for i in members})
            }
            rows = yield_by(catalog, kind, group)  # type: ignore[arg-type]
            assert {row["name"]: (row["units"], row["failed"]) for row in rows} == expected, (group, kind)
        failed = sum(levels[i] > 1 for i in members)
        assert [row["failed"] for row in failures_in(catalog, group)] == [failed] * (failed > 0)


@pytest.mark.long
def test_a_unit_is_judged_in_each_station_by_what_was_measured_there(judged: Judged) -> None:
    judged.specify(limits(BIAS))
    runs = [{"unit": "U1", "run": "r1", "station": "S1"}, {"unit": "U1", "run": "r2", "station": "S2"}]
    values: Rows = [{"value": 0.0, "lo": -0.1, "hi": 0.1}, {"run": "r2", "value": 2.0, "lo": 1.9, "hi": 2.1}]
    catalog = judged.catalog(runs, values)
    assert [(row["name"], row["passed"], row["failed"]) for row in yield_by(catalog, "station")] == [
        ("S1", 1, 0), ("S2", 0, 1),
    ]  # fmt: skip
    assert verdicts_of(catalog).units[0]["verdict"] == "FAIL"


def test_a_yield_counts_units_by_their_first_and_by_their_latest_values(judged: Judged) -> None:
    """U1 fails and is good after a repair; U2 is good and fails a month later; U3 was never measured."""
    judged.specify(limits(BIAS))
    good, bad = {"value": 0.0, "lo": -0.1, "hi": 0.1}, {"value": 2.0, "lo": 1.9, "hi": 2.1}
    runs: list[dict[str, Any]] = [{"unit": "U3", "run": "r1"}]
    values: list[dict[str, Any]] = []
    for unit, of_runs in (("U1", (bad, good)), ("U2", (good, bad)), ("U4", (good, good)), ("U5", (bad, good))):
        for number, value in enumerate(of_runs, 1):
            runs.append({"unit": unit, "run": f"r{number}", "t_start_ns": JANUARY_NS + 30 * number * DAY_NS})
            values.append({"unit": unit, "run": f"r{number}", **value})
    (found,) = yield_by(judged.catalog(runs, values), "all")
    assert {name: found[name] for name in ("passed", "failed", "no_data", "first_passed", "latest_passed")} == {
        "passed": 1, "failed": 3, "no_data": 1, "first_passed": 2, "latest_passed": 3,
    }  # fmt: skip


def test_units_that_pass_by_some_of_their_limits_only_are_counted(judged: Judged) -> None:
    """U0 to U3 are measured by both limits at S1, by one at S2; U4 by one alone, which is NO_DATA and no pass."""
    other = 'metric = "bias_stability"\nupper = 1.0\nunit_of_measure = "deg/h"'
    judged.specify(limits(BIAS, other))
    good = {"value": 0.0, "lo": -0.1, "hi": 0.1}
    units = [f"U{i}" for i in range(4)]
    runs = [{"unit": unit, "run": run, "station": at} for unit in units for run, at in (("r1", "S1"), ("r2", "S2"))]
    values: list[dict[str, Any]] = [{"unit": unit, "run": run, **good} for unit in units for run in ("r1", "r2")]
    values += [{"unit": unit, "run": "r1", "metric": "bias_stability", **good} for unit in units]
    catalog = judged.catalog([*runs, {"unit": "U4", "run": "r1"}], [*values, {"unit": "U4", "run": "r1", **good}])
    found = {
        row["name"]: (row["passed"], row["not_all_limits"], row["not_judged"]) for row in yield_by(catalog, "station")
    }
    assert found == {"S1": (4, 0, []), "S2": (4, 4, ["bias_stability"])}
    (everything,) = yield_by(catalog, "all")
    assert (everything["passed"], everything["no_data"], everything["not_all_limits"]) == (4, 1, 0)
    (at_second,) = yield_by(catalog, "all", Group(station="S2"))
    assert (at_second["not_all_limits"], at_second["not_judged"]) == (4, ["bias_stability"])


@pytest.mark.long
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


def test_without_specifications_there_is_nothing_to_judge_by(judged: Judged) -> None:
    catalog = judged.catalog([], [])
    assert verdicts_of(catalog) == ([], [], [], [])
    assert yield_by(catalog, "lot") == []
