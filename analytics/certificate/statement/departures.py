"""Departures from the clauses of a standard, runs that are left out, and which outputs are compensated."""

import datetime as dt
from collections.abc import Sequence

from analytics.certificate.statement.evidence import ExcludedRun
from analytics.certificate.statement.order import Text
from analytics.certificate.statement.results import ResultRow
from analytics.certificate.statement.words import Words

_NONE = {"none", "no", "nil", "n/a", "-", "/", "无", "没有"}


def departures(rows: Sequence[ResultRow]) -> list[Words]:
    """What the metrics found: of each characteristic, once."""
    found: dict[str, Words] = {}
    for row in rows:
        for each in row.results:
            if each.departs.en:
                text = Words(f"{row.name.en}: {each.departs.en}", f"{row.name.zh}：{each.departs.zh}")
                found.setdefault(text.en, text)
    return list(found.values())


def states_any(stated: Text) -> bool:
    """Whether an order states a deviation; "none" states none.

    >>> states_any("none"), states_any("无。"), states_any(""), states_any("records of 60 s")
    (False, False, False, True)
    """
    words = Words.of(stated)
    return bool(words) and words.en.strip().lower().rstrip(".。") not in _NONE


def not_stated(stated: Text, found: Sequence[Words]) -> list[Words]:
    """What is missing in an order that does not state the departures that were found.

    >>> [each.en for each in not_stated("none", [Words("records of 60 s", "60 s")])]
    ['the order states no deviation, and the records depart from the clause: state it (records of 60 s)']
    """
    if not found or states_any(stated):
        return []
    en, zh = "; ".join(each.en for each in found), "；".join(each.zh for each in found)
    return [
        Words(
            f"the order states no deviation, and the records depart from the clause: state it ({en})",
            f"委托信息未说明偏离，而记录偏离规范条款：须说明（{zh}）",
        )
    ]


def compensation_of(rows: Sequence[ResultRow]) -> Words:
    """Which results are of outputs that an error model has compensated."""
    signals = sorted({each.signal for row in rows for each in row.results if each.is_compensated})
    if not signals:
        return Words(
            "The results are those of the outputs as the item gives them, without compensation.",
            "校准结果为被校对象的原始输出，未作补偿。",
        )
    listed = ", ".join(signals)
    return Words(
        f"Compensated by an error model: {listed}; the other results are those of the outputs as the item gives them.",
        f"经误差模型补偿的输出：{listed}；其余为被校对象的原始输出。",
    )


def left_out(excluded: Sequence[ExcludedRun], received: dt.date | None) -> list[Words]:
    """Runs of the item since it was received that somebody has excluded from evaluation, each with its reason.

    >>> run = ExcludedRun(run="night-1", reason="door open", by="Li", time_zone="UTC", start_ns=None)
    >>> [each.en for each in left_out([run], dt.date(2026, 3, 1))]
    ['run night-1 is not evaluated: door open (Li)']
    """
    found = []
    for each in excluded:
        if received is not None and each.day is not None and each.day < received:
            continue
        en, zh = ("", "") if each.day is None else (f" of {each.day}", f"（{each.day}）")
        found.append(
            Words(
                f"run {each.run}{en} is not evaluated: {each.reason} ({each.by})",
                f"试验 {each.run}{zh}不参与评定：{each.reason}（{each.by}）",
            )
        )
    return found
