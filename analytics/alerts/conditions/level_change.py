"""The level of a metric has changed, watched at every new value."""

from collections.abc import Sequence
from typing import Annotated

import msgspec

from analytics.alerts.finding import Finding
from analytics.alerts.metric_condition import GroupName, MetricCondition, key_of
from analytics.evaluation.table import name_of
from analytics.loop.bilingual import Bilingual
from analytics.trends.chart_sentences import moment
from analytics.trends.levels.level_watch import LevelWatch, level_watch
from analytics.trends.series import MetricSeries
from storage.sql.catalog import Catalog


class LevelChangeCondition(MetricCondition, frozen=True, kw_only=True, tag="level_change"):
    """The level of a metric changes; new values are looked at every `every_h` hours, as often as one likes.

    `by` is what is watched alone. Where nothing changes, even in a wander from value to value, any of them ever alarms
    with the probability `false_alarm` at most.
    """

    by: GroupName = "unit"
    false_alarm: Annotated[float, msgspec.Meta(gt=0.0, lt=1.0)] = 0.01

    def of_series(self, series: Sequence[MetricSeries], catalog: Catalog) -> list[Finding]:
        """Levels that have changed."""
        del catalog
        watched = [(each, name, each.where(at)) for each in series for name, at in each.places(self.by).items()]
        changed = []
        for each, name, part in watched:
            watch = level_watch(part.value)
            if isinstance(watch, LevelWatch) and watch.alarms(self.false_alarm / len(watched)):
                when, odds = moment(part, watch.at), f"{watch.evidence:.2g}"
                level, metric = f"{each.metric} ({each.variant})", name_of(each.metric, "zh")
                text = Bilingual(
                    f"the level of {level} of {name} changes at {when}: {odds} times more probable than a wander",
                    f"{name} 的{metric}（{each.variant}）水平自 {when} 起变化：概率为缓慢游走的 {odds} 倍",
                )
                unit = part.serial[0] if self.by == "unit" else None
                changed.append(Finding(key_of("level_change", each, name), name, text, unit=unit))
        return changed
