"""The compiled least squares of the noise fit beside scipy's."""

import numpy as np
import pytest
from scipy.optimize import nnls

from stream.estimators.noise.noise_kernel import nonnegative_least_squares, residual_of


@pytest.mark.long
@pytest.mark.parametrize("seed", range(6))
def test_non_negative_least_squares_are_those_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(200):
        rows, columns = int(rng.integers(2, 30)), int(rng.integers(1, 7))
        # powers of the averaging time, as the terms of an Allan curve: from independent to nearly dependent
        taus = np.geomspace(1.0, 10.0 ** rng.uniform(0.5, 5.0), rows)
        matrix = np.stack([taus**power for power in rng.uniform(-2.0, 2.0, columns)], 1) * rng.uniform(
            0.5, 2.0, (rows, 1)
        )
        matrix /= np.linalg.norm(matrix, axis=0)
        target = rng.normal(size=rows) if rng.random() < 0.5 else matrix @ np.abs(rng.normal(size=columns))
        ours, (_, residual) = nonnegative_least_squares(matrix, target), nnls(matrix, target, maxiter=1000)
        assert ours.min() >= 0.0
        # nearly dependent columns share a coefficient in many ways; what they leave is unique but for the rounding of
        # slopes, which the condition number magnifies
        rounding = 10.0 * np.finfo(np.float64).eps * np.linalg.cond(matrix) * np.linalg.norm(target)
        assert np.linalg.norm(matrix @ ours - target) <= residual + rounding


def test_a_column_that_repeats_another_changes_nothing() -> None:
    column = np.array([1.0, 2.0, 3.0])
    matrix = np.stack([column, column], 1) / np.linalg.norm(column)
    assert matrix @ nonnegative_least_squares(matrix, column) == pytest.approx(column, rel=1e-12)


@pytest.mark.parametrize("terms", [0, 1, 3])
def test_the_residual_is_that_of_a_projection(terms: int) -> None:
    rng = np.random.default_rng(terms)
    others, target = rng.normal(size=(12, terms)), rng.normal(size=(12, 5))
    basis, _ = np.linalg.qr(others)
    left = residual_of(others, target)
    assert np.allclose(left, target - basis @ (basis.T @ target), rtol=0.0, atol=1e-14)
    twice = residual_of(np.ascontiguousarray(np.column_stack([others, others])), target)  # dependent columns
    assert np.allclose(twice, left, rtol=0.0, atol=1e-13)
