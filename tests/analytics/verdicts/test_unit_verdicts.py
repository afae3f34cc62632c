"""Verdicts of units: the worst of their values, entered checks, what was not measured, and unknown products."""

from typing import Any

import pytest

from analytics.specifications.verdicts import verdicts_of, yield_by
from ingest.importing.entered import Entry, check_entered, enter
from stream.errors import NotFound
from stream.events import Verdict
from tests.analytics.verdicts.judged_store import BIAS, DAY_NS, JANUARY_NS, Judged, Rows, limits


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
        ": `gyrofleet metrics --metric bias_stability_averaged` shows which"
    )
    assert lacking["U2"]["reason"].startswith("not measured: it needs ")
    assert [(row["unit"], row["verdict"], row["lacking"]) for row in found.units] == [
        ("U1", "NO_DATA", ["bias_stability_averaged"]), ("U2", "NO_DATA", ["bias_stability_averaged"]),
    ]  # fmt: skip


@pytest.mark.long
def test_a_unit_that_no_limit_applies_to_says_why(judged: Judged) -> None:
    judged.specify(limits(BIAS + '\nproduct = "X"'))
    runs: Rows = [{"unit": "U1", "run": "r1", "product": "Y"}, {"unit": "U2", "run": "r1", "product": None}]
    found = verdicts_of(judged.catalog(runs, [{"value": 0.0}]))
    assert [(row["verdict"], row["reason"]) for row in found.units] == [
        ("NO_DATA", "no limit applies to it: no specification is for product Y"),
        ("NO_DATA", "no limit applies to it: its product is not known"),
    ]


@pytest.mark.long  # in the gate where a unit that is not there is refused
def test_a_store_without_limits_says_so(judged: Judged) -> None:
    found = verdicts_of(judged.catalog([{"unit": "U1", "run": "r1", "product": None}], [{"value": 0.0}]))
    assert [(row["verdict"], row["reason"]) for row in found.units] == [
        ("NO_DATA", "the store has no limits: add a specification with `gyrofleet limits add`")
    ]


@pytest.mark.long
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


@pytest.mark.long
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
    assert found.has("FAIL")


def check(judged: Judged, unit: str, verdict: Verdict = Verdict.PASS, **more: Any) -> None:
    enter(judged.store.folder, [check_entered(Entry(unit, "visual", "Li", verdict, **more), JANUARY_NS)], role="test")


@pytest.mark.long
def test_a_check_alone_passes_no_unit(judged: Judged) -> None:
    check(judged, "NOPE-9")
    check(judged, "NOPE-8", Verdict.FAIL)
    catalog = judged.catalog([], [])
    passing, failing = verdicts_of(catalog, ["NOPE-9"]).units[0], verdicts_of(catalog, ["NOPE-8"]).units[0]
    assert (passing["verdict"], passing["latest_verdict"], failing["verdict"]) == ("NO_DATA", "NO_DATA", "FAIL")
    assert passing["reason"].startswith("the store has no limits")
    (group,) = yield_by(catalog, "lot")
    assert (group["passed"], group["failed"], group["no_data"], group["yield"]) == (0, 1, 1, 0.0)


@pytest.mark.long
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


@pytest.mark.long
def test_a_unit_of_unknown_product_passes_only_where_no_limit_asks_for_the_product(judged: Judged) -> None:
    runs: Rows = [{"unit": "U1", "run": "r1", "product": None}]
    values: Rows = [{"value": 0.0, "lo": -0.1, "hi": 0.1}]
    judged.specify(limits(BIAS))
    assert verdicts_of(judged.catalog(runs, values)).units[0]["verdict"] == "PASS"
    judged.specify(limits('metric = "bias_stability"\nproduct = "X"\nupper = 1.0\nunit_of_measure = "deg/h"'), "x.toml")
    (unit,) = verdicts_of(judged.catalog(runs, values)).units
    assert (unit["verdict"], unit["passed"], unit["lacking"]) == ("NO_DATA", 1, ["product"])
    assert unit["reason"].startswith("its product is not known, so that no limit of X is applied: name its product")


@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.long)])
def test_a_unit_whose_product_no_limit_names_does_not_pass(judged: Judged, every: bool) -> None:
    """As one that is misspelt, or another product of the house that has no limits of its own."""
    runs: Rows = [{"unit": "U1", "run": "r1", "product": "FOG70"}]
    values: Rows = [{"value": 0.0, "lo": -0.1, "hi": 0.1}]
    judged.specify(limits(BIAS))
    own = 'metric = "bias_stability"\nproduct = "FOG-70"\nupper = 1.0\nunit_of_measure = "deg/h"'
    if every:
        assert verdicts_of(judged.catalog(runs, values)).units[0]["verdict"] == "PASS"
    judged.specify(limits(own), "x.toml")
    (unit,) = verdicts_of(judged.catalog(runs, values)).units
    assert (unit["verdict"], unit["passed"], unit["lacking"]) == ("NO_DATA", 1, ["product"])
    assert unit["reason"].startswith(
        "no limit is for its product FOG70, but for FOG-70: correct it with `gyrofleet import"
    )
    if not every:
        return
    walk = 'metric = "angle_random_walk"\nupper = 1.0\nunit_of_measure = "deg/sqrt(h)"'
    judged.specify(limits(walk, head="[product.FOG70]"), "y.toml")
    assert verdicts_of(judged.catalog(runs, values)).units[0]["lacking"] == ["angle_random_walk"]


def test_runs_of_a_product_without_limits_are_named_beside_those_that_are_judged(judged: Judged) -> None:
    """A mistyped product left three runs of a unit out of its verdict, without a word."""
    judged.specify(limits('metric = "bias"\nproduct = "FOG-A"\nupper = 1.0\nunit_of_measure = "deg/h"'))
    runs: Rows = [
        {"unit": "U1", "run": "r1", "product": "FOG-A", "t_start_ns": JANUARY_NS + 9 * 3600 * 10**9},
        {"unit": "U1", "run": "r2", "product": "FOG-SIM"}, {"unit": "U1", "run": "r3", "product": "FOG-SIM"},
        {"unit": "U2", "run": "r1", "product": "FOG-A"},
    ]  # fmt: skip
    found = verdicts_of(judged.catalog(runs, [{"value": 0.0, "lo": -0.1, "hi": 0.1}])).warnings
    ((unit, reason, zh),) = [(row["unit"], row["reason"], row["reason_zh"]) for row in found]
    assert unit == "U1"
    assert reason.startswith("2 runs (r2, r3) of product FOG-SIM, for which there are no limits: none of it is judged")
    assert "FOG-SIM" in zh


def test_a_unit_in_two_lots_says_so(judged: Judged) -> None:
    """Its product and lot were corrected between its runs."""
    judged.specify(limits(BIAS))
    runs: Rows = [
        {"unit": unit, "run": f"r{at}", "product": product, "lot": lot, "t_start_ns": JANUARY_NS + at * DAY_NS}
        for unit, product, lot, at in (
            ("U1", "P1", "L1", 1),
            ("U1", "P2", "L2", 2),
            ("U2", "P2", "L2", 1),
            ("U2", None, "L2", 2),
        )
    ]
    values = [{"unit": row["unit"], "run": row["run"], "value": 0.0, "lo": -0.1, "hi": 0.1} for row in runs]
    found = {row["unit"]: (row["verdict"], row["reason"]) for row in verdicts_of(judged.catalog(runs, values)).units}
    several = "its runs are of several products: P1, P2; its runs are of several lots: L1, L2"
    assert found == {"U1": ("PASS", several), "U2": ("PASS", None)}


def test_a_sensitivity_over_fewer_temperatures_than_that_of_its_peers_is_named(judged: Judged) -> None:
    """U1 was never measured at 55 degC, U2 at one degree less than the others, which is nothing."""
    runs: list[dict[str, Any]] = []
    values: list[dict[str, Any]] = []
    for unit in ("U1", "U2", "U3", "U4", "U5"):
        temperatures = {"U1": (-20.0, 25.0, 40.0), "U2": (-20.0, 25.0, 54.0)}.get(unit, (-20.0, 25.0, 40.0, 55.0))
        for index, temperature in enumerate(temperatures, 1):
            step = {"unit": unit, "run": "r1", "signal": "rate", "index": index, "n": 100, "mean": 0.0}
            runs.append(step | {"procedure": "bias_temperature_sensitivity", "temperature": temperature})
        of = {"room_temperature_deg_c": 25.0, "points": len(temperatures) - 1}
        steps = list(range(1, len(temperatures) + 1))
        values.append(
            {"unit": unit, "metric": "bias_temperature_sensitivity", "value": 0.03, "parameters": of, "steps": steps}
        )
    (found,) = verdicts_of(judged.catalog(runs, values)).warnings
    assert found["unit"] == "U1"
    assert found["reason"].startswith(
        "Bias temperature sensitivity was measured from -20 to 40 degC; of the 5 units of"
    )
    assert "half reach -20 and half 55 degC" in found["reason"]
    assert "零偏温度灵敏度" in found["reason_zh"]


@pytest.mark.long
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
