"""Records of correlated noise: bounds of the mean and of the deviations, by the module and from a file to a verdict.

The noise is made here: white noise and first-order autoregressions (Markov noise).
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import signal, stats

from analytics.step_records.series_statistics import SeriesStatistics, samples_statistics
from stream.batch import FloatArray

N = 3600
UNITS = 200


def markov(rng: np.random.Generator, n: int, deviation: float, time_s: float, interval_s: float) -> FloatArray:
    """A stationary first-order autoregression."""
    factor = math.exp(-interval_s / time_s)
    noise = rng.normal(0, deviation * math.sqrt(1 - factor**2), n)
    found, _ = signal.lfilter([1], [1, -factor], noise, zi=[factor * rng.normal(0, deviation)])
    return np.asarray(found, np.float64)


def records(seed: int, white: float, deviation: float, time_s: float, interval_s: float) -> list[SeriesStatistics]:
    """Statistics of records whose mean and noise are known."""
    rng = np.random.default_rng(seed)
    t_ns = np.round(np.arange(N) * interval_s * 1e9).astype(np.int64)
    window_ns = int(t_ns[0]), int(t_ns[-1])
    return [
        samples_statistics(t_ns, markov(rng, N, deviation, time_s, interval_s) + rng.normal(0, white, N), window_ns)
        for _ in range(UNITS)
    ]


# least and most by the binomial distribution of 200 records at 95 %, with a chance of 1e-4 on each side
LEAST, MOST = 0.885, 1.0


@pytest.mark.parametrize(
    ("white", "deviation", "time_s", "interval_s", "widest"),
    [
        (1.0, 0.0, 1.0, 1.0, 1.3), (0.0, 2.0, 5.0, 1.0, 1.6), (0.0, 2.0, 20.0, 1.0, 1.7), (0.0, 1.0, 0.3, 0.1, 1.6),
        (0.0, 1.0, 1.0, 0.1, 1.6), (2.0, 1.0, 60.0, 1.0, 2.6),
    ],
)  # fmt: skip
@pytest.mark.in_gate("0.0-2.0-20.0-1.0-1.7")
def test_the_interval_of_a_mean_holds_it_and_is_no_wider_than_needed(
    white: float, deviation: float, time_s: float, interval_s: float, widest: float
) -> None:
    found = records(1, white, deviation, time_s, interval_s)
    means = np.array([each.mean for each in found])
    widths = np.array([stats.t.ppf(0.975, each.freedom) * each.standard_uncertainty for each in found])
    assert LEAST <= np.mean(np.abs(means) <= widths) <= MOST
    # of the true deviation of such means; the deviation of 200 is known to 5 %
    assert np.median(widths) < widest * 1.96 * means.std()


@pytest.mark.parametrize(
    ("white", "deviation", "time_s"), [(1.0, 0.0, 1.0), (0.0, 2.0, 5.0), (2.0, 1.0, 20.0), (2.0, 1.0, 60.0)]
)
@pytest.mark.in_gate("0.0-2.0-5.0")
def test_the_bounds_of_a_deviation_hold_that_of_such_records(white: float, deviation: float, time_s: float) -> None:
    found = records(2, white, deviation, time_s, 1.0)
    for sd, freedom in (
        (np.array([each.sd for each in found]), np.array([each.sd_freedom for each in found])),
        (np.array([each.averages[1].sd for each in found]), np.array([each.averages[1].freedom for each in found])),
    ):
        truth = math.sqrt(float(np.mean(sd**2)))
        low = sd * np.sqrt(freedom / stats.chi2.ppf(0.975, freedom))
        high = sd * np.sqrt(freedom / stats.chi2.ppf(0.025, freedom))
        assert np.mean((low <= truth) & (truth <= high)) >= 0.86  # 0.90 is the least that was found; binomial, 1e-2


@pytest.mark.long
def test_markov_noise_alone_is_no_angle_random_walk(run_command: Callable[..., Any], tmp_path: Path) -> None:
    """Its white part is nothing: it had been 1e-112 deg/sqrt(h) with a tight interval, and a PASS."""
    rng = np.random.default_rng(9)
    rates = 12.0 + markov(rng, N, 2.0, 5.0, 1.0)
    rows = "\n".join(f"{at},{rate:.6f}" for at, rate in enumerate(rates))
    (tmp_path / "m.csv").write_text(f"time[s],rate[deg/h]\n{rows}\n")
    (tmp_path / "limits.toml").write_text(
        'name = "L"\nrevision = "A"\nvalid_from = 2020-01-01\n[[limit]]\nmetric = "angle_random_walk"\nupper = 0.05\n'
        'unit_of_measure = "deg/sqrt(h)"\n'
    )
    at = ("--unit", "M", "--start", "2026-03-02T09:00:00Z", "--procedure", "static_bias", "--position", "IRA_up")
    assert run_command("import", "m.csv", *at, "--store", "s", cwd=tmp_path).code == 0
    assert run_command("limits", "add", "limits.toml", "--store", "s", cwd=tmp_path).code == 0
    (row,) = run_command("verdicts", "--unit", "M", "--store", "s", "--json", cwd=tmp_path).json["verdicts"]
    assert (row["value"], row["verdict"]) == (None, "NO_DATA"), row
    assert "no white noise" in row["reason"]
