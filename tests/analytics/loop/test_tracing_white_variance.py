"""White variance from neighbours: of ordinary noise, of noise with outliers, and of a signal of coarse steps."""

import numpy as np
import pytest

from analytics.loop.tracing.whitening.white_variance import _class_variance


def test_neighbours_tell_white_noise_beside_a_drift_and_outliers() -> None:
    """2 of 100 values are far off: each spoils two differences, which moves the median by less than 10 %."""
    rng = np.random.default_rng(1)
    noise = rng.normal(0.0, 2.0, 20_000)
    noise[::50] += 1e3
    found = _class_variance(np.diff(noise + 0.01 * np.arange(noise.size)))
    assert found == pytest.approx(4.0, rel=0.15)


def test_coarse_steps_have_a_variance_though_most_neighbours_are_alike() -> None:
    """One value in ten is a step of 1 above the others: variance 0.09, but the median difference is zero.

    The tenth of the differences that is largest is a whole step: a variance of 0.608**2/2, on the safe side.
    """
    rng = np.random.default_rng(2)
    steps = (rng.random(20_000) < 0.1).astype(np.float64)
    found = _class_variance(np.diff(steps))
    assert found == pytest.approx(0.608**2 / 2)
    assert found > 0.09
