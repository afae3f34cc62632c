"""Propagation against GTC, an independent implementation of JCGM 100 (MIT), and against JCGM 100's own examples."""

import math

import GTC
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analytics.uncertainty.budget import Budget, Unknown
from analytics.uncertainty.component import Component
from analytics.uncertainty.correlation import Correlation
from stream.errors import BadInput, NotEnoughData

_SIZES = st.floats(1e-6, 1e3)
# squares of smaller ones have fewer digits than other numbers
_SENSITIVITIES = st.floats(-50, 50).filter(lambda c: c == 0.0 or abs(c) > 1e-100)
_FREEDOMS = st.one_of(st.integers(1, 60).map(float), st.just(math.inf))
_COMPONENTS = st.lists(st.tuples(_SIZES, _SENSITIVITIES, _FREEDOMS), min_size=1, max_size=8)


def make(parts: list[tuple[float, float, float]], *, group: str = "") -> tuple[Component, ...]:
    return tuple(
        Component.type_a(f"x{i}", f"x{i}", u, freedom, "1", sensitivity=c, group=group)
        for i, (u, c, freedom) in enumerate(parts)
    )


def budget(components: tuple[Component, ...], *correlations: Correlation) -> Budget:
    return Budget(en="y", zh="y", value=0.0, unit="1", components=components, correlations=correlations)


@given(_COMPONENTS)
def test_independent_components_propagate_as_in_gtc(parts: list[tuple[float, float, float]]) -> None:
    found = budget(make(parts)).expand(p=0.95)
    other = sum(c * GTC.ureal(0.0, u, df=freedom) for u, c, freedom in parts)
    assert found.u == pytest.approx(other.u, rel=1e-12, abs=1e-300)
    if other.u:
        assert found.freedom == pytest.approx(other.df, rel=1e-9) or (found.freedom > 1e9 and other.df > 1e6)
        assert found.k == pytest.approx(GTC.reporting.k_factor(other.df, 95), rel=2e-5)


@given(st.lists(st.tuples(_SIZES, _SENSITIVITIES), min_size=2, max_size=2), st.floats(-1, 1))
def test_correlated_components_propagate_as_in_gtc(parts: list[tuple[float, float]], r: float) -> None:
    found = budget(make([(u, c, math.inf) for u, c in parts]), Correlation("x0", "x1", r))
    inputs = [GTC.ureal(0.0, u, independent=False) for u, _ in parts]
    GTC.set_correlation(r, *inputs)
    other = sum(c * x for (_, c), x in zip(parts, inputs, strict=True))
    largest = max(u * abs(c) for u, c in parts)
    assert found.standard_uncertainty() == pytest.approx(other.u, rel=1e-6, abs=1e-7 * largest)


@pytest.mark.parametrize("r", [-0.6, 0.0, 0.4, 0.95])
def test_estimates_of_the_same_observations_keep_their_degrees_of_freedom(r: float) -> None:
    """An ensemble in GTC (Willink 2007): slope and intercept of one line, and a third, independent quantity."""
    pair = [(0.3, 2.0, 9.0), (0.7, -1.0, 9.0)]
    found = budget(make([*pair, (0.5, 1.0, 4.0)]), Correlation("x0", "x1", r))
    first, second = GTC.multiple_ureal([0.0, 0.0], [u for u, _, _ in pair], 9, None)
    if r:
        GTC.set_correlation(r, first, second)
    other = 2.0 * first - second + GTC.ureal(0.0, 0.5, df=4)
    assert found.standard_uncertainty() == pytest.approx(other.u, rel=1e-12)
    if r:  # uncorrelated estimates of an ensemble are one term to GTC, two independent ones here
        assert found.freedom == pytest.approx(other.df, rel=1e-9)


def test_a_group_is_fully_correlated_and_signs_count() -> None:
    added = budget(make([(1.0, 1.0, math.inf), (2.0, 1.0, math.inf)], group="table"))
    cancelled = budget(make([(1.0, 2.0, math.inf), (2.0, -1.0, math.inf)], group="table"))
    assert added.standard_uncertainty() == pytest.approx(3.0)
    assert cancelled.standard_uncertainty() == 0.0


def test_end_gauge_of_jcgm_100_h_1() -> None:
    """H.1.6: u_c = 32 nm, 16 effective degrees of freedom, U99 = 2.92 x 32 nm = 93 nm."""
    parts = [(25.0, 18.0), (5.8, 24.0), (3.9, 5.0), (6.7, 8.0), (2.9, 50.0), (16.6, 2.0)]
    found = budget(make([(u, 1.0, freedom) for u, freedom in parts])).expand(p=0.99)
    assert round(found.u) == 32
    assert math.floor(found.freedom) == 16
    assert found.k == pytest.approx(2.92, abs=0.02)  # read from the table at 16
    assert found.expanded == pytest.approx(93, rel=0.015)


def test_types_a_and_b_add_in_squares() -> None:
    certificate = Component.from_certificate("table", "转台", 0.8, 2, "1")
    found = budget((certificate, *make([(0.3, 1.0, 5.0)])))
    assert found.standard_uncertainty("A") == pytest.approx(0.3)
    assert found.standard_uncertainty("B") == pytest.approx(0.4)
    assert found.standard_uncertainty() == pytest.approx(0.5)
    assert found.freedom == pytest.approx(5 * (0.5 / 0.3) ** 4)


@pytest.mark.parametrize(
    ("correlations", "message"),
    [
        ((Correlation("x0", "x9", 0.5),), "the budget has the components x0, x1, x2"),
        ((Correlation("x0", "x1", 1.5),), "not within -1 .. 1"),
        ((Correlation("x0", "x0", 0.5),), "with itself"),
        (
            (Correlation("x0", "x1", 0.9), Correlation("x1", "x2", 0.9), Correlation("x0", "x2", -0.9)),
            "contradict each other",
        ),
    ],
)
def test_impossible_correlations_are_refused(correlations: tuple[Correlation, ...], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        budget(make([(1.0, 1.0, 5.0)] * 3), *correlations).expand()


def test_names_are_unique() -> None:
    twice = make([(1.0, 1.0, 5.0)]) * 2
    with pytest.raises(BadInput, match="x0 occurs twice"):
        budget(twice).standard_uncertainty()


def test_unknown_components_leave_no_expanded_uncertainty() -> None:
    found = Budget(
        en="bias", zh="零偏", value=0.0, unit="deg/h", components=make([(1.0, 1.0, 5.0)]),
        unknown=(Unknown("levelling", "调平", "the station states none"),),
    )  # fmt: skip
    assert found.standard_uncertainty("A") == 1.0
    with pytest.raises(NotEnoughData, match="levelling: the station states none"):
        found.expand()


@pytest.mark.parametrize("bad", [{"k": 2, "p": 0.95}, {"k": 0}, {"p": 1.0}, {"k": math.nan}])
def test_k_and_p_are_checked(bad: dict[str, float]) -> None:
    with pytest.raises(BadInput):
        budget(make([(1.0, 1.0, 5.0)])).expand(**bad)


@pytest.mark.parametrize("stated", [-1.0, math.nan, math.inf])
def test_a_component_is_a_finite_number(stated: float) -> None:
    with pytest.raises(BadInput, match="finite number"):
        Component.from_certificate("table", "转台", stated, 2, "1")


@given(_COMPONENTS)
def test_coverage_factor_and_probability_belong_together(parts: list[tuple[float, float, float]]) -> None:
    found = budget(make(parts))
    by_p = found.expand(p=0.9)
    assert found.expand(k=by_p.k).p == pytest.approx(0.9, abs=1e-9)
    assert np.isfinite(by_p.expanded)
