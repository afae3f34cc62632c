"""A draft: every clause of the standard is in the PDF, and what is missing is listed first."""

import datetime as dt
import shutil
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import msgspec
import pytest
from pypdf import PdfReader

from analytics.certificate.statement.content import FILLED_BY
from analytics.certificate.statement.evidence import Recorded
from analytics.certificate.statement.references import Reference, contradictions
from analytics.certificate.statement.results import rounded_to
from analytics.certificate.statement.standards import standards
from analytics.certificate.statement.words import Words, clause_in_chinese
from tests.analytics.certificate.conftest import ORDER, UNIT
from tests.analytics.certificate.pdf_checks import fonts_that_are_not_embedded, is_archivable


def text_of(path: Path) -> str:
    return "\n".join(page.extract_text() for page in PdfReader(BytesIO(path.read_bytes())).pages)


def test_each_item_of_a_standard_is_filled() -> None:
    for standard in standards().values():
        assert {item.filled_by for item in standard.items} <= FILLED_BY.keys()
        assert len({item.filled_by for item in standard.items}) == len(standard.items)


@pytest.mark.long
def test_without_an_order_a_draft_lists_what_is_missing(
    laboratory: Path, run_command: Callable[..., Any], tmp_path: Path
) -> None:
    out = tmp_path / "draft.pdf"
    words = ("certificate", "--unit", UNIT, "--standard", "JJF 2014-2022", "--out", out, "--lang", "en", "--json")
    done = run_command(*words, "--store", laboratory / "lab", cwd=tmp_path)
    assert done.code == 0, done.err
    assert done.json["is_draft"]
    assert done.json["number"] is None
    missing = done.json["missing"]
    for clause in ("8 b", "8 e", "8 k", "8 m", "8 n", "annex A"):
        assert any(each.startswith(f"{clause}: ") for each in missing), clause
    text = text_of(out)
    assert "DRAFT" in text
    assert "name of the laboratory is not given" in text


@pytest.mark.parametrize(
    ("given", "then", "missing"),
    [
        ("[20.4, 21.1]", "[20.4, 51.1]", "temperature was outside 15 - 25 °C: state the deviation"),
        ("2026-02-27", "2026-03-27", "it was received on 2026-03-27, after the first run of 2026-03-02"),
    ],
)
@pytest.mark.long  # in the gate among other faults of an order
def test_an_order_that_contradicts_the_clause_or_the_runs_makes_a_draft(
    laboratory: Path, run_command: Callable[..., Any], tmp_path: Path, given: str, then: str, missing: str
) -> None:
    """Its deviations are "none", which states none."""
    (tmp_path / "order.toml").write_text(ORDER.replace(given, then), encoding="utf-8")
    words = ("certificate", "--unit", UNIT, "--standard", "JJF2014", "--order", "order.toml", "--out", "new.pdf")
    done = run_command(*words, "--draft", "--lang", "en", "--store", laboratory / "lab", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    assert any(missing in each for each in done.json["missing"]), done.json["missing"]


def test_faults_of_an_order_are_listed_together(
    laboratory: Path, run_command: Callable[..., Any], tmp_path: Path
) -> None:
    """Dates and air that contradict, a specification that judges nothing, a standard of no stated traceability."""
    order = ORDER.replace("2026-02-27", "2026-03-27").replace("[20.4, 21.1]", "[20.4, 51.1]")
    more = '[conformity]\nspecification = "VG-21"\n[[reference]]\nname = "gauge"\nserial = "7"\ncertificate = "C-7"\n'
    more += 'due = 2027-05-31\nuncertainty = "U = 1, k = 2"\n'
    (tmp_path / "order.toml").write_text(f"{order}\n{more}", encoding="utf-8")
    words = ("certificate", "--unit", UNIT, "--standard", "JJF2014", "--order", "order.toml", "--out", "new.pdf")
    done = run_command(*words, "--lang", "en", "--store", laboratory / "lab", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    assert done.json["is_draft"]
    for expected in (
        "it was received on 2026-03-27, after the first run of 2026-03-02",
        "temperature was outside 15 - 25 °C: state the deviation", "VG-21", "traceability is not stated of gauge",
    ):  # fmt: skip
        assert any(expected in each for each in done.json["missing"]), (expected, done.json["missing"])


@pytest.mark.parametrize("language", ["zh", "en"])
@pytest.mark.in_gate("zh")
def test_every_item_of_clause_8_and_annex_a_is_printed(
    laboratory: Path, run_command: Callable[..., Any], tmp_path: Path, language: str
) -> None:
    out = tmp_path / f"{language}.pdf"
    words = ("certificate", "--unit", UNIT, "--standard", "JJF2014", "--order", "order.toml", "--out", out, "--draft")
    done = run_command(*words, "--lang", language, "--store", "lab", "--json", cwd=laboratory)
    assert done.code == 0, done.err
    text = "".join(text_of(out).split())
    standard = standards()["JJF2014"]
    for item in standard.items:
        if item.filled_by not in {"title", "number", "conformity"}:
            assert "".join(getattr(item, language).split()) in text
            clause = clause_in_chinese(item.clause) if language == "zh" else item.clause
            assert "".join(clause.split()) in text
    expected = {
        "zh": "校准证书 陀螺校准实验室 示例航天有限公司 标度因数 启动时间 JJF2014-2022 王力 T-881",
        "en": "Calibrationcertificate ExampleAerospaceLtd Scalefactor Start-uptime ChenGang T-881",
    }
    for each in (UNIT, *expected[language].split()):
        assert each in text
    # 24 rows, those without a result too
    not_calibrated = {"zh": "未校准", "en": "notcalibrated"}[language]
    assert text.count(not_calibrated) == sum(row["results"] == [] for row in annex(laboratory, run_command))


def annex(laboratory: Path, run_command: Callable[..., Any]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = run_command(
        "metrics", "--annex-a", UNIT, "--store", "lab", "--json", cwd=laboratory
    ).json["rows"]
    assert len(rows) == 24
    return rows


@pytest.mark.long
def test_the_file_is_pdf_a_with_the_digital_certificate_in_it(
    laboratory: Path, run_command: Callable[..., Any], tmp_path: Path
) -> None:
    out = tmp_path / "a.pdf"
    words = ("certificate", "--unit", UNIT, "--standard", "JJF2014", "--order", "order.toml", "--out", out, "--draft")
    done = run_command(*words, "--store", "lab", "--json", cwd=laboratory)
    reader = PdfReader(BytesIO(out.read_bytes()))
    assert reader.xmp_metadata is not None
    assert b"<pdfaid:part>3</pdfaid:part>" in out.read_bytes()
    assert is_archivable(out)
    assert fonts_that_are_not_embedded(out) == []
    ((name, contents),) = reader.attachments.items()
    assert name == "certificate.xml"
    assert contents[0] == Path(done.json["digital"]).read_bytes()


@pytest.mark.long
def test_a_unit_that_is_not_there_and_a_standard_without_certificates_are_refused(
    laboratory: Path, run_command: Callable[..., Any], tmp_path: Path
) -> None:
    words = ("certificate", "--out", tmp_path / "x.pdf", "--store", laboratory / "lab")
    for more, expected in (
        (("--unit", "G-0043", "--standard", "JJF2014"), "G-0042"),
        (("--unit", UNIT, "--standard", "ISO 9001"), "JJF2014"),
        (("--unit", UNIT), "--standard"),
    ):
        done = run_command(*words, *more, cwd=tmp_path)
        assert done.code == 1
        assert expected in done.err
        assert not (tmp_path / "x.pdf").exists()


def test_standards_and_surroundings_are_those_of_each_run() -> None:
    """A table renewed between two runs has not expired; one stated in two ways, or air of one run, is not whole."""
    table = Reference(
        name=Words("rate table", "转台"), serial="RT-17", certificate="A", due=dt.date(2026, 11, 25),
        uncertainty=Words("U", "U"), used_until=dt.date(2026, 11, 24),
    )  # fmt: skip
    renewed = msgspec.structs.replace(
        table, certificate="B", due=dt.date(2027, 11, 25), used_until=dt.date(2026, 11, 26)
    )
    ended = dt.date(2026, 11, 26)
    assert table.missing(ended) == renewed.missing(ended) == []
    assert contradictions([table, renewed]) == []
    late = msgspec.structs.replace(table, used_until=ended)
    assert "valid until 2026-11-25" in late.missing(ended)[0].en
    other = msgspec.structs.replace(table, due=dt.date(2027, 3, 31))
    assert len(contradictions([table, other])) == 1
    air = Recorded(span=(22.8, 23.1), runs=1)
    assert (air.is_whole(1), air.is_whole(3)) == (True, False)
    assert air.beside((8.0, 33.0)) == (8.0, 33.0)
    assert air.beside(None) == air.span
    assert Recorded().beside(None) is None


def test_a_small_negative_value_has_no_sign() -> None:
    assert rounded_to(-0.00004, 0.01) == "0.000"
    assert rounded_to(-0.04, 0.01) == "-0.040"


def test_runs_that_are_left_out_are_named(laboratory: Path, run_command: Callable[..., Any], tmp_path: Path) -> None:
    shutil.copytree(laboratory, tmp_path / "copy")
    (tmp_path / "short.csv").write_text("time[s],rate[deg/s]\n" + "".join(f"{at},0.003\n" for at in range(100)))
    at = ("--unit", UNIT, "--store", tmp_path / "copy" / "lab")
    for run, day in (("earlier", "2026-02-01"), ("kicked", "2026-03-02")):
        when = ("--start", f"{day}T20:00:00Z", "--procedure", "static_bias", "--position", "IRA_up")
        assert run_command("import", "short.csv", *at, "--run", run, *when, cwd=tmp_path).code == 0
        left_out = ("runs", "exclude", run, "--reason", "table kicked", "--by", "Li Wei", *at[2:])
        assert run_command(*left_out, cwd=tmp_path).code == 0
    words = ("certificate", *at, "--standard", "JJF2014", "--order", tmp_path / "copy" / "order.toml", "--draft")
    done = run_command(*words, "--out", "draft.pdf", "--lang", "en", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    # one before the item was received is of another calibration
    assert done.json["left_out"] == ["run kicked of 2026-03-02 is not evaluated: table kicked (Li Wei)"]
    assert "Left out" in text_of(tmp_path / "draft.pdf")
    assert "run kicked of 2026-03-02 is not evaluated: table kicked (Li Wei)" in text_of(tmp_path / "draft.pdf")


@pytest.mark.long
def test_a_draft_in_chinese_lists_what_is_missing_in_chinese(
    laboratory: Path, run_command: Callable[..., Any], tmp_path: Path
) -> None:
    """Of an order without deviations nobody has stated that there are none."""
    order = (laboratory / "order.toml").read_text(encoding="utf-8")
    kept = [line for line in order.splitlines() if not line.startswith("deviations")]
    (tmp_path / "order.toml").write_text("\n".join(kept), encoding="utf-8")
    out = tmp_path / "zh.pdf"
    words = ("certificate", "--unit", UNIT, "--standard", "JJF2014", "--order", tmp_path / "order.toml", "--out", out)
    done = run_command(*words, "--draft", "--lang", "zh", "--store", "lab", cwd=laboratory)
    assert "8 m：" in done.err
    assert " is " not in done.err
    text = "".join(text_of(out).split())
    assert "偏离未给出" in text
    assert "偏离无" not in text
