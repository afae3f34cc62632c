"""The fit of a sine: the least-squares solution, its frequency, and its uncertainties."""

import math

import numpy as np
import pytest
from scipy import optimize

from analytics.methods.frequency_response import fit_sine
from stream.errors import BadInput


def test_a_sine_fit_is_the_least_squares_solution() -> None:
    rng = np.random.default_rng(2)
    t_s = np.sort(rng.uniform(-1, 1, 700))
    noisy = 3 * np.sin(2 * np.pi * 7.0 * t_s + 2.0) - 5 + 0.4 * rng.standard_normal(700)
    found = fit_sine(t_s, noisy, 7.0)
    columns = np.column_stack([np.cos(2 * np.pi * 7.0 * t_s), np.sin(2 * np.pi * 7.0 * t_s), np.ones(700)])
    (a, b, c), left = np.linalg.lstsq(columns, noisy)[:2]
    assert found.amplitude == pytest.approx(abs(complex(b, a)), rel=1e-12)
    assert found.phase_rad == pytest.approx(np.angle(complex(b, a)), rel=1e-12)
    assert found.offset == pytest.approx(c, rel=1e-12)
    assert found.residual_sd == pytest.approx(math.sqrt(left[0] / 697), rel=1e-12)


def test_a_refined_frequency_is_that_of_a_nonlinear_fit() -> None:
    rng = np.random.default_rng(3)
    t_s = np.linspace(-1, 1, 2001)
    noisy = 3 * np.sin(2 * np.pi * 7.03 * t_s + 2.0) - 5 + 0.4 * rng.standard_normal(2001)
    found = fit_sine(t_s, noisy, 7.0, refine=True)
    (amplitude, frequency, phase, _), _ = optimize.curve_fit(
        lambda t, a, f, p, c: a * np.sin(2 * np.pi * f * t + p) + c, t_s, noisy, p0=(2.5, 7.01, 1.9, -4.9),
        ftol=1e-15, xtol=1e-15,
    )  # fmt: skip
    assert found.frequency_hz == pytest.approx(frequency, rel=1e-8)
    assert found.amplitude == pytest.approx(amplitude, rel=1e-7)
    assert found.phase_rad == pytest.approx(phase, rel=1e-7)
    # it is not led to another line a long way off
    assert fit_sine(t_s, noisy, 20.0, refine=True).frequency_hz == 20.0


def test_uncertainties_of_a_sine_fit_are_the_scatter_of_many() -> None:
    rng = np.random.default_rng(4)
    t_s = np.arange(-100, 100) / 1000
    fits = [fit_sine(t_s, 2 * np.sin(140 * t_s + 1) + 0.5 * rng.standard_normal(200), 70 / np.pi) for _ in range(2000)]
    for each, reported in (("amplitude", "amplitude_uncertainty"), ("phase_rad", "phase_uncertainty_rad")):
        scatter = np.std([getattr(fit, each) for fit in fits])
        mean = math.sqrt(np.mean([getattr(fit, reported) ** 2 for fit in fits]))
        # a standard deviation of 2000 is known to 1/sqrt(4000): four of that
        assert scatter == pytest.approx(mean, rel=4 / math.sqrt(4000))


@pytest.mark.parametrize(
    ("n", "interval_s", "frequency", "message"),
    [
        (5, 0.001, 100.0, "5 samples; a sine fit needs 8"),
        (100, 0.001, 500.0, "2 samples a period"),
        (100, 0.001, 5.0, "one period of 0.2 s is needed"),
    ],
)
def test_a_record_that_holds_no_sine_is_refused(n: int, interval_s: float, frequency: float, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        fit_sine(np.arange(n, dtype=np.float64) * interval_s, np.ones(n), frequency)
