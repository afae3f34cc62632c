"""Measurement standards of a calibration: those that its runs state, and those that the order adds."""

import datetime as dt
import json
from collections.abc import Iterable, Mapping
from typing import Any

import msgspec

from analytics.certificate.statement.order import ReferenceTable
from analytics.certificate.statement.words import Words
from ingest.instruments.base import instrument_kinds
from ingest.measurement_standards import DETAIL, QUANTITIES
from storage.sql.catalog import Catalog

# of each run the last statement counts
_STATED = f"""
select run, arg_max(document->>'$.details.{DETAIL}', arrival_ns) from internal.lake_documents
where kind in ('RunStarted', 'StationStated') and list_contains($runs, run)
  and document->>'$.details.{DETAIL}' is not null
group by run order by run
"""  # noqa: S608  our own statement


_SHAPES = {"uniform": "均匀分布", "triangular": "三角分布", "u_shaped": "反正弦分布"}


class Reference(msgspec.Struct, frozen=True, kw_only=True):
    """A measurement standard with what its own certificate states; what is not stated is empty or None."""

    name: Words
    serial: str
    certificate: str
    due: dt.date | None
    uncertainty: Words
    traceable_to: Words = Words("", "")
    used_until: dt.date | None = None  # last day of the runs that state it; None of those that the order names

    @classmethod
    def of_table(cls, table: ReferenceTable) -> "Reference":
        """A reference of the order."""
        return cls(
            name=Words.of(table.name), serial=table.serial, certificate=table.certificate, due=table.due,
            uncertainty=Words.of(table.uncertainty), traceable_to=Words.of(table.traceable_to),
        )  # fmt: skip

    @property
    def text(self) -> Words:
        """All that is stated of it."""
        parts = [
            (self.serial, f"serial {self.serial}", f"编号 {self.serial}"),
            (self.certificate, f"certificate {self.certificate}", f"证书编号 {self.certificate}"),
            (self.uncertainty, self.uncertainty.en, self.uncertainty.zh),
            (self.due, f"valid until {self.due}", f"有效期至 {self.due}"),
            (self.traceable_to, f"traceable to {self.traceable_to.en}", f"溯源至{self.traceable_to.zh}"),
        ]
        stated = [(en, zh) for given, en, zh in parts if given]
        return Words(", ".join(en for en, _ in stated), "，".join(zh for _, zh in stated))

    def missing(self, last_day: dt.date | None) -> list[Words]:
        """What a certificate cannot do without; `last_day` is that of the calibration."""
        found = [
            Words(f"{self.name.en}: {en} is not stated", f"{self.name.zh}：未说明{zh}")
            for given, en, zh in (
                (self.serial, "serial number", "编号"), (self.certificate, "certificate number", "证书编号"),
                (self.uncertainty.en, "uncertainty", "不确定度"), (self.due, "validity", "有效期"),
            )
            if not given
        ]  # fmt: skip
        last_day = self.used_until or last_day
        if self.due is not None and last_day is not None and last_day > self.due:
            found.append(
                Words(
                    f"{self.name.en} {self.serial} was valid until {self.due}; it was used until {last_day}",
                    f"{self.name.zh} {self.serial} 有效期至 {self.due}，早于其使用日期 {last_day}",
                )
            )
        return found


def contradictions(references: Iterable[Reference]) -> list[Words]:
    """What is stated in two ways of one certificate of a standard, such as two dates of its validity."""
    stated: dict[tuple[str, str, str], set[tuple[dt.date | None, str]]] = {}
    for each in references:
        key = each.name.en, each.serial, each.certificate
        stated.setdefault(key, set()).add((each.due, each.uncertainty.en))
    return [
        Words(
            f"{name} {serial}: its certificate {number} is stated with different validity or uncertainty: restate the "
            "runs that are wrong with --station FILE --restate",
            f"{name} {serial}：其证书 {number} 的有效期或不确定度有不同的说明：请用--station FILE --restate更正",
        )
        for (name, serial, number), found in stated.items()
        if number and len(found) > 1
    ]


def stated_references(catalog: Catalog, last_days: Mapping[str, dt.date | None]) -> list[Reference]:
    """Standards that runs state, each once, or twice where it is stated in two ways; `last_days` has that of each run.

    An instrument of which nothing is stated is none.
    """
    found: dict[str, Reference] = {}
    for run, text in catalog.rows(_STATED, {"runs": sorted(last_days)}):
        for entry in json.loads(text):
            if entry["certificate"] or entry["quantities"]:
                key = json.dumps(entry, sort_keys=True)
                one, last = found.get(key) or _reference(entry), last_days[run]
                if last is not None and (one.used_until is None or last > one.used_until):
                    one = msgspec.structs.replace(one, used_until=last)
                found[key] = one
    return list(found.values())


def _reference(entry: dict[str, Any]) -> Reference:
    kinds = instrument_kinds()
    names = kinds[entry["kind"]].names if entry["kind"] in kinds else {}
    due = entry["calibration_due"]
    return Reference(
        name=Words(names.get("en", entry["name"]), names.get("zh", entry["name"])), serial=entry["serial"],
        certificate=entry["certificate"], due=None if due is None else dt.date.fromisoformat(due),
        uncertainty=_uncertainty(entry["quantities"]), traceable_to=Words.of(entry.get("traceable_to", "")),
    )  # fmt: skip


def _uncertainty(quantities: Iterable[dict[str, Any]]) -> Words:
    en, zh = [], []
    for each in quantities:
        names = QUANTITIES[each["quantity"]]
        number = f"{each['stated']:.4g} {each['unit']}"
        shape = each["distribution"]
        if shape == "normal":
            text = f"U = {number} (k = {each['divisor']:.3g})"
            en.append(f"{names.en} {text}")
            zh.append(f"{names.zh} {text}")
        else:
            en.append(f"{names.en} ± {number} ({shape.replace('_', '-')})")
            zh.append(f"{names.zh} ± {number}（{_SHAPES.get(shape, shape)}）")
    return Words("; ".join(en), "；".join(zh))
