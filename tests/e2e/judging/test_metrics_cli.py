"""From samples in a file to characteristics, verdicts and tables, by the commands that people use."""

import csv
import io
import json
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from click.testing import CliRunner, Result

from gyrofleet import main

START = "2026-01-05T08:00:00Z"
KEYS = {
    "metric", "unit", "signal", "run", "value", "unit_of_measure", "lo", "hi", "standard_uncertainty", "n",
    "parameters", "runs", "steps", "standard", "clause", "reason", "u_type_a", "u_type_b", "U", "k", "nu", "p",
    "uncertainty_reason",
}  # fmt: skip
BIASES = {"FOG-0001": 0.2, "FOG-0002": 5.0}
LIMITS = """
revision = "A"
[[limit]]
metric = "bias"
parameters = { earth_rate = "none" }
lower = -1.0
upper = 1.0
unit_of_measure = "deg/h"
[[limit]]
metric = "bias_stability_averaged"
parameters = { average_s = 100 }
upper = 0.001
unit_of_measure = "deg/s"
"""

Ask = Callable[..., Result]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """Two units at rest for 4000 s, and one for 150 s: too little for a stability over averages of 100 s."""
    here = tmp_path_factory.mktemp("metrics")
    rng = np.random.default_rng(7)
    for run, units, seconds in (("long", BIASES, 4000), ("short", {"FOG-0003": 0.0}, 150)):
        with (here / f"{run}.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["unit", "time[s]", "rate[deg/h]", "procedure", "step"])
            for unit, bias in units.items():
                noise = rng.normal(0, 0.5, seconds)
                writer.writerows([unit, i, f"{bias + noise[i]:.6f}", "static_bias", "static"] for i in range(seconds))
        words = ("import", f"{run}.csv", "--store", "S", "--start", START, "--station", "bench-1")
        assert run_command(*words, cwd=here).code == 0
    (here / "spec.toml").write_text(LIMITS)
    return here


@pytest.fixture(scope="module")
def ask(folder: Path) -> Ask:
    """Run a command on the store."""

    def run(*words: object, code: int = 0) -> Result:
        done = CliRunner().invoke(main, [*(str(word) for word in words), "--store", str(folder / "S")])
        assert done.exit_code == code, (done.output, done.exception)
        return done

    return run


@pytest.fixture(scope="module")
def specified(ask: Ask, folder: Path) -> Ask:
    """The same, once the store has limits."""
    assert "spec-A: 2 limits, 0 products kept" in ask("limits", "add", folder / "spec.toml").stdout
    return ask


def test_json_is_a_list_of_values_and_reasons(ask: Ask) -> None:
    rows = json.loads(ask("metrics", "--json").stdout)
    assert all(set(row) == KEYS for row in rows)
    assert all((row["value"] is None) == (row["reason"] is not None) for row in rows)
    (bias,) = [
        row for row in rows
        if row["metric"] == "bias" and row["unit"] == "FOG-0002" and row["parameters"]["earth_rate"] == "none"
    ]  # fmt: skip
    assert bias["lo"] < 5.0 < bias["hi"]
    assert (bias["n"], bias["run"], bias["runs"], bias["unit_of_measure"]) == (4000, "long", ["long"], "deg/h")
    assert (bias["standard"], bias["clause"]) == ("GJB2426A, JJF2014", "5.12.1 (19); 7.2.13 (27)(28)")
    (short,) = [row for row in rows if row["metric"] == "bias" and row["unit"] == "FOG-0003"]
    assert short["value"] == pytest.approx(0.0, abs=0.2)
    assert short["parameters"]["remark"].split("; ") == [
        "record of 149 s: the clauses ask for one hour as a rule",
        "no position says how the input axis lies: it is not known how much of the Earth's rate is in it",
    ]


@pytest.mark.long
def test_a_selection_leaves_the_rest_out(ask: Ask) -> None:
    def reported(*words: object) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = json.loads(ask("metrics", "--json", *words).stdout)
        return rows

    everything = reported()
    for words, holds in (
        (("--unit", "FOG-0001"), lambda row: row["unit"] == "FOG-0001"),
        (("--unit", "FOG-0001", "--unit", "FOG-0003"), lambda row: row["unit"] != "FOG-0002"),
        (("--run", "short"), lambda row: row["run"] == "short"),
        (("--metric", "bias", "--metric", "bias_stability"), lambda row: row["metric"] in {"bias", "bias_stability"}),
        (("--since", "2026-01-05"), lambda _: True),
        (("--since", "2026-01-05T16:00:00+08:00"), lambda _: True),
        (("--since", "2026-01-06"), lambda _: False),
    ):
        assert reported(*words) == [row for row in everything if holds(row)], words
    jjf = reported("--standard", "JJF 2014-2022", "--metric", "bias")
    assert {(row["standard"], row["clause"]) for row in jjf} == {("JJF2014", "7.2.13 (27)(28)")}
    assert reported("--standard", "gjb2426a", "--metric", "bias")[0]["clause"] == "5.12.1 (19)"


@pytest.mark.in_gate(
    "words6---since 'yesterday' is not a moment",
    "words8---annex-a stands alone",
    "words5-the metrics are of GJB2426A-2004, not of GJB2426A-2015",
    "words7-has no time zone",
    "words0-there is no metric 'bais'; did you mean bias?",
    "words4-no metric is of the standard 'GJB 2427'; there are CN102680005, GJB2426A",
)
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--metric", "bais"), "there is no metric 'bais'; did you mean bias?"),
        (("--unit", "fog-0001"), "unit 'fog-0001' is in the store; did you mean FOG-0001?"),
        (("--run", "longer"), "did you mean long?"),
        (("--lot", "L1"), "lot 'L1'"),
        (("--standard", "GJB 2427"), "no metric is of the standard 'GJB 2427'; there are CN102680005, GJB2426A"),
        (("--standard", "GJB2426A-2015"), "the metrics are of GJB2426A-2004, not of GJB2426A-2015"),
        (("--since", "yesterday"), "--since 'yesterday' is not a moment"),
        (("--since", "2026-01-05T08:00"), "has no time zone"),
        (("--annex-a", "FOG-0001", "--unit", "FOG-0001"), "--annex-a stands alone"),
        (("--annex-a", "FOG-9"), "unit 'FOG-9'"),
        (("--csv", "/nowhere/x.csv"), "cannot write /nowhere/x.csv"),
        (("--xlsx", "/nowhere/x.xlsx"), "cannot write /nowhere/x.xlsx"),
    ],
)
def test_what_is_not_there_is_refused_and_named(ask: Ask, words: tuple[str, ...], said: str) -> None:
    done = ask("metrics", *words, "--json", code=1)
    assert said in json.loads(done.stdout)["error"]["message"]


@pytest.mark.long
def test_the_table_speaks_both_languages(ask: Ask) -> None:
    english = ask("metrics", "--unit", "FOG-0001").stdout
    chinese = ask("metrics", "--unit", "FOG-0001", "--lang", "zh").stdout
    assert "Bias" in english
    assert "GJB2426A-2004 5.12.1" in english
    assert "零偏" in chinese
    assert "参数" in chinese


def test_a_csv_file_holds_the_same(ask: Ask, tmp_path: Path) -> None:
    rows = json.loads(ask("metrics", "--json", "--csv", tmp_path / "m.csv").stdout)
    kept = list(csv.DictReader(io.StringIO((tmp_path / "m.csv").read_text(encoding="utf-8-sig"))))
    assert len(kept) == len(rows)
    for row, reported in zip(kept, rows, strict=True):
        assert row["metric"] == reported["metric"]
        assert row["value"] == ("" if reported["value"] is None else repr(reported["value"]))
        assert json.loads(row["parameters"]) == reported["parameters"]
    assert [path.name for path in tmp_path.iterdir()] == ["m.csv"]
    # titles, reasons and remarks are in the language that is asked for
    ask("metrics", "--csv", tmp_path / "zh.csv", "--lang", "zh")
    chinese = list(csv.DictReader(io.StringIO((tmp_path / "zh.csv").read_text(encoding="utf-8-sig"))))
    assert [row["代号"] for row in chinese] == [row["metric"] for row in rows]
    short = [row for row in chinese if row["产品编号"] == "FOG-0003"]
    reasons = {row["无数值的原因"] for row in short if row["代号"] == "bias_stability_averaged"}
    assert "记录中有 1 个 100 s 平均值，至少需要 2 个" in reasons
    (bias,) = [row for row in short if row["代号"] == "bias"]
    remark = "记录长 149 s：条款一般要求一小时；未给出位置，输入轴方向未知：其中含有多少地球自转分量未知"
    assert json.loads(bias["参数"])["remark"] == remark
    assert bias["无扩展不确定度的原因"].startswith("B类未知：转台速率(各速率共同误差)：试验台未给出")


@pytest.mark.long
def test_a_workbook_holds_numbers_as_numbers(ask: Ask, tmp_path: Path) -> None:
    ask("metrics", "--metric", "bias", "--xlsx", tmp_path / "m.xlsx", "--lang", "zh")
    rows = json.loads(ask("metrics", "--metric", "bias", "--json").stdout)
    space = {"m": "http://schemas.openxmlformats.org/spreadsheetml/2006/main"}
    with zipfile.ZipFile(tmp_path / "m.xlsx") as book:
        sheet = ET.fromstring(book.read("xl/worksheets/sheet1.xml"))
        texts = ["".join(each.itertext()) for each in ET.fromstring(book.read("xl/sharedStrings.xml"))]
    numbers = {
        cell.attrib["r"]: float(cell.findtext("m:v", "nan", space))
        for cell in sheet.iterfind(".//m:c", space)
        if cell.attrib.get("t") is None and cell.find("m:v", space) is not None
    }
    assert len(sheet.findall(".//m:row", space)) == len(rows) + 1
    assert {"特性", "零偏", "FOG-0001"} <= set(texts)
    # value is the sixth column
    # 16 digits, as workbooks hold them
    assert [numbers.get(f"F{i}") for i, _ in enumerate(rows, 2)] == pytest.approx(
        [row["value"] for row in rows], rel=1e-15
    )
    assert [path.name for path in tmp_path.iterdir()] == ["m.xlsx"]


def test_that_nothing_is_of_what_was_asked_for_is_said(ask: Ask) -> None:
    assert ask("metrics", "--since", "2030-01-01").stdout.startswith("no metric matches the selection")


def test_an_empty_workbook_is_not_written_without_a_word(ask: Ask, tmp_path: Path) -> None:
    reported = ask("metrics", "--since", "2030-01-01", "--xlsx", tmp_path / "m.xlsx").stderr
    assert "0 rows written" in reported
    assert "no metric matches the selection" in " ".join(reported.split())


@pytest.mark.long
def test_annex_a_has_its_24_rows_whatever_was_measured(ask: Ask) -> None:
    reported = json.loads(ask("metrics", "--annex-a", "FOG-0002", "--json").stdout)
    rows = reported["rows"]
    assert (reported["unit"], reported["standard"]) == ("FOG-0002", "JJF2014")
    assert [row["number"] for row in rows] == list(range(1, 25))
    assert (rows[0]["zh"], rows[13]["zh"], rows[23]["zh"]) == ("标度因数", "零偏", "启动时间")
    assert all(bool(row["results"]) != bool(row["reason"]) for row in rows)
    assert all(each["standard"] == "JJF2014" for row in rows for each in row["results"])
    assert rows[13]["results"][0]["lo"] < 5.0 < rows[13]["results"][0]["hi"]
    assert {each["parameters"]["average_s"] for each in rows[14]["results"]} == {1, 10, 100}
    assert rows[21]["reason"].startswith("no completed step gives it: it needs ")
    shown = ask("metrics", "--annex-a", "FOG-0002", "--lang", "zh").stdout
    assert "7.2.5" in shown  # a row without a value has its clause too
    assert "校准项目" in shown
    assert "输入轴失准角重复性" in shown


def test_verdicts_by_unit_and_by_station(specified: Ask) -> None:
    reported = json.loads(specified("verdicts", "--json").stdout)
    assert {row["unit"]: row["verdict"] for row in reported["units"]} == {
        "FOG-0001": "PASS", "FOG-0002": "FAIL", "FOG-0003": "NO_DATA",
    }  # fmt: skip
    failed = [row for row in reported["verdicts"] if row["verdict"] == "FAIL"]
    assert [(row["unit"], row["metric"], row["upper"], row["revision"]) for row in failed] == [
        ("FOG-0002", "bias", 1.0, "A")
    ]
    assert [row["metric"] for row in reported["pareto"]] == ["bias"]
    assert reported["warnings"] == []
    (bench,) = json.loads(specified("verdicts", "--by", "station", "--json").stdout)["yield"]
    assert (bench["name"], bench["units"], bench["passed"], bench["yield"]) == ("bench-1", 3, 1, 0.5)
    shown = " ".join(specified("verdicts", "--by", "station", "--fail-on-fail", code=3).stdout.split())
    assert "The yield is of units that were judged: 1 of 3 are NO_DATA and not in it" in shown
    specified("verdicts", "--fail-on-fail", "--unit", "FOG-0001")
    shown = specified("verdicts", "--lang", "zh", "--unit", "FOG-0002").stdout
    assert "不合格：零偏" in shown
    assert "FOG-0002" in shown
    remarks = "".join(specified("verdicts", "--lang", "zh", "--unit", "FOG-0003").stdout.split())
    assert "记录长149" in remarks
    assert "asarule" not in remarks


@pytest.mark.long
def test_verdicts_of_all_units_fail_where_one_does_and_speak_chinese(specified: Ask) -> None:
    specified("verdicts", "--fail-on-fail", code=3)
    assert "不合格：零偏" in specified("verdicts", "--lang", "zh").stdout
    assert "FOG-0002" in specified("verdicts", "--unit", "FOG-0002").stdout


def test_specifications_are_listed_shown_and_refused(specified: Ask, folder: Path) -> None:
    assert "are there already" in specified("limits", "add", folder / "spec.toml").stdout
    (listed,) = json.loads(specified("limits", "list", "--json").stdout)
    assert (listed["specification"], listed["revision"], listed["limit_count"]) == ("spec", "A", 2)
    assert specified("limits", "show", "spec", "--toml").stdout == LIMITS
    assert "零偏稳定性" in specified("limits", "show", "spec-A", "--lang", "zh").stdout
    (folder / "other.toml").write_text(LIMITS.replace('"bias"', '"baïs"'))
    message = json.loads(specified("limits", "add", folder / "other.toml", "--json", code=1).stdout)["error"]["message"]
    assert "other.toml: line 3, $.limit[0]" in message
    assert "no metric 'baïs'" in message


@pytest.mark.long
def test_a_serial_that_was_never_recorded_is_entered_with_a_warning_and_does_not_pass(specified: Ask) -> None:
    words = ("--item", "visual", "--by", "Li", "--verdict", "pass")
    assert "is in the store as 'FOG-0001'" in specified("check", "--unit", "fog-0001", *words, code=1).output
    known = json.loads(specified("check", "--unit", "FOG-0001", *words, "--json").stdout)
    assert (known["unit_is_known"], known["warnings"]) == (True, [])
    for _ in range(2):  # a check does not make a serial number known
        done = specified("check", "--unit", "FOG-0O01", *words, "--json")
    reported = json.loads(done.stdout)
    assert reported["unit_is_known"] is False
    assert "nothing was recorded of unit 'FOG-0O01'" in reported["warnings"][0]
    assert "which has FOG-0001" in reported["warnings"][0]
    assert "it can fail the unit, which passes only when its limits are judged" in reported["warnings"][0]
    judged = json.loads(specified("verdicts", "--json").stdout)
    units = {row["unit"]: row for row in judged["units"]}
    assert (units["FOG-0001"]["verdict"], units["FOG-0001"]["passed"]) == ("PASS", 3)
    assert (units["FOG-0O01"]["verdict"], units["FOG-0O01"]["passed"]) == ("NO_DATA", 1)
    assert units["FOG-0O01"]["lacking"] == ["bias", "bias_stability_averaged"]


@pytest.mark.long
def test_an_empty_store_has_nothing_to_tell(tmp_path: Path) -> None:
    folder = str(tmp_path / "S")
    assert CliRunner().invoke(main, ["metrics", "--store", folder]).exit_code == 1
    done = CliRunner().invoke(main, ["check", "--store", folder, "--unit", "U1", "--item", "visual", "--by", "Li",
                                     "--verdict", "FAIL"])  # fmt: skip
    assert done.exit_code == 0, done.output
    reported = json.loads(CliRunner().invoke(main, ["verdicts", "--store", folder, "--json"]).stdout)
    assert [(row["unit"], row["verdict"]) for row in reported["units"]] == [("U1", "FAIL")]


@pytest.mark.long
def test_a_visual_check_alone_passes_no_unit(tmp_path: Path) -> None:
    folder = str(tmp_path / "S")
    words = ["check", "--store", folder, "--unit", "NOPE-9", "--item", "visual", "--by", "Li", "--verdict", "pass"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    assert "warning: nothing was recorded of unit 'NOPE-9'" in done.stderr
    (unit,) = json.loads(CliRunner().invoke(main, ["verdicts", "--store", folder, "--json"]).stdout)["units"]
    assert unit["verdict"] == "NO_DATA"
    assert unit["reason"].startswith("the store has no limits")


def test_a_workbook_in_chinese_has_columns_wide_enough(ask: Ask, tmp_path: Path) -> None:
    ask("metrics", "--unit", "FOG-0001", "--metric", "bias", "--lang", "zh", "--xlsx", tmp_path / "m.xlsx")
    with zipfile.ZipFile(tmp_path / "m.xlsx") as book:
        sheet = book.read("xl/worksheets/sheet1.xml").decode()
        texts = book.read("xl/sharedStrings.xml").decode()
    columns = re.findall(r'<col min="(\d+)" max="(\d+)" width="([\d.]+)"', sheet)
    widths = {at: float(width) for first, last, width in columns for at in range(int(first), int(last) + 1)}
    titles = ["特性", *(_title(texts, each) for each in ("代号", "产品编号", "信号", "试验", "数值"))]
    for at, title in enumerate(titles, 1):
        assert widths[at] >= 2 * len(title) + 3
    assert "GJB2426A-2004, JJF2014-2022" in texts


def _title(texts: str, title: str) -> str:
    assert f">{title}<" in texts
    return title
