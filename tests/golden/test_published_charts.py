"""Control charts, run lengths, capability and components of variance against what others have published."""

import numpy as np
import pytest
from scipy.stats import norm

from analytics.trends.charts.capability import Capability, capability, cp_index, cpk_index
from analytics.trends.charts.control_chart import (
    D2,
    D3,
    EWMA_WEIGHT,
    EWMA_WIDTH,
    IndividualsChart,
    Spread,
    c4,
    ewma_chart,
    individuals_chart,
)
from analytics.trends.charts.nelson_rules import rule_flags
from analytics.trends.groups.mixed_model import MixedModel


def average_run_length(weight: float, width: float, shift: float = 0.0, states: int = 201) -> float:
    """Points until the average leaves steady limits, by the Markov chain of Brook and Evans (Lucas, Saccucci 1990).

    `shift`: by how many sigma the process has moved.
    """
    half = width * np.sqrt(weight / (2 - weight))
    edges = np.linspace(-half, half, states + 1)
    middles = (edges[1:] + edges[:-1]) / 2
    reached = norm.cdf((edges[None, :] - (1 - weight) * middles[:, None]) / weight - shift)
    moves = np.diff(reached, axis=1)
    lengths = np.linalg.solve(np.eye(states) - moves, np.ones(states))
    return float(lengths[states // 2])


def test_individuals_chart_of_the_nist_handbook() -> None:
    # NIST/SEMATECH e-Handbook 6.3.2.2; it rounds d2 to 1.128 and the mean moving range to 1.8778
    flow = np.array([49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1])
    chart = individuals_chart(flow)
    assert isinstance(chart, IndividualsChart)
    assert chart.centre == pytest.approx(50.81, abs=1e-9)
    assert chart.moving_range == pytest.approx(1.8778, abs=5e-5)
    assert chart.upper == pytest.approx(55.8041, abs=3 * 1.8778 * (1 / 1.128 - 1 / D2) + 2e-4)
    assert chart.lower == pytest.approx(45.8159, abs=3 * 1.8778 * (1 / 1.128 - 1 / D2) + 2e-4)
    # D4 = 3.267 of the tables
    assert chart.moving_range_upper / chart.moving_range == pytest.approx(3.267, abs=5e-4)


def test_constants_of_the_tables() -> None:
    # ASTM STP 15D, table 27
    assert pytest.approx(1.128, abs=5e-4) == D2
    assert pytest.approx(0.853, abs=5e-4) == D3
    assert [c4(n) for n in (2, 5, 10, 25)] == pytest.approx([0.7979, 0.9400, 0.9727, 0.9896], abs=5e-5)


def test_moving_averages_of_the_nist_handbook() -> None:
    # NIST/SEMATECH e-Handbook 6.3.2.4
    values = [52.0, 47.0, 53.0, 49.3, 50.1, 47.0, 51.0, 50.1, 51.2, 50.5]
    values += [49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1]
    averages = [50.60, 49.52, 50.56, 50.18, 50.16, 49.21, 49.75, 49.85, 50.26, 50.33]
    averages += [50.11, 49.36, 49.52, 50.05, 49.38, 49.92, 50.73, 51.23, 51.94, 51.99]
    chart = ewma_chart(np.array(values), 50.0, 2.0539, weight=0.3, width=3.0)
    assert list(chart.averages) == pytest.approx(averages, abs=5.1e-3)
    # the limits of the handbook are the steady ones, cut off after four decimals
    assert chart.upper[-1] == pytest.approx(52.5884, abs=1e-4)
    assert chart.lower[-1] == pytest.approx(47.4115, abs=1e-4)
    assert not chart.outside


@pytest.mark.parametrize(
    ("weight", "width"), [(0.40, 3.054), (0.25, 2.998), (0.20, 2.962), (0.10, 2.814), (0.05, 2.615)]
)
def test_run_lengths_of_moving_averages(weight: float, width: float) -> None:
    # Lucas and Saccucci 1990: these pairs have an average run length of 500 in control
    assert average_run_length(weight, width) == pytest.approx(500, rel=0.005)


def test_run_length_of_a_moved_process() -> None:
    # Lucas and Saccucci 1990: points until a shift of so many sigma is seen
    for shift, published in ((0.25, 106), (0.5, 31.3), (0.75, 15.9), (1.0, 10.3)):
        assert average_run_length(0.10, 2.814, shift) == pytest.approx(published, rel=0.006)


def test_default_moving_average_signals_as_seldom_as_three_sigma() -> None:
    assert average_run_length(EWMA_WEIGHT, EWMA_WIDTH) == pytest.approx(1 / (2 * norm.sf(3)), rel=0.005)


def _check_run_length(rules: list[int], expected: float, series: int, checks: int) -> None:
    """Run lengths are cut off after three mean ones; their tail is geometric, which takes exp(-3) of the mean."""
    rng = np.random.default_rng([20260707, *rules])
    most = int(3 * expected)
    lengths = []
    for _ in range(series // 1000):
        met = rule_flags(rng.standard_normal((1000, most)))[[rule - 1 for rule in rules]].any(axis=0)
        lengths.append(np.where(met.any(axis=-1), met.argmax(axis=-1) + 1, most))
    found = np.concatenate(lengths)
    cut = expected * (1 - np.exp(-most / expected))
    assert abs(found.mean() - cut) < norm.isf(0.001 / checks / 2) * found.std() / np.sqrt(found.size)


# Champ and Woodall 1987, table 1, without a shift: beyond 3 sigma with 2 of 3 beyond 2, with 4 of 5 beyond 1, and both
@pytest.mark.in_gate("rules3-132.89-2000")
@pytest.mark.parametrize("series", [2_000, 10_000])
@pytest.mark.parametrize(
    ("rules", "published"), [([1], 370.40), ([1, 5], 225.44), ([1, 6], 166.05), ([1, 5, 6], 132.89)]
)
def test_run_lengths_of_rules(rules: list[int], published: float, series: int) -> None:
    _check_run_length(rules, published, series, 6)


@pytest.mark.in_gate("2-1000")
@pytest.mark.parametrize("series", [1000, 3000])
@pytest.mark.parametrize("rule", [2, 7])
def test_run_lengths_that_follow_from_coins(rule: int, series: int) -> None:
    """A run of r equal throws comes after 2**r - 1 throws; of r successes after (1 - p**r)/((1 - p) p**r)."""
    within = 1 - 2 * norm.sf(1)
    expected = {2: 2**9 - 1, 7: (1 - within**15) / ((1 - within) * within**15)}[rule]
    _check_run_length([rule], expected, series, 6)


def test_capability_of_the_nist_handbook() -> None:
    # NIST/SEMATECH e-Handbook 6.1.6: limits 8 and 20, mean 16, standard deviation 2 give Cp 1.0 and Cpk 0.6667
    values = norm.ppf((np.arange(100) + 0.5) / 100)
    values = 16 + 2 * (values - values.mean()) / values.std(ddof=1)
    found = capability(values, 8.0, 20.0)
    assert isinstance(found, Capability)
    assert found.cp is not None
    assert found.cp.value == pytest.approx(1.0)
    assert found.cpk.value == pytest.approx(2 / 3)


def test_capability_limits_of_montgomery() -> None:
    # Introduction to Statistical Quality Control, 6th edition, examples 8.4 and 8.5: 20 units
    assert tuple(cp_index(2.29, 20)) == pytest.approx((2.29, 1.57, 3.01), abs=5e-3)
    assert tuple(cpk_index(1.33, 20)) == pytest.approx((1.33, 0.88, 1.78), abs=5e-3)


def test_dyestuff() -> None:
    # Davies and Goldsmith 1972, as REML of lme4 has it: 42.00 between batches, 49.51 within, mean 1527.5 -+ 19.38
    yields = """1545 1440 1440 1520 1580  1540 1555 1490 1560 1495  1595 1550 1605 1510 1560
                1445 1440 1595 1465 1545  1595 1630 1515 1635 1625  1520 1455 1450 1480 1445"""
    y = np.array(yields.split(), np.float64)
    model = MixedModel(y, np.ones((30, 1)), np.repeat(np.arange(6), 5))
    found = model.deviations()
    assert found["unit"].value == pytest.approx(42.00, abs=5e-3)
    assert found["residual"].value == pytest.approx(49.51, abs=5e-3)
    (mean,) = model.effects(np.ones((1, 1)))
    assert mean.value == pytest.approx(1527.5)
    assert mean.standard_uncertainty == pytest.approx(19.38, abs=5e-3)
    # balanced: the mean has as many degrees of freedom as there are batches less one
    assert mean.freedom == pytest.approx(5, rel=1e-4)


def test_robust_limits_do_not_follow_wild_points() -> None:
    rng = np.random.default_rng(3)
    quiet = rng.normal(10.0, 1.0, 100)
    wild = quiet.copy()
    wild[[20, 60]] += 40.0
    sigmas = {}
    for spread in Spread:
        before, after = individuals_chart(quiet, spread=spread), individuals_chart(wild, spread=spread)
        assert isinstance(before, IndividualsChart)
        assert isinstance(after, IndividualsChart)
        sigmas[spread] = after.sigma / before.sigma
    assert sigmas[Spread.MEDIAN_MOVING_RANGE] < 1.2
    assert sigmas[Spread.MOVING_RANGE] > 2
    assert sigmas[Spread.DEVIATION] > 4
