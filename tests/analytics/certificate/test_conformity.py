"""The statement of conformity of a certificate: results against a specification, with the decision rule."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from analytics.certificate.statement.results import rounded_to
from analytics.uncertainty.rounding import round_up
from tests.analytics.certificate.conftest import ORDER, ORDERED, UNIT
from tests.analytics.certificate.pdf_checks import pages_of

DCC = {"dcc": "https://ptb.de/dcc"}


@pytest.fixture(scope="module")
def judged(
    certified: tuple[Path, dict[str, Any]], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, Any]]:
    """A certificate with a statement of conformity, and what the command answered."""
    return Path(shutil.copytree(certified[0], tmp_path_factory.mktemp("judged") / "copy")), certified[1]


def printed(pdf: Path) -> str:
    """All text without white space, which a PDF does not keep."""
    return "".join("".join(pages_of(pdf)).split())


def test_outcome_limits_and_decision_rule_are_stated(
    judged: tuple[Path, dict[str, Any]], run_command: Callable[..., Any]
) -> None:
    folder, answer = judged
    assert not answer["is_draft"], answer["missing"]
    given = run_command("verdicts", "--unit", UNIT, "--store", "lab", "--json", cwd=folder).json["verdicts"]
    of = {row["metric"]: row for row in given if row["specification"] == "VG-20" and row["value"] is not None}
    assert (of["scale_factor"]["verdict"], of["bias"]["verdict"]) == ("PASS", "FAIL")
    text = printed(folder / "signed.pdf")
    assert "VG-20,A" in text
    assert "0.999...1.001:conforms" in text
    (stated,) = [
        row
        for row in run_command("metrics", "--unit", UNIT, "--store", "lab", "--json", cwd=folder).json
        if row["metric"] == "scale_factor" and row["standard"] == "JJF2014"
    ]
    as_printed = round_up(stated["U"])
    assert of["scale_factor"]["guard"] == as_printed != stated["U"], "rebuilt from the U that is printed"
    assert f"guardband{rounded_to(as_printed, as_printed)}(1U)" in text
    assert "amultipleofUasitisstated" in text
    assert "guardedacceptance(JCGM106,8.3.2)" in text
    assert "-0.5...0.5°/h:doesnotconform" in text
    left = text.partition("Notjudgedhere")[2]
    assert "Anglerandomwalk" in left
    assert "angle_random_walk" not in left
    assert "alltoNIM" in text, "the order states the traceability"


def test_the_digital_certificate_has_it(judged: tuple[Path, dict[str, Any]]) -> None:
    folder, _ = judged
    root = ET.fromstring((folder / "signed.xml").read_bytes())
    found = [each.findtext("dcc:conformity", "", DCC) for each in root.iterfind(".//dcc:statement", DCC)]
    assert sorted(each for each in found if each) == ["fail", "pass"]
    declared = [each.text or "" for each in root.iterfind(".//dcc:statement/dcc:declaration/dcc:content", DCC)]
    assert [each for each in declared if each.startswith("Not judged here: Angle random walk")] != []
    assert [each for each in declared if each.startswith("未在此判定：角度随机游走系数")] != []


def test_a_statement_that_no_longer_holds_is_named(
    certified: tuple[Path, dict[str, Any]], run_command: Callable[..., Any], tmp_path: Path
) -> None:
    """The scale factor, 50 ppm above 1, conforms by revision A, does not by B, and A is withdrawn as wrong."""
    folder = Path(shutil.copytree(certified[0], tmp_path / "copy"))
    text = (folder / "limits.toml").read_text().replace('"A"', '"B"').replace("2026-01-01", "2026-01-02")
    (folder / "limits.toml").write_text(text.replace("1.001", "1.00001"))
    by = ("--reason", "typed wrong", "--by", "Wu", "--store", "lab")
    assert run_command("limits", "revise", "limits.toml", "--rejudge", *by, cwd=folder).code == 0
    assert run_command("limits", "withdraw", "VG-20-A", *by, cwd=folder).code == 0
    done = run_command("certificate", "verify", "signed.pdf", "--store", "lab", "--json", cwd=folder)
    withdrawn, judged = done.json["changed"]
    text = run_command("certificate", "verify", "signed.pdf", "--store", "lab", cwd=folder).out
    assert ": genuine; the store computes or judges it differently today: certificate " in text
    assert "genuine and valid" not in text
    assert (done.code, done.json["genuine"], done.json["valid"]) == (1, True, True)
    assert withdrawn.startswith("conformity is stated by VG-20-A; VG-20-A was withdrawn on ")
    assert withdrawn.endswith(" by Wu: typed wrong")
    assert judged.startswith("Scale factor (rate, ")
    assert "0.999 ... 1.001: conforms" in judged
    assert "as stated by revision A; the store gives 0.999 ... 1.00001: does not conform" in judged
    assert judged.endswith(", by revision B")


@pytest.mark.long  # in the gate among other faults of an order
def test_a_specification_that_judges_nothing_makes_a_draft(
    judged: tuple[Path, dict[str, Any]], run_command: Callable[..., Any]
) -> None:
    folder, _ = judged
    (folder / "other.toml").write_text(f'{ORDER}\n[conformity]\nspecification = "VG-21"\n', encoding="utf-8")
    words = [each if each != "order.toml" else "other.toml" for each in ORDERED]
    done = run_command(*words, "--out", "d.pdf", cwd=folder)
    assert done.json["is_draft"]
    assert any("VG-21" in each for each in done.json["missing"])


@pytest.mark.long
def test_without_agreed_interval_none_is_recommended_and_none_ends(
    laboratory: Path, run_command: Callable[..., Any], tmp_path: Path
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(laboratory, folder)
    (folder / "order.toml").write_text(ORDER.replace("valid_months = 12\n", ""), encoding="utf-8")
    done = run_command(*ORDERED, "--out", "c.pdf", cwd=folder)
    assert (done.code, done.json["valid_until"]) == (0, None), done.err
    assert "Recommended" not in printed(folder / "c.pdf")
    found = run_command("certificate", "verify", "c.pdf", "--store", "lab", "--json", cwd=folder)
    assert (found.code, found.json["valid"], found.json["valid_until"]) == (0, True, None)


@pytest.mark.long  # in the gate among other faults of an order
def test_traceability_is_asked_for(laboratory: Path, run_command: Callable[..., Any], tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(laboratory, folder)
    station = (folder / "station.toml").read_text(encoding="utf-8")
    (folder / "station.toml").write_text(station.replace('traceable_to = "NIM, rate"\n', ""), encoding="utf-8")
    for name, at in (("scale.csv", "09"), ("bias.csv", "13")):
        done = run_command(
            "import", name, "--unit", UNIT, "--station", "station.toml", "--restate", "--start",
            f"2026-03-02T{at}:00:00+08:00", "--store", "lab", cwd=folder,
        )  # fmt: skip
        assert done.code == 0, done.err
    lacking = run_command(*ORDERED, "--out", "c.pdf", cwd=folder).json
    assert [each for each in lacking["missing"] if "traceab" in each] != [], lacking
    assert "rate table" in json.dumps(lacking["missing"])
    (folder / "order.toml").write_text('traceability = "all to NIM"\n' + ORDER, encoding="utf-8")
    assert not run_command(*ORDERED, "--out", "c.pdf", cwd=folder).json["is_draft"]
    assert "alltoNIM" in printed(folder / "c.pdf")
