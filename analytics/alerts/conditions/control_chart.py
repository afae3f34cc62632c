"""A metric over time shows a change, a drift, an outlier, or too many signals."""

from collections.abc import Sequence

from analytics.alerts.finding import Finding, Hours
from analytics.alerts.metric_condition import GroupName, MetricCondition, key_of
from analytics.evaluation.table import name_of
from analytics.loop.bilingual import Bilingual
from analytics.trends.charts.capability import specified_limits
from analytics.trends.report import significant
from analytics.trends.series import MetricSeries
from analytics.trends.trend import trend_of
from storage.sql.catalog import Catalog


class ControlChartCondition(MetricCondition, frozen=True, kw_only=True, tag="control_chart"):
    """The trend of a metric shows something significant; it is computed again every `every_h` hours.

    `by` is what gets a chart of its own, as in `gyrofleet trend --by`.
    """

    by: GroupName | None = "unit"
    every_h: Hours = 6.0

    def of_series(self, series: Sequence[MetricSeries], catalog: Catalog) -> list[Finding]:
        """The trend of each kind, where it shows something."""
        found = []
        for each in series:
            specification = specified_limits(catalog.store, each)
            sentences = significant(trend_of(each, by=self.by, specification=specification))
            if sentences:
                en, zh = " ".join(one.en for one in sentences), "".join(one.zh for one in sentences)
                text = Bilingual(
                    f"trend of {each.metric} ({each.variant}): {en}",
                    f"{name_of(each.metric, 'zh')}（{each.variant}）的趋势：{zh}",
                )
                found.append(Finding(key_of("control_chart", each, str(self.by)), each.metric, text))
        return found
