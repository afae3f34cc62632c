"""The filters for several noises side by side, against the filter for one."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.whitening.nudged_noise import SIDE_BY_SIDE, nudged_sums
from analytics.loop.tracing.whitening.stack import as_array, from_array
from tests.analytics.loop.test_tracing_whitening import record

coefficient = st.floats(1e-3, 1.0)
noise = st.builds(ModelNoise, N=coefficient, B=coefficient, K=coefficient, turn_on=coefficient)
nudges = st.lists(st.lists(st.floats(-2e-3, 2e-3), min_size=4, max_size=4), min_size=1, max_size=SIDE_BY_SIDE)


@given(at=noise, nudged=nudges, seed=st.integers(0, 99), gap=st.integers(0, 40))
def test_the_sums_are_those_of_the_filters_one_after_the_other(
    at: ModelNoise, nudged: list[list[float]], seed: int, gap: int
) -> None:
    of = record(seed, runs=3, blocks=80)
    of.steps[20] += gap
    noises = [from_array(as_array(at) * np.exp(each)) for each in nudged]
    here = of.whitener(at)
    error = here(of.value[:, None])[:, 0] * np.sqrt(here.innovation)
    found = nudged_sums(of, of.value, noises, error, here.innovation)
    changes = []
    for number, each in enumerate(noises):
        there = of.whitener(each)
        whitened = there(of.value[:, None])[:, 0]
        logarithm = np.log(there.innovation / here.innovation)
        moved = (whitened * np.sqrt(there.innovation) - error) / np.sqrt(here.innovation)
        changes.append(np.concatenate([logarithm / np.sqrt(2), moved]))
        np.testing.assert_allclose(found.wider[number], logarithm.sum(), rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found.squares[number], whitened @ whitened, rtol=1e-9)
    products = np.array(changes) @ np.array(changes).T
    np.testing.assert_allclose(found.products, products, rtol=1e-5, atol=1e-9 * products.max() + 1e-15)
