"""Checks entered by hand: what is refused, what is kept, and where it goes while a recorder writes the store."""

import json
from collections.abc import Callable
from pathlib import Path
from subprocess import Popen
from typing import Any

import pytest

from ingest.importing.entered import Entry, check_entered, enter
from storage.check.verify import verify
from storage.sql.catalog import Catalog
from storage.store import Store, WriterLock
from stream.errors import BadInput, StoreError
from stream.events import Verdict

GOOD = Entry("FOG-1", "insulation", "Li", value=120.0, unit_of_measure="megaohm", lower=100.0)


def kept(folder: Path) -> list[dict[str, Any]]:
    with Catalog(Store.open(folder)) as catalog:
        rows = catalog.rows("select unit, run, document from events where kind = 'CheckEntered' order by t_ns")
        return [{"unit": unit, "run": run} | json.loads(document) for unit, run, document in rows]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"unit": "FOG 1"}, "unit 'FOG 1' cannot be used as a name"),
        ({"run": "a/b"}, "run 'a/b' cannot be used as a name"),
        ({"item": "  "}, "--item is empty"),
        ({"by": ""}, "--by is empty"),
        ({"note": "x" * 1001}, "--note has 1001 characters"),
        ({"value": float("nan")}, "--value nan is no finite number"),
        ({"upper": float("inf")}, "--upper inf is no finite number"),
        ({"upper": 50.0}, "--lower 100 lies above --upper 50"),
        ({"unit_of_measure": "megohmm"}, "unit of measure 'megohmm' is not known"),
        ({"value": None}, "without --value"),
        ({"value": None, "lower": None, "unit_of_measure": ""}, "nothing says how it was judged"),
        ({"lower": None}, "nothing says how it was judged"),
        ({"verdict": Verdict.FAIL}, "--verdict is FAIL, but 120 against its limits is PASS"),
        ({"verdict": Verdict.PASS, "value": 99.0}, "--verdict is PASS, but 99 against its limits is FAIL"),
    ],
)
def test_what_contradicts_itself_or_is_incomplete_is_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput) as refused:
        check_entered(GOOD._replace(**changes), 0)
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("lower", "upper", "verdict"),
    [(120.0, None, "PASS"), (None, 120.0, "PASS"), (120.1, None, "FAIL"), (None, 119.9, "FAIL"), (100, 200, "PASS")],
)
def test_a_value_is_judged_by_its_limits(lower: float | None, upper: float | None, verdict: str) -> None:
    assert check_entered(GOOD._replace(lower=lower, upper=upper), 0).verdict == verdict


def test_what_is_entered_is_in_the_log_and_the_lake(tmp_path: Path) -> None:
    folder = tmp_path / "S"
    first = check_entered(GOOD, 1)
    second = check_entered(Entry("FOG-1", "visual", "李", Verdict.FAIL, note="划痕", run="r1"), 2)
    assert enter(folder, [first], role="test")
    assert enter(folder, [second, second], role="test")  # said twice it is one document
    found = kept(folder)
    assert [(row["item"], row["verdict"], row["run"], row["by"]) for row in found] == [
        ("insulation", "PASS", "", "Li"), ("visual", "FAIL", "r1", "李"),
    ]  # fmt: skip
    assert (found[0]["value"], found[0]["unit_of_measure"], found[0]["lower"]) == (120.0, "megaohm", 100.0)
    reported, _ = verify(Store.open(folder))
    assert reported.is_sound, reported.findings


def test_a_writer_that_takes_no_messages_is_named(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "S")
    with WriterLock(store, "gyrofleet import"), pytest.raises(StoreError, match="being written by gyrofleet import"):
        enter(store.folder, [check_entered(GOOD, 0)], role="test")


@pytest.mark.long
def test_the_recorder_that_writes_the_store_takes_it(
    tmp_path: Path, endpoint: str, spawn: Callable[..., Popen[str]], gyrofleet: Callable[..., Any]
) -> None:
    recorder = spawn("record", "--store", "S", "--listen", endpoint, "--json")
    assert recorder.stdout is not None
    assert json.loads(recorder.stdout.readline())["event"] == "recording"
    done = gyrofleet(
        "check", "--store", "S", "--unit", "FOG-1", "--item", "visual", "--verdict", "pass", "--by", "Li", "--json"
    )
    assert (done.code, done.json["verdict"], done.json["in_lake"]) == (0, "PASS", False), done
    recorder.terminate()
    recorder.communicate(timeout=30)
    (row,) = kept(tmp_path / "S")
    assert (row["uid"], row["unit"], row["item"]) == (done.json["uid"], "FOG-1", "visual")


@pytest.mark.long
def test_the_command_enters_and_refuses(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    ask = (
        "check",
        "--store",
        "S",
        "--item",
        "insulation",
        "--by",
        "Li",
        "--lower",
        100,
        "--unit-of-measure",
        "megaohm",
    )
    done = gyrofleet(*ask, "--unit", "FOG-1", "--value", 80, "--at", "2026-01-05T08:00:00+08:00")
    assert (done.code, done.out) == (0, "FAIL: insulation of unit FOG-1, entered by Li\n")
    assert kept(tmp_path / "S")[0]["t_ns"] == 1_767_571_200 * 10**9
    for more, said in (
        (("--unit", "fog-1", "--value", 120), "unit 'fog-1' is in the store as 'FOG-1'"),
        (("--unit", "FOG-1", "--value", 120, "--at", "2026-01-05"), "--at '2026-01-05' has no time zone"),
        (("--unit", "FOG-1", "--value", 120, "--at", "2999-01-05T00:00:00Z"), "lies in the future"),
    ):
        refused = gyrofleet(*ask, *more)
        assert refused.code == 1
        assert said in refused.err
    assert len(kept(tmp_path / "S")) == 1
