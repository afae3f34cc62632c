"""A unit has a verdict by its live limits, at the end of its run or early."""

from collections.abc import Iterator
from typing import Literal

from analytics.alerts.finding import AlertView, Condition, Finding
from analytics.loop.bilingual import Bilingual
from storage.specifications.live_limits import format_limit
from stream.events import EarlyDecision, Verdict, VerdictGiven


class VerdictCondition(Condition, frozen=True, kw_only=True, tag="verdict"):
    """A unit is given one of `verdicts` at the end of its run."""

    verdicts: tuple[Verdict, ...] = (Verdict.FAIL,)

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """Verdicts that were given since the last look."""
        for document in view.documents:
            if isinstance(document, VerdictGiven) and document.verdict in self.verdicts:
                worst = [format_limit(each.limit) for each in document.checks if each.verdict is document.verdict]
                why = f": {'; '.join(worst)}" if worst else ""
                text = Bilingual(
                    f"unit {document.unit} has {document.verdict} in run {document.run}{why}",
                    f"产品{document.unit}在试验{document.run}中判定为{document.verdict}{why}",
                )
                yield Finding(document.uid, document.unit, text, is_event=True, unit=document.unit)


class EarlyDecisionCondition(Condition, frozen=True, kw_only=True, tag="early_decision"):
    """A limit of a unit is decided before the end of its record, as one of `outcomes`."""

    outcomes: tuple[Literal["PASS", "FAIL"], ...] = ("FAIL",)

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """Limits decided since the last look, each once a run."""
        for document in view.documents:
            is_early = isinstance(document, EarlyDecision) and document.looked_at_fraction < 1.0
            if isinstance(document, EarlyDecision) and is_early and document.outcome in self.outcomes:
                limit = format_limit(document.limit)
                text = Bilingual(
                    f"unit {document.unit}: early {document.outcome} in run {document.run}, {limit}: {document.reason}",
                    f"产品{document.unit}：试验{document.run}提前判定{document.outcome}，{limit}：{document.reason_zh}",
                )
                key = f"{document.run}/{document.unit}/{limit}/{document.outcome}"
                yield Finding(key, document.unit, text, is_event=True, unit=document.unit)
