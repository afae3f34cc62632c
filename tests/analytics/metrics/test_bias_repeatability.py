"""Repeatability of the bias and its components within and between days, and their limits."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from analytics.methods.repeatability import Layout, Variance, between, beyond, means_noise, scatter
from tests.analytics.conftest import SECOND_NS, START_NS, Recorded
from tests.analytics.metrics.metric_rows import DAY_NS, Rows, exact, one


def power_ons(biases: np.ndarray, **words: Any) -> Rows:
    """Steps of as many days as there are rows, each with so many power-ons."""
    return [
        {
            "run": f"r{day}", "procedure": "bias_repeatability", "position": "IRA_east_west", "repeat": at + 1,
            "index": at + 1, "epoch": f"e{day}-{at}", "mean": float(bias),
            "t_start_ns": START_NS + day * DAY_NS + at * 2 * 3600 * SECOND_NS,
        } | words
        for day, of_day in enumerate(biases)
        for at, bias in enumerate(of_day)
    ]  # fmt: skip


def test_repeatability_and_its_components(recorded: Recorded) -> None:
    rng = np.random.default_rng(12)
    biases = 3 + rng.normal(0, 0.3, (7, 1)) + rng.normal(0, 0.1, (7, 4))
    found = recorded(power_ons(biases), "bias_repeatability")
    whole = [row for row in found if row["run"] is None]
    assert {row["kind"] for row in whole} == {
        "all", "run_to_run", "day_to_day", "within_day_component", "between_day_component"
    }  # fmt: skip
    within = biases.var(axis=1, ddof=1).mean()
    mean_square = 4 * biases.mean(axis=1).var(ddof=1)
    # each mean has an uncertainty of 0.01 with 30 degrees of freedom, which is taken off a component
    expected = {
        "run_to_run": (within, 21, 1e-4, 28 * 30),
        "day_to_day": (biases.mean(axis=1).var(ddof=1), 6, 1e-4 / 4, 28 * 30),
        "within_day_component": (within, 21, 1e-4, 28 * 30),
    }
    for kind, (variance, freedom, noise, noise_freedom) in expected.items():
        row = one(whole, kind=kind)
        beyond = exact(math.sqrt(variance - noise))
        assert (row["beyond_uncertainty"], row["uncertainty_of_means"]) == (beyond, exact(math.sqrt(noise)))
        is_component = kind == "within_day_component"
        assert row["value"] == (beyond if is_component else exact(math.sqrt(variance)))
        for side, tail in (("lo", 0.025), ("hi", 0.975)):
            left = variance - (noise * stats.f.isf(tail, freedom, noise_freedom) if is_component else 0.0)
            assert row[side] == exact(math.sqrt(freedom * left / stats.chi2.isf(tail, freedom)))
        assert row["standard_uncertainty"] == pytest.approx(row["value"] / math.sqrt(2 * freedom), rel=0.02)
    # power-ons of one day share its effect: a deviation of all would be neither
    assert "28 power-ons of 7 days, several of one" in one(whole, kind="all")["reason"]
    row = one(whole, kind="between_day_component")
    assert row["value"] == exact(math.sqrt((mean_square - within) / 4))
    lo = 6 * (mean_square - within * stats.f.isf(0.025, 6, 21)) / (4 * stats.chi2.isf(0.025, 6))
    hi = 6 * (mean_square - within * stats.f.ppf(0.025, 6, 21)) / (4 * stats.chi2.ppf(0.025, 6))
    assert (row["lo"], row["hi"]) == (exact(math.sqrt(lo)), exact(math.sqrt(hi)))
    assert row["runs"] == [f"r{day}" for day in range(7)]
    # a run of its own has four power-ons: GJB 2426A asks for six
    own = [row for row in found if row["run"] == "r2" and row["kind"] == "all"]
    assert one(own, standard="JJF2014")["value"] == exact(math.sqrt(biases[2].var(ddof=1)))
    assert one(own, standard="GJB2426A")["reason"] == "4 power-ons measured, the clause asks for 6 or more"


@pytest.mark.long
def test_the_same_day_is_that_of_the_station(recorded: Recorded) -> None:
    biases = np.array([[1.0, 2.0, 4.0, 8.0]])
    late = power_ons(biases, t_start_ns=START_NS)
    for at, row in enumerate(late):
        row["t_start_ns"] = START_NS + (20 + 3 * at) * 3600 * SECOND_NS  # 20:00, 23:00, 02:00, 05:00 UTC
    in_london = recorded(late, "bias_repeatability")
    assert one(in_london, kind="day_to_day", standard="JJF2014")["value"] == exact(np.std([1.5, 6.0], ddof=1))
    in_shanghai = recorded([row | {"time_zone": "Asia/Shanghai"} for row in late], "bias_repeatability")
    assert one(in_shanghai, kind="day_to_day")["reason"] == "all 4 power-ons are of one day, 2 days are needed"
    undated = recorded([row | {"date_known": False} for row in late], "bias_repeatability")
    assert one(undated, kind="run_to_run", standard="JJF2014")["value"] == exact(np.std(biases, ddof=1))
    assert "the date is unknown" in one(undated, kind="day_to_day")["reason"]


@pytest.mark.long
def test_repeatability_of_too_few_power_ons(recorded: Recorded) -> None:
    found = recorded(power_ons(np.array([[1.0]])), "bias_repeatability")
    assert {row["reason"] for row in found} == {"1 power-on measured, at least 2 are needed, 6 by GJB 2426A"}
    # steps of one power-on are one bias; a single static run is no test of repeatability
    same = recorded(power_ons(np.array([[1.0, 2.0]]), epoch="e"), "bias_repeatability")
    assert one(same, kind="all")["power_ons"] == 1
    assert recorded([{"mean": 1.0, "procedure": "static_bias"}], "bias_repeatability") == []
    daily = [
        {"mean": float(day), "procedure": "static_bias", "run": f"r{day}", "t_start_ns": START_NS + day * DAY_NS}
        for day in range(6)
    ]
    found = recorded(daily, "bias_repeatability")
    assert one(found, kind="day_to_day")["value"] == exact(np.std(np.arange(6.0), ddof=1))
    assert one(found, kind="all")["value"] == one(found, kind="day_to_day")["value"]
    assert one(found, kind="all")["remark"] == "6 power-ons are not recorded: each run is taken for one"
    assert (one(found, kind="all")["power_ons"], one(found, kind="all")["power_ons_recorded"]) == (6, 0)
    assert "each of the 6 power-ons is of another day" in one(found, kind="run_to_run")["reason"]


def test_raw_and_corrected_biases_are_never_in_one_repeatability(recorded: Recorded) -> None:
    rows = power_ons(np.arange(6.0)[:, np.newaxis], position="IRA_up")
    unknown = [{**row, "unit": "U2", "latitude_deg": None if at == 0 else 40.0} for at, row in enumerate(rows)]
    east = [{**row, "unit": "U3", "latitude_deg": None, "position": "IRA_east"} for row in rows]
    found = recorded([*rows, *unknown, *east], "bias_repeatability")
    assert {row["run"] for row in found if row["unit"] == "U1"} == {None}, "a run of one power-on is no test of its own"
    found = [row for row in found if row["kind"] == "all" and row["run"] is None]
    whole = float(np.std(np.arange(6.0), ddof=1))
    assert one(found, unit="U1")["value"] == pytest.approx(whole)
    assert one(found, unit="U1")["earth_rate"] == "removed"
    assert one(found, unit="U2", earth_rate="none")["value"] == pytest.approx(whole)
    assert "no latitude of the station" in one(found, unit="U2", earth_rate="removed")["reason"]
    assert (one(found, unit="U3")["earth_rate"], one(found, unit="U3")["value"]) == ("removed", pytest.approx(whole))


@pytest.mark.long
def test_the_scatter_of_short_records_is_their_noise(recorded: Recorded) -> None:
    """Seven records of 52 s: the means scatter by 2.9, each is uncertain by 3.0."""
    rng = np.random.default_rng(16)
    biases = rng.normal(0, 1, (1, 7))
    biases *= 2.9 / biases.std(ddof=1)
    rows = power_ons(biases, standard_uncertainty=3.01, freedom=12.0, duration_s=52.0)
    found = recorded(rows, "bias_repeatability")
    row = one(found, kind="all")  # as the clauses' equation has it
    assert (row["value"], row["uncertainty_of_means"], row["beyond_uncertainty"]) == (exact(2.9), exact(3.01), 0.0)
    part = one(found, kind="within_day_component")
    assert (part["value"], part["lo"]) == (0.0, 0.0)
    assert part["hi"] < 6.0
    # a quarter of its interval, with a factor of 2: U is no more than half the interval
    assert part["standard_uncertainty"] == exact(part["hi"] / 4)
    assert part["freedom"] > 1e6
    assert row["remark"] == "7 of 7 records are of 52 s: the clauses ask for an hour as a rule"
    assert row["power_ons_recorded"] == 7
    # longer records of the same unit would show it
    rows = power_ons(biases, standard_uncertainty=0.3, freedom=12.0)
    assert one(recorded(rows, "bias_repeatability"), kind="within_day_component")["lo"] > 1.8
    # one whose uncertainty is unknown lets nothing be taken off
    rows[0]["standard_uncertainty"] = None
    unknown = one(recorded(rows, "bias_repeatability"), kind="all")
    assert (unknown["value"], unknown["uncertainty_of_means"]) == (exact(2.9), None)


@pytest.mark.parametrize("sigma", [0.0, 0.3, 1.0, 3.0])
def test_the_limits_of_what_is_left_of_a_scatter_hold(sigma: float) -> None:
    rng = np.random.default_rng(17)
    trials, n, u, freedom = 2000, 8, 1.0, 9
    values = rng.normal(0, math.hypot(sigma, u), (trials, n))
    reported = u * np.sqrt(rng.chisquare(freedom, (trials, n)) / freedom)
    layout = Layout.of_names([n] * trials, ["a"] * (n * trials))
    noise = means_noise(reported.ravel(), np.full(n * trials, float(freedom)), layout)
    found = beyond(Variance(values.var(axis=1, ddof=1), np.full(trials, n - 1.0)), noise.square)
    held = np.count_nonzero((found.lo <= sigma) & (sigma <= found.hi))
    assert held >= stats.binom.ppf(0.001 / 4, trials, 0.95)


@pytest.mark.parametrize("sigma", [0.0, 0.1, 0.5])
def test_the_limits_of_the_component_between_days_hold(sigma: float) -> None:
    rng = np.random.default_rng(13)
    sizes = (3, 5, 2, 6, 4, 3)
    days = [day for day, size in enumerate(sizes) for _ in range(size)]
    values = rng.normal(0, sigma, (2000, len(sizes)))[:, days] + rng.normal(0, 0.3, (2000, len(days)))
    found = between(scatter(values.ravel(), Layout.of_names([len(days)] * 2000, days * 2000)))
    held = np.count_nonzero((found.lo <= sigma) & (sigma <= found.hi))
    # they hold at least at 95 %: the bound of 2000 trials at 99.9 %, one-sided, three checks together
    assert held >= stats.binom.ppf(0.001 / 3, 2000, 0.95)


def test_many_tests_at_once_have_the_sums_of_each_alone() -> None:
    rng = np.random.default_rng(18)
    counts = rng.integers(1, 9, 200)
    days = [f"d{each}" for each in rng.integers(3, size=counts.sum())]
    values = 1e3 + rng.normal(0, 1, counts.sum())
    values[: counts[0]] = 0.1
    found = scatter(values, Layout.of_names(counts, days))
    assert found.square[0] == 0.0 or counts[0] == 1  # equal values scatter by nothing at all
    ends = np.cumsum(counts)
    for at, (end, count) in enumerate(zip(ends, counts, strict=True)):
        own, names = values[end - count : end], np.array(days[end - count : end])
        groups = [own[names == day] for day in dict.fromkeys(names.tolist())]
        free = count - len(groups)
        within = math.fsum(float(each) for group in groups for each in (group - group.mean()) ** 2)
        expected = {
            "values": count, "groups": len(groups), "within_freedom": free,
            "square": own.var(ddof=1) if count > 1 else math.nan, "within": within / free if free else math.nan,
            "of_means": np.var([group.mean() for group in groups], ddof=1) if len(groups) > 1 else math.nan,
            "size": stats.hmean([len(group) for group in groups]),
        }  # fmt: skip
        for name, value in expected.items():
            assert getattr(found, name)[at] == pytest.approx(value, rel=1e-9, abs=1e-18, nan_ok=True), name
