"""The level of a metric has changed, watched at every new value."""

from collections.abc import Iterator

from analytics.alerts.finding import AlertView, Condition, Finding
from analytics.loop.bilingual import Bilingual
from stream.errors import GyrofleetError


class LevelChangeCondition(Condition, frozen=True, kw_only=True, tag="level_change"):
    """The level of a `metric` changes; new values are looked at every `every_h` hours, as often as one likes.

    `by` is what is watched alone: ``unit``, ``station``, ``lot``, ``fixture``. Where nothing changes, even in a wander
    from value to value, any of them ever alarms with the probability `false_alarm` at most.
    """

    metric: str
    by: str = "unit"
    every_h: float = 1.0
    false_alarm: float = 0.01

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """Levels that have changed; as before where the values are not due."""
        key = f"level_change/{self.metric}/{self.by}"
        found = view.kept.get(key)
        if found is None or view.now_ns - found[0] >= self.every_h * 3600e9:
            found = view.kept[key] = (view.now_ns, self._computed(view, key))
        yield from found[1]

    def _computed(self, view: AlertView, key: str) -> list[Finding]:
        from analytics.trends.chart_sentences import moment
        from analytics.trends.levels.level_watch import LevelWatch, level_watch
        from analytics.trends.series import Choice, read_series
        from storage.sql.catalog import Catalog

        try:
            with Catalog(view.store) as catalog:
                series = read_series(catalog, self.metric, Choice())
        except GyrofleetError:
            return []  # no value of the metric yet
        places = series.places(self.by)
        changed = []
        for name, at in places.items():
            part = series.where(at)
            watch = level_watch(part.value)
            if isinstance(watch, LevelWatch) and watch.alarms(self.false_alarm / len(places)):
                when, odds = moment(part, watch.at), f"{watch.evidence:.2g}"
                text = Bilingual(
                    f"the level of {self.metric} of {name} changes at {when}: {odds} times more probable than a wander",
                    f"{name} 的 {self.metric} 水平自 {when} 起变化：其概率为缓慢游走的 {odds} 倍",
                )
                changed.append(Finding(f"{key}/{name}", name, text))
        return changed
