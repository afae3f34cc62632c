"""Verdicts: each value against the limit that was valid at its time."""

from statistics import NormalDist
from typing import Any

import pytest

from analytics.metric_registry.registry import metrics
from analytics.specifications.risks import lot_risks
from analytics.specifications.verdicts import rows_of, verdicts_of
from tests.analytics.verdicts.judged_store import BIAS, DAY_NS, JANUARY_NS, Judged, limits


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
        (0.9, None, None, "MARGINAL"),  # how sure it is, nobody knows
        (1.1, None, None, "MARGINAL"),
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


def test_a_guard_band_is_of_the_stated_u_and_what_lacks_u_is_no_accepted_unit(judged: Judged) -> None:
    """U = 0.0953 is printed as 0.096; 0.9045 lies inside by 0.0955."""
    judged.specify(limits(f'{BIAS}\ndecision_rule = "guarded_acceptance"'))
    known = {"standard_uncertainty": 0.04, "freedom": 50.0}
    values = [
        {"unit": unit, "value": value, "lo": value - 0.1, "hi": value + 0.1} | known | ({"U": u, "k": 2.0} if u else {})
        for unit, value, u in (("NEAR", 0.9045, 0.0953), ("INSIDE", 0.9035, 0.0953), ("NO-U", 5.0, None))
    ]
    catalog = judged.catalog([{"unit": unit, "run": "r1"} for unit in ("NEAR", "INSIDE", "NO-U")], values)
    found = {row["unit"]: row for row in verdicts_of(catalog).verdicts}
    assert [found[unit]["verdict"] for unit in ("NEAR", "INSIDE", "NO-U")] == ["FAIL", "PASS", "NO_DATA"]
    assert found["NEAR"]["guard"] == 0.096
    (risk,) = lot_risks(catalog)
    assert (risk["judged"], risk["accepted"], risk["rejected"]) == (2, 1, 1)
    tail = NormalDist().cdf(-(1 - 0.9035) / (0.0953 / 2))  # the largest of the units that were accepted
    assert risk["specific_consumer_risk"] == pytest.approx(tail, abs=1e-5)


def test_the_guard_band_of_a_reason_is_in_the_unit_of_the_limit(judged: Judged) -> None:
    body = f'metric = "bias"\nupper = {1 / 3600!r}\nunit_of_measure = "deg/s"\ndecision_rule = "guarded_acceptance"'
    judged.specify(limits(body))
    catalog = judged.catalog(
        [{"unit": "U1", "run": "r1"}], [{"value": 0.98, "lo": 0.9, "hi": 1.06, "U": 0.036, "k": 2.0}]
    )
    (row,) = verdicts_of(catalog).verdicts
    assert row["reason"] == "inside the limit, but by less than the guard band of 1e-05 deg/s (1 U)"


@pytest.mark.long
@pytest.mark.parametrize(("upper", "unit", "verdict"), [(1.0 / 3600, "deg/s", "PASS"), (0.9 / 3600, "deg/s", "FAIL")])
def test_a_limit_in_another_unit_is_the_same_limit(judged: Judged, upper: float, unit: str, verdict: str) -> None:
    judged.specify(limits(f'metric = "bias"\nupper = {upper!r}\nunit_of_measure = "{unit}"'))
    catalog = judged.catalog([{"unit": "U1", "run": "r1"}], [{"value": 0.95, "lo": 0.92, "hi": 0.98}])
    (row,) = verdicts_of(catalog).verdicts
    assert row["verdict"] == verdict
    assert row["value"] == pytest.approx(0.95 / 3600, rel=1e-12)
    assert row["unit_of_measure"] == unit


@pytest.mark.long
def test_a_value_in_a_unit_that_does_not_fit_has_no_verdict(judged: Judged) -> None:
    judged.specify(limits(BIAS))
    catalog = judged.catalog([{"unit": "U1", "run": "r1"}], [{"value": 0.0, "unit_of_measure": "mV"}])
    (row,) = verdicts_of(catalog).verdicts
    assert (row["verdict"], row["reason"]) == ("NO_DATA", "the value is in mV, the limit in deg/h")


@pytest.mark.long
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


@pytest.mark.long
def test_a_value_over_several_runs_is_of_the_last_of_them(judged: Judged) -> None:
    judged.specify(limits(BIAS, revision="A"))
    judged.specify(limits(BIAS.replace("1.0", "5.0"), revision="B", head="valid_from = 2026-01-03"))
    runs = [{"unit": "U1", "run": f"r{day}", "t_start_ns": JANUARY_NS + day * DAY_NS} for day in range(4)]
    values = [{"run": None, "runs": ["r3", "r0", "r1"], "value": 2.0, "lo": 1.9, "hi": 2.1}]
    (row,) = verdicts_of(judged.catalog(runs, values)).verdicts
    assert (row["revision"], row["verdict"], row["day"]) == ("B", "PASS", "2026-01-04")


@pytest.mark.long
def test_a_run_without_a_date_has_a_verdict_only_where_there_is_one_revision(judged: Judged) -> None:
    runs = [{"unit": "U1", "run": "r1", "date_known": False, "t_start_ns": 0}]
    values = [{"value": 0.0, "lo": -0.1, "hi": 0.1}]
    judged.specify(limits(BIAS))
    assert verdicts_of(judged.catalog(runs, values)).verdicts[0]["verdict"] == "PASS"
    judged.specify(limits(BIAS, revision="B", head="valid_from = 2026-01-03"))
    (row,) = verdicts_of(judged.catalog(runs, values)).verdicts
    assert row["verdict"] == "NO_DATA"
    assert row["reason"].startswith("the date of the run is not known, so nobody can say which revision of fog held")


@pytest.mark.long
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


def test_every_metric_has_names_in_two_languages(judged: Judged) -> None:
    rows = rows_of(judged.catalog([], []), "select * from metric_names order by metric")
    assert [row["metric"] for row in rows] == list(metrics())
    assert all(row["en"] and row["zh"] and not row["zh"].isascii() and row["needs"] for row in rows)


def test_a_value_of_a_record_that_is_too_short_does_not_pass(judged: Judged) -> None:
    cases = (
        (3600, 0.0, "PASS", None),
        (3630, 0.0, "PASS", None),  # within a hundredth
        (7200, 0.0, "MARGINAL", "its record lasts 3600 s, the limit asks for 7200 s: measure longer"),
        (7200, 3.0, "FAIL", None),
    )
    asked = dict.fromkeys(record_s for record_s, *_ in cases)
    judged.specify(limits(*(f'{BIAS}\nproduct = "P{record_s}"\nrecord_s = {record_s}' for record_s in asked)))
    steps, values = [], []
    for number, (record_s, value, *_) in enumerate(cases):
        own = {"unit": f"U{number}", "run": "r1", "signal": "rate"}
        steps.append(own | {"product": f"P{record_s}", "index": 1, "t_from_ns": JANUARY_NS})
        values.append(own | {"value": value, "lo": value - 0.1, "hi": value + 0.1})
    found = {row["unit"]: row for row in verdicts_of(judged.catalog(steps, values)).verdicts}
    assert len(found) == len(cases)
    for number, (*_, expected, reason) in enumerate(cases):
        assert (found[f"U{number}"]["verdict"], found[f"U{number}"]["reason"]) == (expected, reason)


def test_a_record_of_unknown_length_does_not_pass_where_one_is_asked_for(judged: Judged) -> None:
    judged.specify(limits(f"{BIAS}\nrecord_s = 60"))
    catalog = judged.catalog(
        [{"unit": "U1", "run": "r1", "index": 7}], [{"run": "r1", "value": 0.0, "lo": -0.1, "hi": 0.1}]
    )
    (found,) = verdicts_of(catalog).verdicts
    assert found["verdict"] == "MARGINAL"
    assert found["reason"] == "the length of its record is not known, the limit asks for 60 s: measure longer"
