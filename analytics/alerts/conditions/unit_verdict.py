"""A unit is judged by its specifications, by every metric that was measured, from runs and from files."""

from collections.abc import Iterator
from typing import Annotated, Literal

import msgspec

from analytics.alerts.finding import AlertView, Condition, Finding, Hours
from analytics.evaluation.reasons import in_chinese
from analytics.evaluation.table import name_of
from analytics.loop.bilingual import Bilingual
from analytics.specifications.verdicts import Row, verdicts_of
from storage.sql.catalog import Catalog

_METRICS = {"FAIL": "failures", "MARGINAL": "undecided", "NO_DATA": "lacking"}
_ZH = {"PASS": "合格", "FAIL": "不合格", "MARGINAL": "临界", "NO_DATA": "无数据"}


class UnitVerdictCondition(Condition, frozen=True, kw_only=True, tag="unit_verdict"):
    """`gyrofleet verdicts` gives a unit one of `verdicts`; asked every `every_h` hours.

    It is cleared once the unit has another verdict, as when its run is excluded.
    """

    verdicts: Annotated[tuple[Literal["PASS", "FAIL", "MARGINAL", "NO_DATA"], ...], msgspec.Meta(min_length=1)] = (
        "FAIL",
    )
    every_h: Hours = 0.1

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """Units with such a verdict; as before where they are not due."""
        yield from view.every(self.every_h, msgspec.json.encode(self).decode(), lambda: self._computed(view))

    def _computed(self, view: AlertView) -> list[Finding]:
        with Catalog(view.store) as catalog:
            units = verdicts_of(catalog, with_values=False).units
        found = []
        for row in units:
            unit, verdict = row["unit"], row["verdict"]
            if verdict in self.verdicts:
                why, why_zh = (_why(row, language) for language in ("en", "zh"))
                what = "fails its specifications" if verdict == "FAIL" else f"has {verdict} by its specifications"
                text = Bilingual(
                    f"unit {unit} {what}{': ' * bool(why)}{why}",
                    f"产品{unit}按规范判定为{_ZH[verdict]}{'：' * bool(why_zh)}{why_zh}",
                )
                found.append(Finding(f"{unit}/{verdict}", unit, text, unit=unit))
        return found


def _why(row: Row, language: str) -> str:
    """The characteristics that give a unit its verdict, and what else is to be known."""
    metrics = row[_METRICS[row["verdict"]]] if row["verdict"] in _METRICS else []
    reason = row["reason"] or ""
    names = (", " if language == "en" else "、").join(name_of(each, language) for each in metrics)
    reason = in_chinese(reason) if language == "zh" else reason
    return "; ".join(each for each in (names, reason) if each)
