"""Shifts of single stations from every measurement: found, dated, sized, and seldom seen where there are none."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import binom

from analytics.plots import trend_plot
from analytics.trends.groups.components import components
from analytics.trends.levels.level_shifts import LevelShifts, level_shifts
from analytics.trends.levels.session_model import SessionModel, SessionNoise, variance_ratios
from analytics.trends.report import sentences, stands_out
from analytics.trends.series import NS_PER_DAY, MetricSeries
from analytics.trends.trend import trend_of
from analytics.trends.words import NotComputed
from tests.analytics.trends.test_trends_groups import series_of
from tests.bench.trend_shifts import STATION, Plan, counted, is_outside, simulated

SMALL = Plan(units=12, stations=2, repeats=3)


def shifts_of(plan: Plan, seed: int) -> LevelShifts:
    found = level_shifts(simulated(np.random.default_rng(seed), plan))
    assert isinstance(found, LevelShifts)
    return found


@pytest.mark.long
@pytest.mark.parametrize(("how", "series"), [("weekly", 80), ("rounds", 80), ("single", 30)])
def test_independent_measurements_show_a_shift_in_at_most_one_of_a_hundred_series(how: str, series: int) -> None:
    found = counted(SMALL._replace(how=how), series, seed=2)
    assert found.anything <= binom.isf(0.001 / 3, series, 0.01)


@pytest.mark.long
def test_a_wandering_station_is_no_plain_shift_but_is_said_to_wander() -> None:
    plan = SMALL._replace(of_sessions=0.2, correlation=0.6)
    found = counted(plan, 20, seed=3)
    assert found.plain <= binom.isf(0.001, 20, 0.01)
    assert found.anything >= 18
    said = "\n".join(each.en for each in sentences(trend_of(simulated(np.random.default_rng([3, 1]), plan))))
    assert "wander from session to session" in said


# fewer than 18 of 24 series come of a share of 0.94 less than once in a thousand times; of 8 series that are 5
@pytest.mark.parametrize(
    ("series", "least"), [(8, int(binom.ppf(0.001, 8, 0.94))), pytest.param(24, 18, marks=pytest.mark.long)]
)
def test_a_shift_is_found_dated_and_covered(series: int, least: int) -> None:
    plan = Plan(shift=0.12, stations=2)
    found = counted(plan, series, seed=4)
    assert found.anything == series
    assert found.found >= least
    assert found.dated >= binom.ppf(0.001, found.found, 0.9)
    assert not is_outside(plan, found, 1)


@pytest.mark.long
@pytest.mark.parametrize(("how", "series"), [("weekly", 150), ("rounds", 150), ("single", 40)])
def test_shifts_in_many_series(how: str, series: int) -> None:
    for plan in (Plan(how=how), Plan(how=how, of_sessions=0.05, correlation=0.6), Plan(how=how, shift=0.12)):
        assert not is_outside(plan, counted(plan, series), 9)


@pytest.mark.long
def test_all_stations_that_change_together_are_one_change() -> None:
    series = simulated(np.random.default_rng(5), Plan())
    late = series.t_ns >= series.t_ns[series.value.size // 2]
    series.value[late] += 0.2
    found = level_shifts(series)
    assert isinstance(found, LevelShifts)
    (shift,) = found.shifts
    assert (shift.station, shift.units) == ("", 30)
    assert shift.lo <= 0.2 <= shift.hi
    assert "The level of all stations changes" in "\n".join(each.en for each in sentences(trend_of(series)))


def test_other_units_from_then_on_may_be_the_cause_and_that_is_said() -> None:
    rng = np.random.default_rng(6)
    # units of weeks 8 on are others, 3 deg/h higher, measured on this station only
    series = simulated(rng, Plan(stations=1, repeats=2, of_units=0.05))
    first = np.array([int(unit[1:]) < 15 for unit in series.unit])
    series.t_ns[first], series.t_ns[~first] = np.sort(series.t_ns)[: first.sum()], np.sort(series.t_ns)[first.sum() :]
    series = series.where(np.argsort(series.t_ns, kind="stable"))
    series.value[:] += 3.0 * np.array([int(unit[1:]) >= 15 for unit in series.unit])
    said = "\n".join(each.en for each in sentences(trend_of(series, by="station")))
    assert "0 units were measured there before and after, so it may be the units that changed" in said


@pytest.mark.long
def test_wild_values_are_no_shift() -> None:
    alarms = 0
    for seed in range(40):
        series = simulated(np.random.default_rng([7, seed]), SMALL)
        series.value[[10, 40]] += 3.0
        found = level_shifts(series)
        assert isinstance(found, LevelShifts)
        alarms += bool(found.shifts)
    assert alarms <= binom.isf(0.001, 40, 0.02)


def test_units_of_measure_do_not_matter() -> None:
    plan = Plan(shift=0.3, stations=2)
    series = simulated(np.random.default_rng(8), plan)
    plain = shifts_of(plan, 8)
    series.value[:] = series.value * 1e6 + 1e9
    large = level_shifts(series)
    assert isinstance(large, LevelShifts)
    assert [each.at for each in large.shifts] == [each.at for each in plain.shifts]
    assert large.shifts[0].size == pytest.approx(plain.shifts[0].size * 1e6, rel=1e-3)


def test_few_values_and_units_measured_once_are_refused() -> None:
    for plan in (Plan(stations=1, repeats=1), Plan(units=2, repeats=2, stations=2)):
        found = level_shifts(simulated(np.random.default_rng(9), plan))
        assert isinstance(found, NotComputed)
        assert "measured more than once" in found.why.en
    constant = simulated(np.random.default_rng(9), Plan())
    constant.value[:] = 7.5
    assert isinstance(level_shifts(constant), NotComputed)


def test_points_scatter_as_measurements_do_whether_a_unit_has_one_or_many() -> None:
    series = simulated(np.random.default_rng(10), Plan(units=200, stations=1, repeats=3))
    once = [at for at, unit in enumerate(series.unit) if int(unit[1:]) >= 100]
    kept = [*(at for at in range(series.value.size) if at not in set(once)), *once[::3]]
    found = level_shifts(series.where(sorted(kept)))
    assert isinstance(found, LevelShifts)
    assert found.points.std() == pytest.approx(0.1, rel=0.15)


def dense(series: Any, noise: SessionNoise, ratios: tuple[float, float], model: SessionModel) -> float:
    """-2 ln of the restricted likelihood by its definition, up to a constant."""
    n = series.value.size
    unit, session = np.eye(model.unit.max() + 1)[model.unit], np.eye(model.sessions)[model.session]
    lot = np.eye(8)[model.lot]
    v = np.eye(n) + ratios[0] * unit @ unit.T + ratios[1] * lot @ lot.T + session @ model.covariance(noise) @ session.T
    x = (model.station[model.session][:, None] == np.unique(model.station)).astype(float)
    inverse = np.linalg.inv(v)
    normal = x.T @ inverse @ x
    rest = series.value - x @ np.linalg.solve(normal, x.T @ inverse @ series.value)
    squares = rest @ inverse @ rest
    return float(np.linalg.slogdet(v)[1] + np.linalg.slogdet(normal)[1] + (n - x.shape[1]) * np.log(squares))


@pytest.mark.parametrize("lots", [1, 5])
def test_sums_over_sessions_give_the_dense_likelihood(lots: int) -> None:
    """Also where a unit is of several lots, as its measurements say."""
    from analytics.trends.levels.sessions import layout_of, station_columns
    from analytics.trends.levels.step_search import StepSearch

    series = simulated(np.random.default_rng(11), SMALL)
    layout = layout_of(series)
    ratio, _ = variance_ratios(series.value, layout)
    assert ratio == pytest.approx(25, rel=0.9)
    lot = np.arange(series.value.size) % lots
    model = SessionModel(layout.session, layout.unit, layout.station, ratio, lot, 0.0 if lots == 1 else 3.0)
    search = StepSearch(model, [], station_columns(layout.station))
    fits = search._fits(model.sums(series.value))
    found = np.array([-2 * float(search._likelihood(fit, fit.squares)[0]) for fit in fits])
    expected = np.array([dense(series, noise, (ratio, model.lot_ratio), model) for noise in model.noises])
    assert found - found[0] == pytest.approx(expected - expected[0], abs=1e-6)


def test_simulated_sums_have_the_moments_of_simulated_values() -> None:
    from analytics.trends.levels.sessions import layout_of

    layout = layout_of(simulated(np.random.default_rng(12), SMALL))
    lot = layout.unit // 5
    model = SessionModel(layout.session, layout.unit, layout.station, 4.0, lot, 9.0)
    noise = SessionNoise(3.0, 0.6)
    rng = np.random.default_rng(13)
    series = 4000
    session = rng.multivariate_normal(np.zeros(model.sessions), model.covariance(noise), series)
    own = rng.normal(0, 2.0, (series, model.unit.max() + 1))
    own += rng.normal(0, 3.0, (series, 3))[:, np.arange(own.shape[1]) // 5]
    values = own[:, model.unit] + session[:, model.session] + rng.standard_normal((series, model.session.size))
    direct = [model.sums(each) for each in values]
    drawn = model.simulated(noise, series, rng)
    products = np.column_stack([each.products for each in direct])
    assert np.cov(drawn.products) == pytest.approx(np.cov(products), abs=0.12 * np.abs(np.cov(products)).max())
    squares = np.array([each.squares[0] for each in direct])
    assert drawn.squares.mean() == pytest.approx(squares.mean(), rel=5 * squares.std() / squares.mean() / series**0.5)
    assert drawn.squares.std() == pytest.approx(squares.std(), rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("by", [None, "station"])
def test_the_picture_has_every_value_and_ends_where_the_data_end(
    by: str | None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(trend_plot, "write_figure", lambda figure, _: drawn.append(figure))
    series = simulated(np.random.default_rng(14), Plan(shift=0.3))
    trend = trend_of(series, by=by)
    assert stands_out(trend)
    trend_plot.plot_trend(trend, tmp_path / "trend.png")
    days = series.t_ns / (86_400 * 10**9)
    (figure,) = drawn
    seen = 0
    for axes in figure.axes:
        left, right = axes.get_xlim()
        assert left <= days.min() < days.max() <= right
        assert right - left <= 1.1 * np.ptp(days)
        names = {"measured again", "C0", STATION, "C2"}
        seen += sum(int(np.asarray(line.get_xdata()).size) for line in axes.lines if line.get_label() in names)
    assert seen >= series.value.size


def handed_over() -> MetricSeries:
    """Four lots of ten units, each at one station and a day later at the other, which differs by 0.15 deg/h.

    The values of the quality manager's tutorial, in which a change of all stations is likely and its bounds hold none.
    """
    rng = np.random.default_rng(2026)
    bias = rng.normal(1.0, 0.1, 40)
    station, unit = np.repeat([0, 1], 40), np.tile(np.arange(40), 2)
    value = np.empty(80)
    for at in range(80):
        level = bias[unit[at]] + 0.15 * station[at] + rng.normal(0.0, 0.02)
        value[at] = level + rng.normal(0.0, 0.1, 61).mean()
    days = 21 * (unit // 10) + station
    series = series_of(value, unit, station=station, lot=unit // 10)
    moments = series.t_ns[0] + days * NS_PER_DAY
    order = np.argsort(moments, kind="stable")
    return replace(series, t_ns=moments, run=[f"r{day}" for day in days]).where(order)


def test_a_change_whose_bounds_hold_none_makes_no_station_stand_out() -> None:
    """As a step in the charts it would look like a drift."""
    trend = trend_of(handed_over(), by="station")
    assert not isinstance(trend.shifts, NotComputed)
    (shift,) = trend.shifts.shifts
    assert shift.lo < 0.0 < shift.hi
    assert "may have changed" in "\n".join(each.en for each in sentences(trend))
    assert [chart.in_control for chart in trend.charts] == [True, True]


def test_lots_that_do_not_differ_have_an_upper_bound() -> None:
    """Of four lots of ten units; a component that is none begins at the least variance there is."""
    lot = components(handed_over(), ("station", "lot"))["lot"]
    assert lot.value == lot.lo == 0.0
    assert 0.02 < lot.hi < 0.1


def lots_apart(seed: int, *, of_sessions: float = 0.0) -> MetricSeries:
    """Four lots of twelve units, each lot in sessions of its own: on two stations, and five weeks later again.

    Units of a lot differ by less than they scatter, and the third lot from the others by more.
    """
    rng = np.random.default_rng([20261203, seed])
    times, unit = np.divmod(np.arange(192), 48)
    lot, station = unit // 12, times % 2
    days = 7 * lot + 35 * (times // 2) + station
    value = rng.normal(0.2, 0.006, 48)[unit] + 0.07 * (lot == 2) + rng.normal(0, 0.022, 192)
    value += rng.normal(0, of_sessions, days.max() + 1)[days]
    series = series_of(value, unit, station=station, lot=lot)
    moments = series.t_ns[0] + days * NS_PER_DAY
    order = np.argsort(moments, kind="stable")
    return replace(series, t_ns=moments, run=[f"r{day}" for day in days]).where(order)


@pytest.mark.in_gate("10")
@pytest.mark.parametrize("trials", [10, pytest.param(150, marks=pytest.mark.long)])
def test_lots_that_differ_are_no_wander_of_the_stations(trials: int) -> None:
    alarms = 0
    for seed in range(trials):
        found = level_shifts(lots_apart(seed))
        assert isinstance(found, LevelShifts)
        alarms += found.unsteady is not None or bool(found.shifts)
    assert alarms <= binom.isf(0.001, trials, 0.01)


def test_stations_that_wander_are_found_beside_lots_that_differ() -> None:
    seen = []
    for seed in range(5):
        found = level_shifts(lots_apart(seed, of_sessions=0.03))
        assert isinstance(found, LevelShifts)
        seen.append(found.unsteady is not None)
    assert sum(seen) >= 4


@pytest.mark.long
def test_a_shift_beside_lots_that_differ_is_sized() -> None:
    covered = 0
    for seed in range(40):
        series = simulated(np.random.default_rng([15, seed]), Plan(shift=0.12, stations=2))
        lots = np.array([int(unit[1:]) // 10 for unit in series.unit])
        series.value[:] += 0.4 * (lots == 1)
        series = replace(series, groups=series.groups | {"lot": [f"L{lot}" for lot in lots]})
        found = level_shifts(series)
        assert isinstance(found, LevelShifts)
        own = [each for each in found.shifts if each.station == STATION]
        covered += bool(own) and own[0].lo <= 0.12 <= own[0].hi
    assert covered >= binom.ppf(0.001, 40, 0.92)
