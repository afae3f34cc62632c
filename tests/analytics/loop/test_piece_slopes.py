"""Slopes of swings in blocks from the means of their seconds."""

import numpy as np
import pytest

from analytics.loop.blocks.block_reducer import BlockReducer
from analytics.loop.blocks.edge_slope import mean_slope_per_s
from analytics.loop.blocks.piece_slopes import slopes_of
from stream.batch import FloatArray
from tests.analytics.conftest import START_NS, TestedUnits

SECONDS = np.arange(3600.0)


def swing(period_s: float, time_s: FloatArray) -> FloatArray:
    """A swing of 30 deg/s whose amplitude swings as well."""
    whole: FloatArray = 30.0 * np.sin(2 * np.pi * time_s / period_s) * np.cos(2 * np.pi * time_s / 11_000.0)
    return whole


def mean_slopes(period_s: float, block_s: int) -> FloatArray:
    """Of the swing sampled once a second: the mean of its derivative at the samples of each block."""
    derivative = (swing(period_s, SECONDS + 1e-4) - swing(period_s, SECONDS - 1e-4)) / 2e-4
    means: FloatArray = derivative.reshape(-1, block_s).mean(axis=1)
    return means


@pytest.mark.parametrize("period_s", [60.0, 97.0, 200.0, 400.0, 1100.0])
def test_slopes_are_those_of_the_seconds_also_where_a_swing_turns(period_s: float) -> None:
    """Edges of blocks near the ends of a swing had the slopes of whole blocks, off by a fifth."""
    found = slopes_of(np.arange(3600) * 10**9, swing(period_s, SECONDS), np.zeros(3600), np.arange(3600) // 30)
    exact = mean_slopes(period_s, 30)
    assert found.is_smooth[1:-1].all()
    np.testing.assert_allclose(found.of_blocks[1:-1], exact[1:-1], rtol=0, atol=1e-3 * np.abs(exact).max())


def test_slopes_between_a_rest_and_a_swing_are_those_of_the_seconds() -> None:
    """The table rests, noisy, until it begins to swing within a block."""
    rng = np.random.default_rng(3)
    rate = np.where(SECONDS < 900.0, 0.0, swing(200.0, SECONDS - 899.0)) + rng.normal(0.0, 1e-3, 3600)
    found = slopes_of(np.arange(3600) * 10**9, rate, np.zeros(3600), np.arange(3600) // 36)
    edges = np.arange(0.0, 3601.0, 36.0)
    exact = np.diff(np.where(edges < 900, 0.0, swing(200.0, edges - 899.5))) / 36.0
    moving = np.arange(26, 99)  # block 25 begins where the swing does
    # the value at an edge is known to a few times the noise of a second
    np.testing.assert_allclose(found.of_blocks[moving], exact[moving], rtol=0, atol=10 * 1e-3 / 36.0 + 1e-3)
    moves = np.ptp(rate.reshape(-1, 36), axis=1) > 0.02 * np.ptp(rate)
    assert found.is_smooth[26:99][moves[26:99]].all()
    assert not found.is_smooth[:24].any(), "in a rest the means of blocks have less noise"


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.03])
def test_slopes_of_ramps_and_dwells_are_those_of_the_seconds(noise: float) -> None:
    """Blocks with the begin or end of a ramp had the slopes of means of blocks: a time offset was a tenth too small."""
    rng = np.random.default_rng(1)
    lengths = rng.integers(20, 120, 120).astype(float)
    begins = np.concatenate([[0.0], np.cumsum(lengths)])
    levels = np.repeat(rng.uniform(-100.0, 100.0, 61), 2)[:121]
    fine = np.interp(np.arange(0.0, 3600.0, 0.1), begins, levels)
    seconds = (fine + noise * rng.standard_normal(fine.size)).reshape(-1, 10)
    spread = seconds.std(axis=1)
    found = slopes_of(np.arange(3600) * 10**9, seconds.mean(axis=1), spread, np.arange(3600) // 30)
    exact = np.diff(np.interp(np.arange(0.0, 3601.0, 30.0), begins, levels)) / 30.0
    moves = np.abs(exact) > 1.0 / 30.0
    assert found.is_smooth[moves].all()
    off = np.sqrt(np.mean((found.of_blocks - exact)[found.is_smooth] ** 2))
    assert off < 0.005 * np.sqrt(np.mean(exact**2))


def test_a_gap_within_a_block_has_no_slope() -> None:
    """The mean over the seconds that are known; the change across the gap had been divided by them as well."""
    known = (SECONDS % 30 < 8) | (SECONDS % 30 > 17)
    start_ns = (SECONDS[known] * 1e9).astype(np.int64)
    number = (SECONDS[known] // 30).astype(np.int64)
    found = slopes_of(start_ns, swing(200.0, SECONDS[known]), np.zeros(number.size), number)
    derivative = mean_slopes(200.0, 1)
    exact = np.array([derivative[known & (block == SECONDS // 30)].mean() for block in range(120)])
    assert found.is_smooth.all()
    np.testing.assert_allclose(found.of_blocks, exact, rtol=0, atol=0.01 * np.abs(exact).max())


def test_a_rate_reference_of_one_reading_a_second_has_them(tested: TestedUnits) -> None:
    tested.run("r1")
    for signal, unit in (("rate", "deg/h"), ("input_rate", "deg/s")):
        tested.samples("r1", "U1", signal, swing(200.0, SECONDS), unit_of_measure=unit, t0_ns=START_NS, dt_ns=10**9)
    with tested.catalog() as catalog:
        (run,) = BlockReducer(catalog, "rate").reduce("U1").runs
    exact = mean_slopes(200.0, 30)
    np.testing.assert_allclose(mean_slope_per_s(run, "input_rate"), exact, rtol=0, atol=2e-3 * np.abs(exact).max())
