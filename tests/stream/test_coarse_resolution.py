"""The mean of noise that is rounded to few levels is as far off as the bound says, and no farther."""

import numpy as np
import pytest

from stream.defects.coarse_resolution import rounding_bound


@pytest.mark.parametrize("sigma", [0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 3.0])
def test_the_rounding_error_of_a_mean_is_within_its_bound(sigma: float) -> None:
    n, farthest = 20_000, 0.0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        mean = rng.uniform(-0.5, 0.5)
        values = np.round(mean + sigma * rng.standard_normal(n))
        bound = rounding_bound(values)
        off, by_chance = abs(float(values.mean()) - mean), 5 * (sigma**2 + 1 / 12) ** 0.5 / n**0.5
        assert off <= bound + by_chance, seed
        farthest = max(farthest, bound)
    # the error where the mean lies between a level and a threshold; none from one step of noise on
    largest = np.exp(-2 * (np.pi * sigma) ** 2) / np.pi
    assert farthest >= largest if sigma < 0.6 else farthest < 1e-4


def test_many_levels_few_samples_and_a_constant_have_no_bound() -> None:
    noise = np.random.default_rng(1).standard_normal(5000)
    for values in (noise, np.round(noise * 5.0), np.zeros(5000), np.round(noise[:20])):
        assert rounding_bound(values) == 0.0
    # a step of any size, at any place
    assert rounding_bound(50.0 * np.round(0.4 * noise) + 1e6) == pytest.approx(
        50.0 * rounding_bound(np.round(0.4 * noise))
    )
