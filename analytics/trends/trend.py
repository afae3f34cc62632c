"""The trend of a characteristic: charts, what stands out on them, which group differs, what the process can keep."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from analytics.trends.between_stations import Comparison, compare_groups
from analytics.trends.capability import Capability, capability
from analytics.trends.change_points import Changes, change_points
from analytics.trends.chart_chance import ChartChance, chart_chance, wild_point_chance
from analytics.trends.control_chart import IndividualsChart, Spread, individuals_chart
from analytics.trends.drift import Drift, drift
from analytics.trends.ewma import EwmaChart, ewma_chart
from analytics.trends.mixed_model import Deviation
from analytics.trends.nelson_rules import points_of, rule_flags
from analytics.trends.series import GROUPS, Series
from analytics.trends.variance_components import components
from analytics.trends.words import Refused, Words
from stream.batch import FloatArray

FALSE_ALARM = 0.01
"""Probability with which noise alone shows a wild point, a change, a drift, or too many signals: of each of these."""
NS_PER_DAY = 86_400 * 10**9
_MOST_SIMULATED = 40


class Limits(NamedTuple):
    """Limits of the specification that hold for a series, in its unit; `why_not` where there are none."""

    lower: float | None = None
    upper: float | None = None
    source: str = ""
    why_not: Words | None = None


class Chart(NamedTuple):
    """One series and what is seen in it.

    Parameters
    ----------
    name : str
        Unit, or level of the group; empty where all units stand on one chart.
    series : Series
        Its points.
    limits : IndividualsChart or Refused
        Centre and control limits.
    z : array of shape (points,)
        Distances from the centre in sigma; empty where there are no limits.
    signals : dict of list of int
        Points that take part in each of Nelson's rules that is met, by its number.
    counts : tuple of int
        How often each of the eight is met.
    averages : EwmaChart or None
        Moving averages.
    chance : ChartChance or None
        What noise would show; None where there are so many charts that no number of signals would say anything.
    wild_point : int or None
        The most distant point, where it is no chance.
    too_many : int or None
        The rule that is met more often than by chance.
    changes : Changes or Refused
        Changes of level.
    drift : Drift or Refused
        Per day; per point where dates are not known.
    drifts : bool
        Whether the drift is no chance.
    """

    name: str
    series: Series
    limits: IndividualsChart | Refused
    z: FloatArray
    signals: dict[int, list[int]]
    counts: tuple[int, ...]
    averages: EwmaChart | None
    chance: ChartChance | None
    wild_point: int | None
    too_many: int | None
    changes: Changes | Refused
    drift: Drift | Refused
    drifts: bool

    @property
    def has_changed(self) -> bool:
        """Whether its level has changed."""
        return isinstance(self.changes, Changes) and bool(self.changes.points)

    @property
    def in_control(self) -> bool | None:
        """Whether nothing stands out; None where there are too few points to say."""
        if isinstance(self.limits, Refused):
            return None
        stands_out = self.wild_point is not None or self.too_many is not None or self.has_changed or self.drifts
        return not stands_out


@dataclass(frozen=True)
class Trend:
    """The trend of a characteristic.

    Parameters
    ----------
    series : Series
        All values.
    by : str or None
        What each chart is of: ``unit``, ``lot``, ``station``, ``fixture``; None where all units stand on one.
    charts : tuple of Chart
        In order of their names.
    comparison : Comparison or Refused
        Between stations, fixtures and lots.
    specification : Limits
        What the values are held against.
    capabilities : tuple of Capability or Refused
        Of each chart.
    """

    series: Series
    by: str | None
    charts: tuple[Chart, ...]
    comparison: Comparison | Refused
    specification: Limits
    capabilities: tuple[Capability | Refused, ...]

    @cached_property
    def components(self) -> dict[str, Deviation]:
        """Scatter of units, of measurements, and of groups."""
        return components(self.series, GROUPS)


def trend_of(
    series: Series,
    *,
    by: str | None = None,
    baseline: int | None = None,
    spread: Spread = Spread.MEDIAN_MOVING_RANGE,
    specification: Limits = Limits(),  # noqa: B008  it is a tuple
) -> Trend:
    """Draw up the charts of a series and compare its groups.

    Parameters
    ----------
    series : Series
        All values in order of time.
    by : str, optional
        One chart for each unit, lot, station or fixture. A chart of a unit has all its values; other charts have the
        first value of each unit, since values of one unit resemble each other more than those of different units.
    baseline : int, optional
        From how many first points the limits are computed; from all if left out.
    spread : Spread
        By which rule.
    specification : Limits
        For the capability.
    """
    if by is None and len(set(series.unit)) == 1:
        by = "unit"
    if by is None:
        parts = {"": series.first_of_units()}
    else:
        parts = series.split(by)
        if by != "unit":
            parts = {name: part.first_of_units() for name, part in parts.items()}
    charts = tuple(_chart(name, part, len(parts), baseline, spread) for name, part in parts.items())
    return Trend(
        series=series,
        by=by,
        charts=charts,
        comparison=compare_groups(series, GROUPS),
        specification=specification,
        capabilities=tuple(_capability(chart, by, specification) for chart in charts),
    )


def time_axis(series: Series) -> FloatArray:
    """Days from the first value; numbers of the points where dates are not known."""
    if not series.dated:
        return np.arange(series.value.size, dtype=np.float64)
    return np.asarray((series.t_ns - series.t_ns[:1]) / NS_PER_DAY, np.float64)


def _chart(name: str, series: Series, charts: int, baseline: int | None, spread: Spread) -> Chart:
    share = FALSE_ALARM / charts
    limits = individuals_chart(series.value, baseline=baseline, spread=spread)
    changes = change_points(series.value, false_alarm=share)
    slope = drift(time_axis(series), series.value)
    empty = Chart(
        name=name,
        series=series,
        limits=limits,
        z=np.empty(0),
        signals={},
        counts=(0,) * 8,
        averages=None,
        chance=None,
        wild_point=None,
        too_many=None,
        changes=changes,
        drift=slope,
        # a step is a slope too; where there are steps, they are what is told
        drifts=isinstance(slope, Drift)
        and slope.chance <= share
        and not (isinstance(changes, Changes) and changes.points),
    )
    if isinstance(limits, Refused):
        return empty
    z = (series.value - limits.centre) / limits.sigma
    flags = rule_flags(z)
    counts = flags.sum(axis=-1)
    chance = None
    if charts <= _MOST_SIMULATED:
        chance = chart_chance(series.value, counts, baseline=limits.baseline, spread=spread)
    is_wild = wild_point_chance(series.value) <= share
    return empty._replace(
        z=z,
        signals=points_of(flags, z),
        counts=tuple(int(each) for each in counts),
        averages=ewma_chart(series.value, limits.centre, limits.sigma),
        chance=chance,
        wild_point=int(np.abs(series.value - series.value.mean()).argmax()) if is_wild else None,
        too_many=chance.rule if chance is not None and chance.signals <= share else None,
    )


def _capability(chart: Chart, by: str | None, limits: Limits) -> Capability | Refused:
    if by == "unit":
        return Refused(
            Words("it is of a process with many units, not of one unit", "过程能力针对多个样品，而非单个样品")
        )
    if limits.why_not is not None:
        return Refused(limits.why_not)
    return capability(
        chart.series.value,
        limits.lower,
        limits.upper,
        out_of_control=None if chart.in_control is not False else _what_stands_out(chart),
        uncertainty=chart.series.uncertainty,
    )


def _what_stands_out(chart: Chart) -> Words:
    seen = [
        (chart.wild_point is not None, Words("a wild point", "有异常点")),
        (chart.has_changed, Words("its level changes", "水平发生变化")),
        (chart.drifts, Words("it drifts", "存在漂移")),
        (
            chart.too_many is not None,
            Words(f"rule {chart.too_many} is met more often than by chance", f"判异准则 {chart.too_many} 超出随机预期"),
        ),
    ]
    told = [words for is_so, words in seen if is_so]
    return Words(", ".join(each.en for each in told), "，".join(each.zh for each in told))
