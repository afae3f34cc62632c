"""Statement of conformity: results of a certificate judged by a specification, with the decision rule.

ISO/IEC 17025:2017 7.8.6: to which results it applies, which specifications are met, and the decision rule.
"""

import json
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import msgspec

from analytics.certificate.statement.results import Result, ResultRow, conditions_of, rounded_to, symbol_of
from analytics.certificate.statement.words import Words
from analytics.evaluation.reasons import in_chinese
from analytics.metric_registry.registry import metrics
from analytics.specifications.verdicts import values_of
from storage.sql.catalog import Catalog

_OUTCOMES = {
    "PASS": Words("conforms", "符合"), "FAIL": Words("does not conform", "不符合"),
    "MARGINAL": Words("not decided", "不能判定"),
}  # fmt: skip
_RULES = {
    "interval": Words(
        "conforms where the whole interval of the result (95 %, or U where that is wider) is inside the limits, does "
        "not conform where all of it is outside, else not decided",
        "结果的整个区间（95 %，U 更宽时取 U）在限值内为符合，全部在限值外为不符合，否则不能判定",
    ),
    "simple_acceptance": Words(
        "simple acceptance (JCGM 106, 8.2): the result is compared with the limits, U is not taken into account",
        "简单接受（JCGM 106，8.2）：结果直接与限值比较，不计入 U",
    ),
    "shared_risk": Words(
        "simple acceptance (JCGM 106, 8.2) with U up to a stated largest value; with a larger U not decided",
        "简单接受（JCGM 106，8.2），U 不超过规定值；U 较大时不能判定",
    ),
    "guarded_acceptance": Words(
        "guarded acceptance (JCGM 106, 8.3.2): conforms where the result is inside the limits by at least the guard "
        "band, a multiple of U as it is stated, rounded up",
        "保护带接受（JCGM 106，8.3.2）：结果在限值内且距限值不小于保护带为符合；保护带为所给 U（向上修约）的倍数",
    ),
    "guarded_rejection": Words(
        "guarded rejection (JCGM 106, 8.3.3): does not conform where the result is outside by more than the guard "
        "band, a multiple of U as it is stated, rounded up",
        "保护带拒绝（JCGM 106，8.3.3）：结果超出限值的量大于保护带为不符合；保护带为所给 U（向上修约）的倍数",
    ),
}

_OF_VERDICT = (
    "verdict", "value", "lower", "upper", "unit_of_measure", "decision_rule", "guard", "conformity", "revision",
)  # fmt: skip


class Judged(msgspec.Struct, frozen=True, kw_only=True):
    """A result of the certificate with its verdict."""

    name: Words
    signal: str
    conditions: Words
    verdict: str
    value: float  # in the unit of the limits
    lower: float | None
    upper: float | None
    unit_of_measure: str
    decision_rule: str
    guard: float | None
    conformity: float | None  # probability
    reason: str
    revision: str
    expanded: float | None = None  # U as it is stated, where that is in the unit of the limits

    @property
    def text(self) -> Words:
        """Limits and outcome."""
        en, zh = _OUTCOMES[self.verdict].en, _OUTCOMES[self.verdict].zh
        limits = self._limits()
        en, zh = f"{limits.en}: {en}", f"{limits.zh}：{zh}"
        if self.decision_rule.startswith("guarded") and self.guard is not None:
            width = f"{_width(abs(self.guard))} {symbol_of(self.unit_of_measure)}".strip()
            if self.expanded:
                width += f" ({abs(self.guard) / self.expanded:.4g} U)"
            en, zh = f"{en}; guard band {width}", f"{zh}；保护带 {width}"
        if self.conformity is not None:
            share = _probability(self.conformity)
            en, zh = f"{en}; probability of conformity {share}", f"{zh}；符合概率 {share}"
        if self.verdict == "MARGINAL" and self.reason:
            en, zh = f"{en} ({self.reason})", f"{zh}（{in_chinese(self.reason)}）"
        return Words(en, zh)

    def _limits(self) -> Words:
        unit = symbol_of(self.unit_of_measure)
        if self.lower is None or self.upper is None:
            sign, limit = ("≤", self.upper) if self.lower is None else ("≥", self.lower)
            return Words.of(f"{sign} {limit:g} {unit}".strip())
        return Words.of(f"{self.lower:g} ... {self.upper:g} {unit}".strip())

    @property
    def whole(self) -> Words:
        """Characteristic, limits, outcome and decision rule in one text."""
        label, text, rule = self.label, self.text, _RULES[self.decision_rule]
        return Words(f"{label.en}: {text.en}. Decision rule: {rule.en}", f"{label.zh}：{text.zh}。判定规则：{rule.zh}")

    @property
    def status(self) -> str:
        """As the digital certificate words it (`stringConformityStatementStatusType` of DCC 3)."""
        if self.verdict != "MARGINAL":
            return self.verdict.lower()
        is_below = self.lower is not None and self.value < self.lower
        is_above = self.upper is not None and self.value > self.upper
        return "conditionalFail" if is_below or is_above else "conditionalPass"

    @property
    def label(self) -> Words:
        """Characteristic, signal and conditions."""
        en = ", ".join(each for each in (self.signal, self.conditions.en) if each)
        zh = "，".join(each for each in (self.signal, self.conditions.zh) if each)
        return Words(
            f"{self.name.en} ({en})" if en else self.name.en, f"{self.name.zh}（{zh}）" if zh else self.name.zh
        )


class Conformity(NamedTuple):
    """Verdicts of one specification: on results of the certificate, and limits that none of them answers."""

    specification: str
    judged: tuple[Judged, ...] = ()
    left: tuple[Words, ...] = ()  # limits without a result on the certificate

    @property
    def revisions(self) -> str:
        """The revisions that judged."""
        return ", ".join(sorted({each.revision for each in self.judged}))

    @property
    def rules(self) -> Sequence[Words]:
        """The decision rules that were applied, in words; each with its characteristics where there are several."""
        by_rule: dict[str, dict[Words, None]] = {}
        for each in self.judged:
            by_rule.setdefault(each.decision_rule, {})[each.name] = None
        if len(by_rule) == 1:
            return [_RULES[each] for each in by_rule]
        return [
            Words(
                f"{', '.join(each.en for each in names)}: {_RULES[rule].en}",
                f"{'、'.join(each.zh for each in names)}：{_RULES[rule].zh}",
            )
            for rule, names in by_rule.items()
        ]

    @property
    def not_judged(self) -> Words:
        """The limits without a result on the certificate, in one line; empty where there are none."""
        return Words("; ".join(each.en for each in self.left), "；".join(each.zh for each in self.left))


def read_conformity(catalog: Catalog, unit: str, specification: str, rows: Iterable[ResultRow]) -> Conformity:
    """Verdicts of a unit by a specification, on the results that a certificate states.

    Raises BadInput if a specification in the store is not right.
    """
    results = {_key(row.metric, each): (row, each) for row in rows for each in row.results}
    judged, left = dict[Judged, None](), dict[Words, None]()
    for verdict in values_of(catalog, [unit]):
        if verdict["specification"] != specification:
            continue
        found = results.get(_key_of(verdict))
        if found is None or verdict["verdict"] not in _OUTCOMES:
            left[_subject(verdict)] = None
            continue
        row, result = found
        stated = {name: verdict[name] for name in _OF_VERDICT}
        one = Judged(
            name=row.name, signal=result.signal, conditions=result.conditions, reason=verdict["reason"] or "",
            expanded=result.expanded if result.unit_of_measure == verdict["unit_of_measure"] else None, **stated,
        )  # fmt: skip
        judged[one] = None  # rows by two standards are one result
    return Conformity(specification, tuple(judged), tuple(left))


def _subject(verdict: dict[str, Any]) -> Words:
    """The characteristic and the settings that a limit is on."""
    header = metrics()[verdict["metric"]].header if verdict["metric"] in metrics() else None
    of = verdict["subject"].removeprefix(verdict["metric"])
    settings = dict(re.findall(r"(\w+) = ([^,()]+)", of))
    conditions = conditions_of({name: _number(value) for name, value in settings.items()})
    if header is None:
        return Words(verdict["subject"], verdict["subject"])
    ends = (f" ({conditions.en})", f"（{conditions.zh}）") if conditions.en else (of, of)
    return Words(f"{header.en}{ends[0]}", f"{header.zh}{ends[1]}")


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


_Key = tuple[str, str, tuple[str, ...], str]


def _key(metric: str, result: Result) -> _Key:
    return metric, result.signal, result.runs, result.conditions.en


def _key_of(verdict: dict[str, Any]) -> _Key:
    runs = tuple(verdict["runs"] or ([verdict["run"]] if verdict["run"] else []))
    conditions = conditions_of(json.loads(verdict["parameters"] or "{}"))
    return verdict["metric"], verdict["signal"] or "", runs, conditions.en


def _width(guard: float) -> str:
    """A guard band with the two digits of the U that it is, or with more where it is a multiple.

    >>> _width(0.03), _width(0.00011), _width(1.5 * 0.00011)
    ('0.030', '0.00011', '0.000165')
    """
    text = rounded_to(guard, guard)
    return text if math.isclose(float(text), guard, rel_tol=1e-9) else f"{guard:.6g}"


def _probability(share: float) -> str:
    """As printed; never 0 or 100 %.

    >>> _probability(0.9723), _probability(1.0), _probability(1e-9)
    ('97.2 %', '> 99.9 %', '< 0.1 %')
    """
    if share > 0.999:
        return "> 99.9 %"
    return "< 0.1 %" if share < 0.001 else f"{share:.1%}".replace("%", " %")
