"""Base class of conditions on the values of a metric over time."""

from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from typing import Literal

import msgspec

from analytics.alerts.finding import AlertView, Condition, Finding, Hours
from analytics.metric_registry.registry import check_metrics
from analytics.trends.series import Choice, MetricSeries, every_series
from storage.sql.catalog import Catalog
from stream.errors import NotFound

GroupName = Literal["unit", "product", "lot", "station", "fixture"]


class MetricCondition(Condition, frozen=True, kw_only=True):
    """Each kind of value of a `metric` is watched: averaging times, axes, temperatures, units of measure.

    Of values with and without the Earth's rate, which are of the same records, those that `gyrofleet trend` shows are.
    `signal`, `standard`, `product` and `parameters` (as ``{ average_s = "100" }``) choose some of them;
    `units`, of the rule, whose units count: of a trend of lots or stations too, which is of no unit alone.
    """

    metric: str
    signal: str | None = None
    standard: str | None = None
    product: str | None = None
    parameters: dict[str, str | float | bool] = msgspec.field(default_factory=dict)
    every_h: Hours = 1.0
    units: str = "*"

    def check(self) -> None:
        """As of `Condition`."""
        check_metrics([self.metric])

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """What the values show; as before where they are not due."""
        key = msgspec.json.encode(self).decode()
        yield from view.every(self.every_h, key, lambda: self._computed(view))

    def _computed(self, view: AlertView) -> list[Finding]:
        parameters = {
            name: str(value).lower() if isinstance(value, bool) else str(value)
            for name, value in self.parameters.items()
        }
        choice = Choice(signal=self.signal, standard=self.standard, product=self.product, parameters=parameters)
        with Catalog(view.store) as catalog:
            try:
                series = every_series(catalog, self.metric, choice)
            except NotFound:
                if choice != Choice():
                    raise  # nothing may ever match it
                return []  # no value of the metric yet
            places = [[at for at, unit in enumerate(each.serial) if fnmatchcase(unit, self.units)] for each in series]
            series = [each.where(at) for each, at in zip(series, places, strict=True) if at]
            return self.of_series(_of_different_records(series), catalog)

    def of_series(self, series: Sequence[MetricSeries], catalog: Catalog) -> list[Finding]:
        """What the values of each kind show."""
        raise NotImplementedError


def _of_different_records(series: Sequence[MetricSeries]) -> list[MetricSeries]:
    found: dict[tuple[object, ...], MetricSeries] = {}
    for each in series:
        others = tuple(pair for pair in each.variant.parameters if pair[0] != "earth_rate")
        found.setdefault((each.variant.standard, others, each.unit_of_measure), each)
    return list(found.values())


def key_of(condition: str, series: MetricSeries, of: str) -> str:
    """The key of a finding of one kind of value."""
    return f"{condition}/{series.metric}/{series.variant}/{series.unit_of_measure}/{of}"
