"""A retest that no revision judges: no PASS of before it stands, on any door."""

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from click.testing import CliRunner

from analytics.serve.api.operation import Call
from analytics.serve.api.trend.trends import VerdictsAsked, list_verdicts
from gyrofleet import main
from storage.sql.catalog import Catalog
from storage.store import Store
from tests.analytics.verdicts.few_metrics import computing
from tests.e2e.judging.test_groups_of_units import record

Ask = Callable[..., Any]
HEAD = 'name = "P1"\nrevision = "{}"\nvalid_from = 2026-10-{:02}\n'
LIMIT = (
    '[[limit]]\nmetric = "bias"\nproduct = "{}"\nparameters = {{ earth_rate = "none" }}\nupper = 10.0\nlower = 0.0\n'
)
LIMIT += 'unit_of_measure = "deg/h"\n'
WALK = '[[limit]]\nmetric = "angle_random_walk"\nproduct = "P1"\nupper = 10.0\nunit_of_measure = "deg/sqrt(h)"\n'
A = HEAD.format("A", 1) + LIMIT.format("P1")
UNTIL = "valid_until = 2026-10-05\n"


@pytest.fixture(autouse=True)
def _few_metrics() -> Iterator[None]:
    with computing("bias", "angle_random_walk"):
        yield


@pytest.fixture
def enter(ask: Ask, tmp_path: Path) -> Ask:
    """Enter a specification, or measure the bias of a unit on a day of October, of P1 or another product."""

    def enter(*given: Any) -> None:
        if isinstance(given[0], str) and "revision" in given[0]:
            (tmp_path / "p1.toml").write_text(given[0])
            ask("limits", "add", tmp_path / "p1.toml", *given[1:])
            return
        unit, day, bias, product = (*given, "P1")[:4]
        (tmp_path / "units.csv").write_text(f"serial,product,lot\n{unit},{product},L1\n")
        path = record(tmp_path / f"{unit}-{day}.csv", unit, bias, day, day)
        ask("import", path, "--units", tmp_path / "units.csv")

    return enter


def said(folder: Path, *words: str) -> tuple[int, str]:
    """What a person reads."""
    done = CliRunner().invoke(main, [*words, "--store", str(folder)], env={"COLUMNS": "400"})
    return done.exit_code, " ".join(done.output.split())


def test_no_pass_stands_after_a_value_that_no_revision_judges(ask: Ask, enter: Ask, tmp_path: Path) -> None:
    enter(A.replace("[[limit]]", UNTIL + "[[limit]]"))
    enter("V1", 2, 5.0)
    enter("V2", 2, 5.0)
    enter("V1", 6, 20.0)
    found = ask("verdicts")
    units = {row["unit"]: row for row in found["units"]}
    states = {unit: (row["verdict"], row["latest_verdict"], row["no_data"]) for unit, row in units.items()}
    assert states == {"V1": ("NO_DATA", "NO_DATA", 1), "V2": ("PASS", "PASS", 0)}
    why = "no revision of P1 was valid at 2026-10-06: there is A from 2026-10-01 until 2026-10-06 (not included)"
    assert units["V1"]["reason"] == f"bias of run V1-6 is not judged: {why}"
    (retest,) = (row for row in found["verdicts"] if row["run"] == "V1-6")
    assert (retest["is_unjudged"], retest["reason"]) == (True, why)
    assert retest["value"] == pytest.approx(20.0, abs=0.1)
    (group,) = ask("verdicts", "--by", "lot")["yield"]
    assert [group[name] for name in ("units", "passed", "no_data", "unjudged")] == [2, 1, 1, ["V1"]]
    with Catalog(Store.open(tmp_path / "S")) as catalog:
        assert catalog.rows("select unit from unit_verdicts where verdict = 'PASS'") == [("V2",)]
        call = cast("Call", SimpleNamespace(metrics=catalog))
        for asked in (VerdictsAsked(), VerdictsAsked(lot="L1"), VerdictsAsked(metric="bias")):
            rows = list_verdicts.handler(call, asked).units
            assert [(row["unit"], row["latest_verdict"]) for row in rows] == [("V1", "NO_DATA"), ("V2", "PASS")]
    assert said(tmp_path / "S", "verdicts", "--by", "lot")[1].count("1 unit has values that nothing judges") == 1
    repeats = "all units: 2 of 2 (100.0%) pass by their first values, 1 of 1 (100.0%) by their latest"
    assert repeats in said(tmp_path / "S", "verdicts", "--by", "all")[1]
    code, text = said(tmp_path / "S", "verdicts", "--fail-on-no-data", "--lang", "zh", "--unit", "V1")
    assert (code, "试验 V1-6" in text) == (4, True)
    assert said(tmp_path / "S", "verdicts", "--fail-on-no-data", "--unit", "V2")[0] == 0


@pytest.mark.long
def test_a_retest_after_a_withdrawal_has_a_row_and_counts_on_its_day(ask: Ask, enter: Ask, tmp_path: Path) -> None:
    enter(A)
    enter("V1", 2, 5.0)
    ask("limits", "withdraw", "P1-A", "--reason", "typed wrong")
    enter("V1", 6, 5.0)
    enter("V2", 6, 5.0)
    rows = {(row["run"], row["verdict"], row["reason"]) for row in ask("verdicts")["verdicts"]}
    why = "no revision of P1 in force judges it: there is A from 2026-10-01 (withdrawn)"
    assert rows == {("V1-2", "PASS", None), ("V1-6", "NO_DATA", why), ("V2-6", "NO_DATA", why)}
    days = {row["name"]: (row["units"], row["no_data"]) for row in ask("verdicts", "--by", "day")["yield"]}
    assert days == {"2026-10-02": (1, 0), "2026-10-06": (2, 2)}
    (judged, *_) = (row["reason"] for row in ask("verdicts", "--unit", "V1")["units"])
    assert judged.startswith(f"bias of run V1-6 is not judged: {why}; P1-A was withdrawn on ")
    assert judged.endswith("typed wrong, and still judges this, which was recorded before")
    assert "P1-A (withdrawn)" in said(tmp_path / "S", "verdicts", "--unit", "V1")[1]
    assert "P1-A 已于" in said(tmp_path / "S", "verdicts", "--by", "day", "--lang", "zh")[1]
    assert "in force withdrawn: P1-A (" in said(tmp_path / "S", "limits", "list")[1]
    assert "no revision of 'P1' is in force: P1-A is withdrawn" in said(tmp_path / "S", "limits", "show", "P1")[1]
    assert "P1-A, from 2026-10-01, withdrawn" in said(tmp_path / "S", "limits", "show", "P1-A")[1]
    enter(A.replace('"A"', '"B"'))  # what no revision judged is judged by the first that is entered for its time
    assert {row["verdict"] for row in ask("verdicts")["units"]} == {"PASS"}


@pytest.mark.long
@pytest.mark.parametrize("failing", [20.0, 5.0])
def test_a_mistyped_product_of_a_revision_makes_no_unit_pass(ask: Ask, enter: Ask, failing: float) -> None:
    """The failing run is in the time of revision B, which is for PI; that after it is judged by C."""
    revisions = [
        HEAD.format(name, day) + LIMIT.format(product)
        for name, day, product in (("A", 1, "P1"), ("B", 3, "PI"), ("C", 5, "P1"))
    ]
    for each in revisions:
        enter(each)
    for day, bias in ((2, failing), (4, 20.0), (6, 5.0)):
        enter("V1", day, bias)
    found = ask("verdicts")
    (unit,) = found["units"]
    assert (unit["verdict"], unit["latest_verdict"]) == ("FAIL" if failing > 10 else "NO_DATA", "PASS")
    ((run, why),) = ((row["run"], row["reason"]) for row in found["verdicts"] if row["is_unjudged"])
    assert run == "V1-4"
    assert why.startswith("P1-B, valid at 2026-10-04, has no limit for product P1, but for PI: there is A from")


@pytest.mark.long
def test_what_asks_for_nothing_keeps_no_unit_from_passing(ask: Ask, enter: Ask) -> None:
    """A value of before the specification, and a characteristic that its later revision no longer limits."""
    enter(A.replace("-01\n", "-03\n") + WALK)
    enter(HEAD.format("B", 5) + LIMIT.format("P1"))
    for unit, day in (("V1", 2), ("V1", 4), ("V1", 6), ("V2", 6)):
        enter(unit, day, 20.0 if day == 2 else 5.0)
    found = ask("verdicts")
    assert {row["unit"]: (row["verdict"], row["reason"]) for row in found["units"]} == {
        "V1": ("PASS", "bias of run V1-2 was measured before its specification was valid, and is not judged"),
        "V2": ("PASS", None),
    }
    assert not [row for row in found["verdicts"] if row["run"] == "V2-6" and row["metric"] != "bias"]


MISTYPED = "no limit is for its product P11, but for P1: correct it with `gyrofleet import --units`, or add a table"


@pytest.mark.parametrize("days", [[4], pytest.param([2], marks=pytest.mark.long)])
def test_a_run_of_a_mistyped_product_is_not_judged(ask: Ask, enter: Ask, tmp_path: Path, days: list[int]) -> None:
    """The product of the first run, or of one in the middle, is named by no specification."""
    enter(A)
    walk = WALK.replace('product = "P1"\n', "")
    enter('name = "ALL"\nrevision = "A"\n' + walk)
    for day in (2, 4, 6):
        enter("V1", day, 20.0 if day in days else 5.0, "P11" if day in days else "P1")
    found = ask("verdicts")
    (unit,) = found["units"]
    assert (unit["verdict"], unit["latest_verdict"]) == ("NO_DATA", "PASS")
    assert unit["reason"].startswith(f"bias of run V1-{days[0]} is not judged: {MISTYPED}")
    ((run, value),) = ((row["run"], row["value"]) for row in found["verdicts"] if row["is_unjudged"])
    assert (run, value) == (f"V1-{days[0]}", pytest.approx(20.0, abs=0.1))
    groups = {row["name"]: (row["passed"], row["no_data"]) for row in ask("verdicts", "--by", "product")["yield"]}
    assert groups["P11"] == (0, 1)
    enter(HEAD.format("B", 8).replace("P1", "ALL") + "[product.P11]\n" + walk)  # the limits for every product are all
    assert [row["verdict"] for row in ask("verdicts")["units"]] == ["PASS"]


@pytest.mark.long
def test_a_unit_moved_to_another_product_with_limits_passes(ask: Ask, enter: Ask) -> None:
    enter(A + WALK + WALK.replace("P1", "P2"))
    enter("V1", 2, 50.0, "P2")
    enter("V1", 4, 5.0)
    assert [row["verdict"] for row in ask("verdicts")["units"]] == ["PASS"]


@pytest.mark.long
@pytest.mark.parametrize("is_measured", [True, False])
def test_a_product_whose_limits_are_over_is_not_called_wrong(ask: Ask, enter: Ask, is_measured: bool) -> None:
    """Those of another product are in force; a unit of which nothing was measured does not pass either."""
    text = A.replace("[[limit]]", UNTIL + "[[limit]]")
    if not is_measured:
        text = text.replace('"bias"', '"bias_repeatability"').replace('parameters = { earth_rate = "none" }\n', "")
    enter(text)
    walk = WALK.replace('product = "P1"\n', "")
    enter('name = "P2"\nrevision = "A"\n' + LIMIT.format("P2") + walk)
    enter("V1", 6, 5.0)
    found = ask("verdicts")
    assert [row["verdict"] for row in found["units"]] == ["NO_DATA"]
    (row,) = (row for row in found["verdicts"] if row["verdict"] == "NO_DATA")
    over = "no revision of P1 was valid at 2026-10-06: there is A from 2026-10-01 until 2026-10-06 (not included)"
    assert row["reason"] == (over if is_measured else "no limit for its product P1 was in force at 2026-10-06")
