"""Samples that repeat the one before are found, and what resolution, noise and slowness repeat is not."""

import numpy as np
import pytest
from scipy.signal import lfilter

from stream.batch import FloatArray
from stream.defects.repeats import repeated_share

N = 4000


def repeated(values: FloatArray, every: int) -> FloatArray:
    """Every so many-th sample is the one before."""
    at = np.arange(values.size)
    found: FloatArray = values[at - (at % every == every - 1)]
    return found


@pytest.mark.parametrize("step", [0.0, 0.01, 0.1])
@pytest.mark.parametrize("every", [2, 4, 7])
def test_a_logger_that_is_faster_than_the_gyro_is_found(step: float, every: int) -> None:
    """Of white noise of deviation 1 the step explains step/(2 sqrt(pi)), 2.8 % at most."""
    noise = np.random.default_rng(every).standard_normal(N)
    values = repeated(np.round(noise / step) * step if step else noise, every)
    # what the step explains as well, with four standard deviations of a binomial
    by_step = step / (2 * np.pi**0.5)
    most = 1 / every + by_step + 4 * (by_step / N) ** 0.5
    assert 1 / every - 1 / N - 0.01 <= repeated_share(values) <= most + 0.01


@pytest.mark.parametrize("held", [3, 5])
def test_each_value_several_times_is_found(held: int) -> None:
    values = np.repeat(np.random.default_rng(1).standard_normal(N // held), held)
    assert repeated_share(values) == pytest.approx(1 - 1 / held, abs=0.02)


@pytest.mark.parametrize(("hertz", "step", "least"), [
    (10, 0.0, 0.89), (8, 0.0, 0.91), (5, 0.0, 0.94), (10, 0.05, 0.89), (8, 0.05, 0.88), (5, 0.05, 0.9),
    (10, 0.2, 0.86), (8, 0.2, 0.8), (5, 0.2, 0.8), (70, 0.2, 0.29),
])  # fmt: skip
def test_the_share_of_a_slow_gyro_in_a_log_of_100_hz_is_a_close_bound(hertz: int, step: float, least: float) -> None:
    """The share is no more than the true one, with four standard deviations of what the step repeats by itself."""
    at = np.floor(np.arange(12_000) * (hertz / 100 * 1.0002) + 0.3).astype(np.int64)
    noise = np.random.default_rng(hertz).standard_normal(int(at[-1]) + 1)
    by_step = step / (2 * np.pi**0.5)
    share = repeated_share((np.round(noise / step) * step if step else noise)[at])
    assert least <= share <= 1 - hertz / 100 + 4 * (hertz / 100 * by_step / at.size) ** 0.5 + 1e-3


@pytest.mark.parametrize("step", [0.01, 0.1, 0.3, 1.0])
def test_noise_of_any_resolution_repeats_by_itself(step: float) -> None:
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        white = rng.standard_normal(N)
        kinds = {
            "white": white, "slow": lfilter([1.0], [1.0, -0.99], white), "tails": rng.standard_t(2, N),
            "temperature": 20.0 + np.arange(N) * step / 6 + 0.1 * step * white,
            "dithered": np.where(np.arange(N) // 37 % 2, 0.05, 3.0) * white,
            "frozen": np.where(np.arange(N) > 0.9 * N, white[0], white),
            "sine": 10.0 * np.sin(0.37 * np.arange(N)) + 0.1 * white,
        }  # fmt: skip
        found += [(kind, seed) for kind, each in kinds.items() if repeated_share(np.round(each / step) * step)]
    assert found == []
