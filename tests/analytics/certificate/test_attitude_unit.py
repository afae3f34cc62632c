"""The certificate of an attitude unit: clause 8 and annex C of JJF 1536-2015 in both languages, drafts, deviations."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.certificate.statement.standards import standards
from analytics.evaluation.inner_page import inner_page_titles
from tests.analytics.certificate.conftest import ORDER, STATION
from tests.analytics.certificate.pdf_checks import (
    fonts_that_are_not_embedded,
    is_archivable,
    lacking_items,
    pages_of,
    plain,
)
from tests.attitude_unit_files import Sheet, four_positions, ramp, turns

UNIT = "AHRS-3"
ANGLES = {axis: f"angle_{axis.lower()}[deg]" for axis in "XYZ"}
BIASES = {"X": 6.0, "Y": -3.0, "Z": 1.5}
MATRIX = {"XY": 0.002, "XZ": -0.001, "YX": 0.003, "YZ": -0.002, "ZX": 0.0015, "ZY": -0.0025}
WORDS = ("procedure", "axis", "position", "step", "rate_command[deg/s]")
STATED = 'deviations = { en = "one sample a second, as agreed", zh = "按约定每秒采样一次" }'
MORE = 'mounting = { U = 5.0, k = 2.0, unit = "arcsec" }\n'


@pytest.fixture(scope="module")
def lab(run_command: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a store `lab` of one calibrated unit, and another measured with a table that was out of date."""
    return calibrated(run_command, tmp_path_factory.mktemp("attitude_lab"), {UNIT: "KLB", "AHRS-4": "L"})


@pytest.fixture(scope="module", params=["B", pytest.param("KLB", marks=pytest.mark.long)])
def sampled_slowly(
    request: pytest.FixtureRequest, run_command: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Such a folder with the unit alone, and in the gate only with the sheet that is sampled once a second."""
    if request.param == "KLB":
        return Path(request.getfixturevalue("lab"))
    return calibrated(run_command, tmp_path_factory.mktemp("attitude_slow"), {UNIT: request.param})


def calibrated(run_command: Callable[..., Any], folder: Path, units: dict[str, str]) -> Path:
    rng = np.random.default_rng(1536)
    turning, standing, rating = (Sheet(ANGLES, WORDS, dt_s=dt_s) for dt_s in (0.1, 1.0, 1.0))
    turns(turning, MATRIX, BIASES)
    four_positions(standing, BIASES)
    for axis in "XYZ":
        for rate in (0.0, 10.0, -10.0, 25.0, -25.0, 63.0, -63.0, 100.0, -100.0, 0.0):
            samples = {
                each: ramp(rate * 20.0 if each == axis else 0.0, 20) + rng.normal(0.0, 1e-5, 21) for each in ANGLES
            }
            words = {"axis": axis, "position": f"{axis}_up", "rate_command": rate, "step": "rate" if rate else "rest"}
            rating.step(samples, procedure="attitude_unit_scale_factor", **words)
    (folder / "station.toml").write_text(STATION + MORE, encoding="utf-8")
    (folder / "old.toml").write_text((STATION + MORE).replace("2026-09-30", "2026-01-31"), encoding="utf-8")
    (folder / "none.toml").write_text(ORDER, encoding="utf-8")
    stated = "\n".join(STATED if line.startswith("deviations") else line for line in ORDER.splitlines())
    (folder / "order.toml").write_text(stated, encoding="utf-8")
    (folder / "nobody.toml").write_text(stated.partition("[people]")[0], encoding="utf-8")
    sheets = {"K": rating, "L": turning, "B": standing}
    for unit, names in units.items():
        station = "station.toml" if unit == UNIT else "old.toml"
        for day, name in enumerate(names, start=2):
            done = run_command(
                "import", sheets[name].write(folder / f"{name}.csv"), "--unit", unit, "--run", f"{name}-{unit}",
                "--start", f"2026-03-0{day}T09:00:00+08:00", "--station", station, "--store", "lab", cwd=folder,
            )  # fmt: skip
            assert done.code == 0, done.err
    return folder


def written(run_command: Callable[..., Any], lab: Path, order: str, out: str, *more: str, unit: str = UNIT) -> Any:
    words = ("certificate", "--unit", unit, "--standard", "JJF1536", "--order", order, "--out", out)
    done = run_command(*words, "--store", "lab", "--json", *more, cwd=lab)
    assert done.code == 0, done.err
    return done.json


@pytest.mark.long
@pytest.mark.parametrize("language", ["zh", "en"])
def test_every_item_of_clause_8_and_every_row_of_annex_c_is_printed(
    lab: Path, run_command: Callable[..., Any], language: str
) -> None:
    answer = written(run_command, lab, "order.toml", f"{language}.pdf", "--lang", language, "--draft")
    assert answer["missing"] == []
    text = "".join(pages_of(lab / f"{language}.pdf"))
    assert lacking_items(text, standards()["JJF1536"], language) == []
    names = [getattr(title, language) for title in inner_page_titles("JJF1536")]
    assert len(names) == 12
    assert [name for name in names if plain(name) not in text] == []
    assert {"zh": "未校准", "en": "notcalibrated"}[language] not in text
    for each in ("10.313", "6.000", "T-881", "2025-RT-0113", UNIT):
        assert each in text, each
    departure = {"zh": "1次/s：7.2.1要求不少于10", "en": "1samples/s:7.2.1asksforatleast10"}[language]
    assert departure in text
    assert fonts_that_are_not_embedded(lab / f"{language}.pdf") == []
    assert is_archivable(lab / f"{language}.pdf")


def test_deviations_that_the_order_denies_make_a_draft(sampled_slowly: Path, run_command: Callable[..., Any]) -> None:
    answer = written(run_command, sampled_slowly, "none.toml", "denied.pdf")
    assert answer["is_draft"]
    assert any("samples/s: 7.2.1 asks for at least 10" in each for each in answer["deviations"])
    (missing,) = answer["missing"]
    assert missing.startswith("the order states no deviation, and the records depart from the clause")


@pytest.mark.long
@pytest.mark.parametrize(("language", "mark"), [("zh", "草稿"), ("en", "DRAFT")])
def test_a_missing_item_gives_a_watermark_on_every_page(
    lab: Path, run_command: Callable[..., Any], language: str, mark: str
) -> None:
    answer = written(run_command, lab, "nobody.toml", "nobody.pdf", "--lang", language)
    assert answer["is_draft"]
    clauses = {each.partition(":")[0] for each in answer["missing"]}
    assert clauses == {"8 k", "8 l"}
    pages = pages_of(lab / "nobody.pdf")
    assert all(mark in page for page in pages)
    for number, page in enumerate(pages, start=1):
        assert f"{number}/{len(pages)}" in page


@pytest.mark.long
def test_a_table_out_of_date_refuses(lab: Path, run_command: Callable[..., Any]) -> None:
    answer = written(run_command, lab, "order.toml", "old.pdf", unit="AHRS-4")
    assert answer["is_draft"]
    assert any("was valid until 2026-01-31; it was used until 2026-03-02" in each for each in answer["missing"])
    assert any("no expanded uncertainty" in each for each in answer["missing"])


@pytest.mark.long
def test_a_whole_one_is_issued_in_both_languages(lab: Path, run_command: Callable[..., Any]) -> None:
    answer = written(run_command, lab, "order.toml", "both.pdf", "--lang", "both")
    assert (answer["is_draft"], answer["missing"], answer["compensated"]) == (False, [], [])
    text = "".join(pages_of(lab / "both.pdf"))
    for each in ("草稿", "DRAFT"):
        assert each not in text
    for each in (answer["number"], "校准证书", "Calibrationcertificate", "按约定每秒采样一次"):
        assert each in text
    found = run_command("certificate", "verify", "both.pdf", "--store", "lab", "--json", cwd=lab)
    assert (found.code, found.json["genuine"], found.json["valid"], found.json["changed"]) == (0, True, True, [])
