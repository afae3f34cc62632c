"""The inner page of a certificate: each characteristic with its results, U and k."""

import math
import tomllib
from collections.abc import Mapping, Sequence
from decimal import ROUND_HALF_EVEN, Decimal
from importlib.resources import files
from typing import Any

import msgspec

from analytics.certificate.statement.words import Words
from analytics.evaluation.inner_page import InnerRow
from analytics.evaluation.reasons import in_chinese
from analytics.evaluation.selection import Row
from analytics.evaluation.type_b import COVERAGE
from analytics.uncertainty.rounding import round_up
from storage.specifications.specification import format_parameter
from stream.errors import BadInput
from stream.mistakes import similar_names

_CONDITIONS = tomllib.loads(
    files("analytics.certificate.statement").joinpath("conditions.toml").read_text(encoding="utf-8")
)
_UNITS = {
    "1": "", "deg/h": "°/h", "deg/s": "°/s", "deg/sqrt(h)": "°/√h", "deg/h/degC": "(°/h)/°C", "1/degC": "1/°C",
    "ppm/degC": "ppm/°C", "degC": "°C", "arcmin": "′", "arcsec": "″", "deg": "°", "deg/h/g": "(°/h)/g",
}  # fmt: skip


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """One value of a characteristic: as it is printed, and as numbers."""

    signal: str
    value: float
    unit_of_measure: str
    expanded: float | None  # U, rounded up to two digits
    k: float | None
    p: float | None  # coverage probability of U
    conditions: Words
    runs: tuple[str, ...]
    why_no_u: str = ""
    departs: Words = Words("", "")  # in what the record departs from the clause

    @property
    def is_compensated(self) -> bool:
        """Whether it is of an output that an error model has compensated."""
        return self.signal.endswith("_compensated")

    @property
    def unit(self) -> str:
        """Symbol of the unit of measure."""
        return symbol_of(self.unit_of_measure)

    @property
    def value_text(self) -> str:
        """The value, rounded to the last digit of U."""
        return rounded_to(self.value, self.expanded)

    @property
    def expanded_text(self) -> str:
        """U with as many digits as the value has, empty where it is not known."""
        return "" if self.expanded is None else rounded_to(self.expanded, self.expanded)


class ResultRow(msgspec.Struct, frozen=True, kw_only=True):
    """A characteristic of the inner page, with its results; none where it was not calibrated."""

    number: int
    name: Words
    metric: str
    clause: str
    results: tuple[Result, ...]
    reason: str | None = None


def symbol_of(unit_of_measure: str) -> str:
    """The symbol of a unit of measure; empty for the number 1.

    >>> symbol_of("deg/h"), symbol_of("1"), symbol_of("V")
    ('°/h', '', 'V')
    """
    return _UNITS.get(unit_of_measure, unit_of_measure)


def result_rows(page: Sequence[InnerRow]) -> tuple[ResultRow, ...]:
    """The rows of a certificate from those of the inner page."""
    return tuple(
        ResultRow(
            number=row.number, name=Words(row.en, row.zh), metric=row.metric, clause=row.clause,
            results=tuple(result_of(each) for each in row.results), reason=row.reason,
        )
        for row in page
    )  # fmt: skip


def ordered_rows(rows: Sequence[ResultRow], items: Sequence[str]) -> tuple[ResultRow, ...]:
    """The rows of an order: what was not ordered has no results. Raises BadInput for an item that no row has.

    All results are meant where the order has no items.
    """
    known = [row.metric for row in rows]
    if unknown := [each for each in items if each not in known]:
        near = ", ".join(similar_names(unknown[0], known, most=3)) or ", ".join(known)
        raise BadInput(f"the order: items has {unknown[0]!r}, which this certificate has not; there is {near}")
    if not items:
        return tuple(rows)
    return tuple(
        row if row.metric in items else msgspec.structs.replace(row, results=(), reason="not ordered") for row in rows
    )


def rounded_to(value: float, resolution: float | None) -> str:
    """A value rounded to the second significant digit of its uncertainty, half to even.

    >>> rounded_to(1.00005012, 3.4e-06), rounded_to(1234.5, 120.0), rounded_to(0.0123456, None)
    ('1.0000501', '1230', '0.0123456')
    """
    if resolution is None or not 0 < resolution < math.inf:
        return f"{value:.6g}"
    last = math.floor(math.log10(resolution)) - 1
    rounded = Decimal(repr(value)).quantize(Decimal(1).scaleb(last), rounding=ROUND_HALF_EVEN)
    return f"{rounded:f}" if rounded else f"{abs(rounded):f}"  # no -0.00


def result_of(row: Row) -> Result:
    """A value as a certificate states it."""
    expanded = None if row["U"] is None else round_up(row["U"])
    remark = row["parameters"].get("remark") or ""
    return Result(
        signal=row["signal"] or "", value=row["value"], unit_of_measure=row["unit_of_measure"], expanded=expanded,
        k=row["k"], p=None if expanded is None else COVERAGE, conditions=conditions_of(row["parameters"]),
        runs=tuple(row["runs"] or [row["run"]]),
        why_no_u=row["uncertainty_reason"] or "", departs=Words(remark, in_chinese(remark)),
    )  # fmt: skip


def conditions_of(parameters: Mapping[str, Any]) -> Words:
    """The parameters of a value that a reader needs.

    >>> conditions_of({"average_s": 10.0, "position": "IRA_up", "repeat": None, "procedure": "static_bias"})
    Words(en='averages of 10 s, position IRA_up', zh='平均时间 10 s，位置 IRA_up')
    """
    en, zh = [], []
    for name, value in parameters.items():
        if value is None or name in _CONDITIONS["left_out"]:
            continue
        words = _CONDITIONS["names"].get(name, {"en": f"{name} {{}}", "zh": f"{name} {{}}"})
        if isinstance(words["en"], dict):  # of a parameter with few values
            key = str(value).lower()
            if key not in words["en"]:
                key = "other"
            if key in words["en"]:
                en.append(words["en"][key].format(value))
                zh.append(words["zh"][key].format(value))
        else:
            en.append(words["en"].format(format_parameter(value)))
            zh.append(words["zh"].format(format_parameter(value)))
    return Words(", ".join(en), "，".join(zh))
