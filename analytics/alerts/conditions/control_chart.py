"""A metric over time shows a change, a drift, an outlier, or too many signals."""

from collections.abc import Iterator

from analytics.alerts.finding import AlertView, Condition, Finding
from analytics.loop.bilingual import Bilingual
from stream.errors import GyrofleetError


class ControlChartCondition(Condition, frozen=True, kw_only=True, tag="control_chart"):
    """The trend of a `metric` shows something significant; it is computed anew every `every_h` hours.

    `by` is what gets a chart of its own, as in `gyrofleet trend --by`: ``unit``, ``station``, ``lot``, ``fixture``.
    """

    metric: str
    by: str | None = "unit"
    every_h: float = 6.0

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """The trend, where it shows something; as before where it is not due."""
        key = f"control_chart/{self.metric}/{self.by}"
        found = view.kept.get(key)
        if found is None or view.now_ns - found[0] >= self.every_h * 3600e9:
            found = view.kept[key] = (view.now_ns, self._computed(view, key))
        yield from found[1]

    def _computed(self, view: AlertView, key: str) -> list[Finding]:
        from analytics.trends.charts.capability import specified_limits
        from analytics.trends.report import significant
        from analytics.trends.series import Choice, read_series
        from analytics.trends.trend import trend_of
        from storage.sql.catalog import Catalog

        try:
            with Catalog(view.store) as catalog:
                series = read_series(catalog, self.metric, Choice())
                limits = specified_limits(view.store, series)
            sentences = significant(trend_of(series, by=self.by, specification=limits))
        except GyrofleetError:
            return []  # no value of the metric yet
        if not sentences:
            return []
        en, zh = " ".join(each.en for each in sentences), "".join(each.zh for each in sentences)
        text = Bilingual(f"trend of {self.metric}: {en}", f"{self.metric}的趋势：{zh}")
        return [Finding(key, self.metric, text)]
