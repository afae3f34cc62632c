"""Three months of files, imported in another order than they were measured in, asked by product, month and run."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from tests.analytics.serve.conftest import TOKEN, start
from tests.forked_commands import CommandServer

# month: mean rate of each unit in deg/h; a limit of 5 deg/h is for both products
MEASURED = {"2026-03": {"A1": 1.0, "B1": 9.0}, "2026-01": {"A1": 9.0, "A2": 1.0}, "2026-02": {"B1": 1.0}}
LIMIT = 'revision = "A"\n[[limit]]\nmetric = "bias"\nlower = -5.0\nupper = 5.0\nunit_of_measure = "deg/h"\n'


@pytest.fixture(scope="module")
def served_at(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("months") / "S"


@pytest.fixture(scope="module")
def months(served_at: Path, command_server: CommandServer, run_command: Callable[..., Any]) -> Iterator[httpx.Client]:
    """A client of a server of that store."""
    folder = served_at.parent
    noise = np.random.default_rng(3).normal(0.0, 0.5, 1200)
    (folder / "units.csv").write_text("unit,product,lot\nA1,A,L1\nA2,A,L1\nB1,B,L2\n")
    (folder / "limits.toml").write_text(LIMIT)
    commands: list[tuple[str, ...]] = [("limits", "add", "limits.toml", "--reason", "first", "--by", "Li")]
    for month, units in MEASURED.items():
        lines = ["time[s],unit,run,rate[deg/h],procedure,position"]
        lines += [
            f"{second},{unit},{unit}_{month},{level + noise[second]:.6f},static_bias,IRA_east_west"
            for unit, level in units.items()
            for second in range(1200)
        ]
        (folder / f"{month}.csv").write_text("\n".join(lines) + "\n")
        commands.append(("import", f"{month}.csv", "--start", f"{month}-10T08:00:00Z", "--units", "units.csv",
                         "--station", f"bench-{month[-1]}"))  # fmt: skip
    served_at.mkdir()
    for words in (commands[1], commands[0], *commands[2:]):
        done = run_command(*words, "--store", "S", cwd=folder)
        assert done.code == 0, (words, done.out, done.err)
    process, ready = start(command_server, "--store", "S", "--port", 0, "--token", TOKEN, cwd=folder)
    with httpx.Client(base_url=ready["url"], headers={"Authorization": f"Bearer {TOKEN}"}, timeout=60.0) as client:
        yield client
    process.terminate()
    process.communicate(timeout=30)


def _asked(client: httpx.Client, path: str) -> Any:
    answer = client.get(path)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_the_last_run_of_a_unit_is_the_last_that_was_measured(months: httpx.Client) -> None:
    units = {row["unit"]: row for row in _asked(months, "/api/units")["units"]}
    assert {name: row["last_run"] for name, row in units.items()} == {
        "A1": "A1_2026-03", "A2": "A2_2026-01", "B1": "B1_2026-03",
    }  # fmt: skip
    assert units["A2"]["measured"].startswith("2026-01-10")
    assert units["A2"]["recorded"] > "2026-11"
    runs = [row["run"][-7:] for row in _asked(months, "/api/runs")["runs"]]
    assert runs == sorted(runs, reverse=True)
    assert sorted(runs) == ["2026-01", "2026-01", "2026-02", "2026-03", "2026-03"]


def test_a_unit_is_found_by_each_station_that_measured_it(months: httpx.Client) -> None:
    for station, units in (("bench-3", ["A1", "B1"]), ("bench-1", ["A1", "A2"]), ("bench-2", ["B1"]), ("bench-9", [])):
        assert [row["unit"] for row in _asked(months, f"/api/units?station={station}")["units"]] == units
    assert _asked(months, "/api/units/A1")["about"]["stations"] == ["bench-1", "bench-3"]


def test_the_runs_come_page_by_page_in_the_same_order(months: httpx.Client) -> None:
    whole = [row["run"] for row in _asked(months, "/api/runs")["runs"]]
    found, url = [], "/api/runs?limit=2"
    while url:
        page = _asked(months, url)
        found += [row["run"] for row in page["runs"]]
        url = page["next"]
    assert found == whole


@pytest.mark.parametrize(
    ("question", "expected"),
    [
        ("by=all", {"all": (3, 2)}),  # units, failed
        ("by=all&product=A", {"all": (2, 1)}),
        ("by=product", {"A": (2, 1), "B": (1, 1)}),
        ("by=month&product=B", {"2026-02": (1, 0), "2026-03": (1, 1)}),
        ("by=lot&since=2026-02-01", {"L1": (1, 0), "L2": (1, 1)}),
        ("by=week&unit=A2", {"2026-W02": (1, 0)}),
    ],
)
def test_the_yield_is_of_what_is_asked_for(
    months: httpx.Client, question: str, expected: dict[str, tuple[int, int]]
) -> None:
    found = _asked(months, f"/api/yield?{question}")
    assert {row["name"]: (row["units"], row["failed"]) for row in found["groups"]} == expected
    assert [row["failed"] for row in found["pareto"]] == [n for n in [sum(n for _, n in expected.values())] if n]


def test_verdicts_of_a_run_are_by_what_it_measured(months: httpx.Client) -> None:
    units = _asked(months, "/api/verdicts?run=A1_2026-03")["units"]
    assert [(row["unit"], row["verdict"]) for row in units] == [("A1", "PASS")]
    (row,) = units
    counts = [row[name] for name in ("latest_verdict", "passed", "failed", "marginal", "no_data", "failures")]
    assert counts == ["PASS", 1, 0, 0, 0, []], "those of its other runs are not in the row"
    (row,) = _asked(months, "/api/verdicts?run=A1_2026-01")["units"]
    assert (row["verdict"], row["passed"], row["failed"], row["failures"]) == ("FAIL", 0, 1, ["bias"])
    units = _asked(months, "/api/verdicts?month=2026-01")["units"]
    assert [(row["unit"], row["verdict"]) for row in units] == [("A1", "FAIL"), ("A2", "PASS")]
    for wrong in ("month=2026-13", "week=2026-01", "day=2026-01", "since=yesterday"):
        refused = months.get(f"/api/verdicts?{wrong}")
        assert refused.status_code in {400, 422}, wrong
        assert wrong.partition("=")[2] in refused.text


def test_the_page_says_what_its_yield_is_of(months: httpx.Client) -> None:
    page = months.get("/trends?metric=bias&product=B&yield_by=month", headers={"Accept": "text/html"})
    assert page.status_code == 200
    assert "Of Product B only." in page.text
    assert "/verdicts?verdict=FAIL&amp;product=B&amp;month=2026-03" in page.text
    run = months.get("/runs/A1_2026-03", headers={"Accept": "text/html"}).text
    assert "/verdicts?run=A1" in run


def test_a_unit_has_the_figures_of_the_commands(
    months: httpx.Client, run_command: Callable[..., Any], served_at: Path
) -> None:
    found = _asked(months, "/api/units/A2")
    told = run_command("metrics", "--unit", "A2", "--store", served_at, "--json", cwd=served_at).json
    keys = ("metric", "signal", "run", "value", "lo", "hi", "unit_of_measure", "reason")
    assert [{key: row[key] for key in keys} for row in found["metrics"]] == [
        {key: row[key] for key in keys} for row in told
    ]
    assert {row["metric"] for row in found["verdicts"]} == {"bias"}
    assert (found["verdict"]["verdict"], [each["run"] for each in found["runs"]]) == ("PASS", ["A2_2026-01"])


def test_the_command_gives_the_same_yield(
    months: httpx.Client, run_command: Callable[..., Any], served_at: Path
) -> None:
    done = run_command("verdicts", "--by", "month", "--product", "B", "--store", served_at, "--json", cwd=served_at)
    found = json.loads(done.out)
    assert found["yield"] == _asked(months, "/api/yield?by=month&product=B")["groups"]
    assert [row["failed"] for row in found["pareto"]] == [1]


def test_the_command_says_why_it_gives_none(
    months: httpx.Client, run_command: Callable[..., Any], served_at: Path
) -> None:
    refused = run_command("verdicts", "--product", "B", "--store", served_at, cwd=served_at)
    assert refused.code != 0
    assert "give --by as well" in refused.err
    unknown = run_command("verdicts", "--by", "all", "--product", "b", "--store", served_at, cwd=served_at)
    assert unknown.code != 0
    assert "nothing was judged of product 'b'" in unknown.err
    assert "B" in unknown.err.partition("'b'")[2]


@pytest.mark.long
def test_the_command_says_that_a_group_is_empty_and_speaks_chinese(
    months: httpx.Client, run_command: Callable[..., Any], served_at: Path
) -> None:
    none = run_command("verdicts", "--by", "all", "--since", "2026-05-01", "--store", served_at, cwd=served_at)
    assert "nothing was judged in this group" in none.err
    chinese = run_command("verdicts", "--by", "lot", "--lang", "zh", "--store", served_at, cwd=served_at)
    assert "不合格数" in chinese.out
    assert "不合格项" not in chinese.out
