"""Metrics for people: a table on the screen, a CSV file, a workbook."""

import csv
import json
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from itertools import groupby
from pathlib import Path
from typing import Any
from unicodedata import east_asian_width

from analytics.evaluation.reasons import in_chinese
from analytics.evaluation.selection import Row, clauses_of, with_year
from analytics.metric_registry.registry import metrics
from storage.specifications.specification import format_parameter
from stream.errors import BadInput
from stream.files.atomic_file import replacement
from stream.quantities import format_unit
from stream.terminal.console import csv_text, shown_text, styled
from stream.terminal.result_table import ResultTable

COLUMNS = (
    "metric", "unit", "signal", "run", "value", "unit_of_measure", "lo", "hi", "standard_uncertainty",
    "u_type_a", "u_type_b", "U", "k", "nu", "n", "parameters", "runs", "steps", "standard", "clause", "reason",
    "uncertainty_reason",
)  # fmt: skip
_TITLES = tomllib.loads(files("analytics.evaluation").joinpath("metric_titles.toml").read_text(encoding="utf-8"))
_MOST_DIGITS = 9
_WIDEST = 80  # characters of a column of a workbook
_REASONS = ("reason", "uncertainty_reason")


def name_of(metric: str, language: str) -> str:
    """A metric's name in ``en`` or ``zh``."""
    header = metrics()[metric].header
    return header.zh if language == "zh" else header.en


def _titles(columns: Iterable[str], language: str) -> list[str]:
    return [_TITLES[language].get(column, column) for column in columns]


def format_number(value: float | None, resolution: float | None = None) -> str:
    """A number rounded to two digits of its uncertainty.

    >>> format_number(12.3456, 0.0123), format_number(1.5e-7, 2e-9), format_number(3.0), format_number(None)
    ('12.346', '1.500e-07', '3', '')
    """
    if value is None:
        return ""
    if resolution is None or not 0 < resolution < math.inf or value == 0:
        return f"{value:.6g}"
    last = math.floor(math.log10(resolution)) - 1  # the decimal place of the uncertainty's second digit
    digits = min(max(math.floor(math.log10(abs(value))) - last, 1), _MOST_DIGITS)
    if 1e-4 <= abs(value) < 1e7:
        return f"{value:.{min(max(-last, 0), _MOST_DIGITS)}f}"
    return f"{value:.{digits}e}"


def format_parameters(parameters: Mapping[str, Any], language: str = "en") -> str:
    """Parameters on one line, without unknown ones, the procedure, which the run names, and ``room = false``.

    Their names are those that limits have; texts that are sentences are in the language.

    >>> format_parameters({"procedure": "static_bias", "average_s": 100.0, "room": True, "axis": None})
    'average_s = 100, room = true'
    >>> format_parameters({"temperature": 25.0, "room": False})
    'temperature = 25'
    >>> format_parameters({"remark": "record of 300 s: the clauses ask for one hour as a rule"}, "zh")
    '备注 = 记录长 300 s：条款一般要求一小时'
    """
    spoken = in_language(parameters, language)
    return ", ".join(
        f"{'备注' if name == 'remark' and language == 'zh' else name} = {format_parameter(each)}"
        for name, each in spoken.items()
        if each is not None and name != "procedure" and not (name == "room" and each is False)
    )


def in_language(parameters: Mapping[str, Any], language: str) -> dict[str, Any]:
    """Parameters with their sentences, such as the remark, in ``en`` or ``zh``; a single word is a name and stays."""
    if language != "zh":
        return dict(parameters)
    return {
        name: in_chinese(each) if isinstance(each, str) and " " in each else each for name, each in parameters.items()
    }


def interval_of(row: Row) -> str:
    """The confidence bounds of a value, empty where it has none."""
    if row["lo"] is None or row["hi"] is None:
        return ""
    u = row["standard_uncertainty"]
    return f"{format_number(row['lo'], u)} .. {format_number(row['hi'], u)}"


def format_limits(row: Row) -> str:
    """Specification limits.

    >>> format_limits({"lower": None, "upper": 0.5}), format_limits({"lower": -1.0, "upper": 1.0})
    ('<= 0.5', '-1 .. 1')
    """
    lower, upper = row["lower"], row["upper"]
    if lower is None or upper is None:
        return f"<= {upper:g}" if upper is not None else "" if lower is None else f">= {lower:g}"
    return f"{lower:g} .. {upper:g}"


def metrics_table(rows: Sequence[Row], language: str) -> ResultTable:
    """Rows as a table for the screen, a section for each unit and run; a reason replaces a missing value."""
    shown = ("name", "signal", "value", "interval", "n", "parameters", "clause")
    table = ResultTable(*_titles(shown, language))

    def of_section(row: Row) -> tuple[str, str, str]:
        return row.get("plant", ""), row["unit"], row["run"] or ""

    for (plant, unit, run), section in groupby(sorted(rows, key=of_section), key=of_section):
        runs = run or ("几次试验合计" if language == "zh" else "over several runs")
        table.add_section()
        table.add_row(styled(f"{plant}/{unit}" if plant else unit, "bold").append(f"  {shown_text(runs)}", "default"))
        for row in section:
            table.add_row(
                name_of(row["metric"], language),
                row["signal"] or "",
                styled(reason_of(row, language), "yellow") if row["value"] is None else format_value(row),
                interval_of(row),
                "" if row["n"] is None else f"{row['n']:,}",
                format_parameters(row["parameters"], language),
                "; ".join(f"{with_year(standard)} {clause}" for standard, clause in clauses_of(row).items()),
            )
    return table


def reason_of(row: Row, language: str) -> str:
    """Why a value is missing, in ``en`` or ``zh``."""
    return in_chinese(str(row["reason"])) if language == "zh" else str(row["reason"])


def format_value(row: Row) -> str:
    """A value rounded by its uncertainty, with its unit."""
    return f"{format_number(row['value'], row['standard_uncertainty'])} {format_unit(row['unit_of_measure'])}".strip()


def _check_name(path: Path, option: str, other: str) -> None:
    """Raise BadInput where the name of a file promises another format."""
    if path.suffix.lower() == other:
        raise BadInput(f"{option} {path}: programs expect another format behind {other}; give another name")


def write_csv(rows: Sequence[Row], path: Path, language: str) -> None:
    """Write rows as CSV, in UTF-8 with the byte-order mark that spreadsheets need; titles, reasons in the language."""
    _check_name(path, "--csv", ".xlsx")
    try:
        with replacement(path) as fresh, fresh.open("w", encoding="utf-8-sig", newline="") as file:
            writer = csv.writer(file)
            columns = _columns_of(rows)
            titles = ["name", *columns]  # for programs; those of another language are for people
            writer.writerow(titles if language == "en" else _titles(titles, language))
            for row in rows:
                cells = _plain(row, columns, language, is_for_people=language != "en")
                writer.writerow(csv_text(each) if isinstance(each, str) else each for each in cells)
    except OSError as error:
        raise _unwritable(path, "--csv", error) from error


def write_xlsx(rows: Sequence[Row], path: Path, language: str) -> None:
    """Write rows as a workbook with one sheet: numbers as numbers, titles in the language, column filters."""
    import xlsxwriter
    from xlsxwriter.exceptions import XlsxWriterException

    _check_name(path, "--xlsx", ".csv")
    # text stays text: a unit "=1+1" is no formula, a run "http://x" no link
    options = dict.fromkeys(("strings_to_formulas", "strings_to_urls", "strings_to_numbers"), False)
    options["nan_inf_to_errors"] = True
    try:
        with replacement(path) as fresh, xlsxwriter.Workbook(str(fresh), options) as book:
            sheet = book.add_worksheet("特性" if language == "zh" else "metrics")
            bold = book.add_format({"bold": True})
            columns = _columns_of(rows)
            titles = _titles(("name", *columns), language)
            cells = [_plain(row, columns, language, is_for_people=True) for row in rows]
            sheet.write_row(0, 0, titles, bold)
            for at, row in enumerate(cells, 1):
                sheet.write_row(at, 0, row)
            sheet.autofilter(0, 0, len(cells), len(titles) - 1)
            sheet.freeze_panes(1, 1)
            for at, column in enumerate(zip(titles, *cells, strict=True)):
                sheet.set_column(at, at, min(max(map(_width, column)) + 3, _WIDEST))  # 3: the mark of the filter
    except (OSError, XlsxWriterException) as error:
        raise _unwritable(path, "--xlsx", error) from error


def _width(cell: object) -> int:
    """Width of a cell in characters; Chinese ones are as wide as two.

    >>> _width("零偏 bias"), _width(0.25), _width(None)
    (9, 4, 0)
    """
    text = f"{cell:.10g}" if isinstance(cell, float) else "" if cell is None else str(cell)
    return sum(2 if east_asian_width(each) in "WF" else 1 for each in text)


def _columns_of(rows: Sequence[Row]) -> tuple[str, ...]:
    return ("plant", *COLUMNS) if rows and "plant" in rows[0] else COLUMNS


def _plain(row: Row, columns: Iterable[str], language: str, *, is_for_people: bool) -> list[object]:
    cells: list[object] = [name_of(row["metric"], language)]
    for column in columns:
        value = row[column]
        if column == "parameters":
            value = json.dumps(in_language(value, language), ensure_ascii=False)
        elif column in _REASONS and value is not None and language == "zh":
            value = in_chinese(value)
        elif column == "standard" and is_for_people:
            value = with_year(value)
        elif isinstance(value, list):
            value = ", ".join(str(each) for each in value)
        cells.append(value)
    return cells


def _unwritable(path: Path, option: str, error: Exception) -> BadInput:
    why = error.strerror if isinstance(error, OSError) and error.strerror else error
    return BadInput(f"cannot write {path}: {why}; give {option} a file in a folder you can write")
