"""Propagation of distributions against the published results of JCGM 101 clause 9."""

import math

import numpy as np
import pytest

from analytics.uncertainty.budget import Budget
from analytics.uncertainty.component import Component
from analytics.uncertainty.correlation import Correlation
from analytics.uncertainty.distribution import Distribution
from analytics.uncertainty.monte_carlo import propagate
from stream.batch import FloatArray
from stream.errors import BadInput


def budget(*components: Component, correlations: tuple[Correlation, ...] = ()) -> Budget:
    return Budget(en="y", zh="y", value=0.0, unit="1", components=components, correlations=correlations)


def normal(name: str, u: float) -> Component:
    return Component.from_certificate(name, name, u, 1, "1")


def uniform(name: str, u: float) -> Component:
    return Component.from_half_width(name, name, u * math.sqrt(3), Distribution.UNIFORM, "1")


@pytest.mark.parametrize(
    ("components", "u", "high"),
    [
        # JCGM 101 table 2: four normals of u = 1; table 3: four uniform ones; table 4: one of them with u = 10
        ([normal(f"x{i}", 1.0) for i in range(4)], 2.0, 3.92),
        ([uniform(f"x{i}", 1.0) for i in range(4)], 2.0, 3.88),
        ([*(uniform(f"x{i}", 1.0) for i in range(3)), uniform("x3", 10.0)], 10.1, 17.0),
    ],
)
def test_additive_models_of_jcgm_101_9_2(components: list[Component], u: float, high: float) -> None:
    found = propagate(budget(*components))
    assert found.is_stable
    assert found.u == pytest.approx(u, rel=0.01)
    assert found.hi == pytest.approx(high, rel=0.01)
    assert found.lo == pytest.approx(-high, rel=0.01)
    assert found.expanded().method == "JCGM 101"


def test_first_order_is_confirmed_for_normals_and_not_for_a_dominant_uniform_one() -> None:
    """JCGM 101 9.2.2.7 and 9.2.4."""
    normals = budget(*(normal(f"x{i}", 1.0) for i in range(4)))
    assert propagate(normals).confirms(normals.expand(p=0.95))
    dominated = budget(*(uniform(f"x{i}", 1.0) for i in range(3)), uniform("x3", 10.0))
    assert not propagate(dominated).confirms(dominated.expand(p=0.95))


def test_comparison_loss_of_jcgm_101_9_4() -> None:
    """9.4.2.2.2: y = x1^2 + x2^2 about 0 with u = 0.005: first order 0, Monte Carlo 50e-6 with u = 50e-6."""
    inputs = budget(normal("x1", 0.005), normal("x2", 0.005))

    def loss(x: FloatArray) -> FloatArray:
        return np.asarray((x**2).sum(axis=0))

    found = propagate(inputs, model=loss)
    assert found.mean == pytest.approx(50e-6, rel=0.01)
    assert found.u == pytest.approx(50e-6, rel=0.01)


@pytest.mark.long
def test_few_degrees_of_freedom_are_wider_by_monte_carlo() -> None:
    """JCGM 101 6.4.9.4: the standard deviation of t is sqrt(v/(v - 2)) times the standard uncertainty of JCGM 100."""
    scatter = budget(Component.type_a("repeatability", "重复性", 0.05, 5, "1"))
    found = propagate(scatter)
    assert found.u == pytest.approx(0.05 * math.sqrt(5 / 3), rel=0.02)
    assert found.hi == pytest.approx(scatter.expand(p=0.95).expanded, rel=0.02)


@pytest.mark.parametrize("distribution", [each for each in Distribution if each.divisor is not None])
def test_half_widths_are_the_ends_and_the_divisor_gives_u(distribution: Distribution) -> None:
    component = Component.from_half_width("x", "x", 2.0, distribution, "1")
    ends = distribution.quantiles(np.array([0.0, 1.0])) * component.u
    np.testing.assert_allclose(ends, [-2.0, 2.0], atol=1e-12)
    grid = (np.arange(200_000) + 0.5) / 200_000
    assert np.std(distribution.quantiles(grid)) == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize("r", [-1.0, -0.4, 0.7, 1.0])
def test_correlation_reaches_the_draws(r: float) -> None:
    pair = budget(normal("a", 1.0), normal("b", 2.0), correlations=(Correlation("a", "b", r),))
    assert propagate(pair).u == pytest.approx(math.sqrt(1 + 4 + 4 * r), rel=0.01)


def test_intervals_of_different_probability_are_not_compared() -> None:
    one = budget(normal("a", 1.0))
    with pytest.raises(BadInput, match="cannot be compared"):
        propagate(one).confirms(one.expand(k=2))
