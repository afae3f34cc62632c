"""Probability of conformity and risks against simulation, and against JCGM 106's own examples."""

import math

import numpy as np
import pytest

from analytics.uncertainty.conformity import Interval, global_risks, probability_of_conformity

TRIALS = 400_000


def test_single_limits_of_jcgm_106() -> None:
    """7.3.2: z = (T_U - y)/u; p = 0.95 at z = 1.645; 7.5: half at the limit itself."""
    assert probability_of_conformity(1.0, 1.0, Interval(upper=1.0 + 1.645)) == pytest.approx(0.95, abs=1e-4)
    assert probability_of_conformity(3.0, 1.0, Interval(lower=3.0)) == pytest.approx(0.5)


@pytest.mark.long
@pytest.mark.parametrize("u", [0.05, 0.2, 0.6])
@pytest.mark.parametrize(("lower", "upper"), [(None, 1.0), (-1.0, 1.0), (0.0, None)])
def test_probability_of_conformity_is_the_share_that_conforms(
    u: float, lower: float | None, upper: float | None
) -> None:
    """True values that may lie anywhere, measured with u: of those with a similar value, so many conform."""
    rng = np.random.default_rng(11)
    true = rng.uniform(-6, 6, TRIALS)
    value = true + rng.normal(0, u, TRIALS)
    tolerance = Interval(lower, upper)
    conforms = (true >= tolerance.bounds[0]) & (true <= tolerance.bounds[1])
    for centre in np.linspace(-2, 2, 17):
        near = np.abs(value - centre) < 0.1
        expected = np.mean([probability_of_conformity(each, u, tolerance) for each in value[near][:1000]])
        assert np.mean(conforms[near]) == pytest.approx(expected, abs=0.02)


def test_few_degrees_of_freedom_leave_more_doubt() -> None:
    few = probability_of_conformity(0.0, 1.0, Interval(upper=2.0), 3.0)
    assert few < probability_of_conformity(0.0, 1.0, Interval(upper=2.0))


@pytest.mark.long
@pytest.mark.parametrize("guard", [-0.3, 0.0, 0.3])
@pytest.mark.parametrize(("mean", "deviation", "u"), [(0.0, 1.0, 0.2), (1.5, 0.5, 0.3), (0.3, 0.1, 0.5)])
def test_global_risks_are_the_shares_of_a_simulated_process(
    mean: float, deviation: float, u: float, guard: float
) -> None:
    rng = np.random.default_rng(5)
    true = rng.normal(mean, deviation, TRIALS)
    value = true + rng.normal(0, u, TRIALS)
    conforms = np.abs(true) <= 2
    accepted = np.abs(value) <= 2 - guard
    risks = global_risks(mean, deviation, u, Interval(-2.0, 2.0), Interval(-2.0 + guard, 2.0 - guard))
    spread = 4 * math.sqrt(0.25 / TRIALS)
    assert risks.consumer == pytest.approx(np.mean(accepted & ~conforms), abs=spread)
    assert risks.producer == pytest.approx(np.mean(~accepted & conforms), abs=spread)
