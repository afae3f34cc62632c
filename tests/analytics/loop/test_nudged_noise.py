"""The filter for several noises side by side, against the filter for one."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.whitening.nudged_noise import SIDE_BY_SIDE, prediction_errors
from tests.analytics.loop.test_tracing_whitening import record

coefficient = st.floats(1e-4, 1.0)
noise = st.builds(ModelNoise, N=coefficient, B=coefficient, K=coefficient, turn_on=coefficient)


@given(noises=st.lists(noise, min_size=1, max_size=SIDE_BY_SIDE), seed=st.integers(0, 99), gap=st.integers(0, 40))
def test_each_noise_is_filtered_as_if_alone(noises: list[ModelNoise], seed: int, gap: int) -> None:
    of = record(seed, runs=3, blocks=80)
    of.steps[20] += gap
    error, variance = prediction_errors(of, of.value, noises)
    assert error.shape == variance.shape == (len(of), len(noises))
    for number, each in enumerate(noises):
        alone = of.whitener(each)
        np.testing.assert_allclose(variance[:, number], alone.innovation, rtol=1e-9)
        whitened = error[:, number] / np.sqrt(variance[:, number])
        np.testing.assert_allclose(whitened, alone(of.value[:, None])[:, 0], rtol=1e-6, atol=1e-8)
