"""Samples that no noise explains: coarse noise has no pile, and what is clipped or written as one value has."""

import numpy as np
import pytest

from stream.batch import FloatArray
from stream.defects.outliers import count_outliers, piled_share


def coarse(seed: int) -> FloatArray:
    """Noise of 0.1 to 300 counts, with long tails in every third case."""
    rng = np.random.default_rng(seed)
    deviation, n = 10 ** rng.uniform(-1.0, 2.5), int(rng.integers(100, 6000))
    noise = rng.standard_t(2, n) if seed % 3 == 0 else rng.standard_normal(n)
    return np.round(rng.uniform(-0.5, 0.5) + deviation * noise)


def test_coarse_noise_has_no_pile() -> None:
    # no value of a smooth distribution is thrice as frequent as the two beside it, where these are many
    assert [seed for seed in range(300) if piled_share(coarse(seed))[0] > 0.0] == []


@pytest.mark.parametrize("share", [0.05, 0.3, 0.6])
def test_what_is_clipped_or_lost_is_a_pile(share: float) -> None:
    noise = np.round(np.random.default_rng(2).normal(1000.0, 40.0, 5000))
    limit = np.quantile(noise, 1.0 - share)
    clipped, lost = np.minimum(noise, limit), np.where(np.random.default_rng(3).random(5000) < share, 0.0, noise)
    for values, at in ((clipped, limit), (lost, 0.0)):
        found, where = piled_share(values)
        assert where == at
        assert abs(found - np.mean(values == at)) < 1e-12


def test_lost_samples_of_a_coarse_output_are_apart_from_the_others() -> None:
    values = np.round(np.random.default_rng(6).normal(200.0, 1.0, 1000))
    assert piled_share(values)[0] == 0.0
    values[::20] = 0.0
    assert piled_share(values) == (0.05, 0.0)


def test_two_fill_values_side_by_side_are_a_pile_and_one_at_an_end_is_an_outlier() -> None:
    values = np.random.default_rng(7).standard_normal(1000)
    values[500:502] = -9999.0
    assert piled_share(values) == (0.002, -9999.0)
    for at in (0, -1):
        values = np.random.default_rng(8).standard_normal(1000)
        values[at] = -9999.0
        assert count_outliers([values]).count == 1
    assert count_outliers([5.0 * np.arange(1000.0) + np.random.default_rng(9).standard_normal(1000)]).count == 0


def test_both_ends_of_a_range_count() -> None:
    values = np.clip(np.random.default_rng(4).standard_normal(2000), -1.0, 1.0)
    assert piled_share(values)[0] == pytest.approx(np.mean(np.abs(values) == 1.0))


def test_outliers_of_pieces_are_counted_together() -> None:
    noise = np.random.default_rng(5).standard_normal((2, 1000))
    noise[:, 500] += 30.0
    assert count_outliers(noise).count == 2
