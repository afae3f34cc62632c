"""The pyramid against independent code, its own definition, and gaps pushed slot by slot."""

from uuid import UUID

import allantools
import numpy as np
import pytest

from stream.batch import FloatArray, SampleBatch
from stream.errors import EstimatorError
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import LEAST_SHARE, NoEstimate
from tests.allan_definition import overlapping_allan_variance

DT_NS = 10_000_000


def push(
    estimator: AllanDeviation, values: FloatArray, first_slot: int = 0, size: int = 1000, unit: str = "deg/h"
) -> AllanDeviation:
    for i in range(0, len(values), size):
        t0_ns = (first_slot + i) * DT_NS
        estimator.update(
            SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, t0_ns, DT_NS, unit, values=values[i : i + size])
        )
    return estimator


def results(estimator: AllanDeviation) -> dict[int, tuple[float, int]]:
    points = estimator.estimate()
    assert not isinstance(points, NoEstimate)
    return {round(point.tau_s / 0.01): (point.value, point.n) for point in points}


def assert_same(a: AllanDeviation, b: AllanDeviation, rel: float = 1e-12) -> None:
    first, second = results(a), results(b)
    assert {m: n for m, (_, n) in first.items()} == {m: n for m, (_, n) in second.items()}
    for m in first:
        assert first[m][0] == pytest.approx(second[m][0], rel=rel)


def with_gaps(values: FloatArray, averaging_factor: int, lag: int) -> tuple[float, int]:
    """The definition with gaps, straight from absolute slots."""
    stride = averaging_factor // lag
    squares = []
    for start in range(0, len(values) - 2 * averaging_factor + 1, stride):
        early = values[start : start + averaging_factor]
        late = values[start + averaging_factor : start + 2 * averaging_factor]
        needed = LEAST_SHARE * averaging_factor
        if np.isfinite(early).sum() >= needed and np.isfinite(late).sum() >= needed:
            squares.append((np.nanmean(late) - np.nanmean(early)) ** 2)
    return (float(np.sqrt(np.mean(squares) / 2)), len(squares)) if squares else (0.0, 0)


@pytest.mark.parametrize("points_per_octave", [1, 2, 4, 8])
@pytest.mark.parametrize("size", [1, 97, 1000, 5000])
@pytest.mark.in_gate("1-2")
def test_equal_to_allantools_full_overlap_then_stride(points_per_octave: int, size: int) -> None:
    values = np.random.default_rng(3).standard_normal(12_345) + 5.0
    phase = np.concatenate([[0.0], np.cumsum(values - values[0])])
    estimator = push(AllanDeviation(points_per_octave), values, size=size)
    found = results(estimator)
    assert len(found) >= 10 * points_per_octave
    for m, (value, n) in found.items():
        stride = 1
        while m // stride >= 32:
            stride *= 2
        if n == 1:  # allantools gives no deviation for one pair
            continue
        expected = allantools.oadev(phase[::stride], rate=1.0 / stride, data_type="phase", taus=[m])
        assert value == pytest.approx(expected[1][0], rel=1e-12)
        assert n == expected[3][0]


def test_the_reference_is_allantools_oadev() -> None:
    values = np.random.default_rng(4).standard_normal(2000).cumsum()
    for m in (1, 3, 16, 100, 1000):
        expected = allantools.oadev(values, data_type="freq", taus=[m])[1][0] if m < 1000 else None
        variance = overlapping_allan_variance(values, m)
        assert expected is None or np.sqrt(variance) == pytest.approx(expected, rel=1e-10)
        assert variance > 0
    with pytest.raises(EstimatorError, match="too few for two averages of 1001"):
        overlapping_allan_variance(values, 1001)


@pytest.mark.in_gate("1-0.4", "4-0.4")
@pytest.mark.parametrize("loss", [0.002, 0.05, 0.4])
@pytest.mark.parametrize("points_per_octave", [1, 4])
def test_gaps_by_the_definition(loss: float, points_per_octave: int) -> None:
    rng = np.random.default_rng(5)
    values = rng.standard_normal(3000)
    values[rng.random(len(values)) < loss] = np.nan
    values[1000:1100] = np.nan
    estimator = push(AllanDeviation(points_per_octave), values, size=333)
    found = results(estimator)
    for m, (value, n) in found.items():
        lag = m
        while lag >= 32:
            lag //= 2
        expected, count = with_gaps(values, m, lag)
        assert n == count
        assert value == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize("gap", [1, 2, 15, 31, 32, 33, 64, 65, 1000, 4097, 100_000])
@pytest.mark.parametrize("before", [1, 7, 64, 1001])
def test_skipping_a_gap_equals_pushing_it_slot_by_slot(gap: int, before: int) -> None:
    rng = np.random.default_rng(6)
    first, second = rng.standard_normal(before), rng.standard_normal(9000)
    skipped = push(push(AllanDeviation(), first), second, first_slot=before + gap)
    filled = push(AllanDeviation(), np.concatenate([first, np.full(gap, np.nan), second]))
    assert_same(skipped, filled)
    np.testing.assert_array_equal(skipped._state.places, filled._state.places)
    np.testing.assert_array_equal(skipped._state.windows, filled._state.windows)
    np.testing.assert_allclose(skipped._state.heads, filled._state.heads, rtol=1e-12, atol=1e-12)
    assert (skipped.samples, skipped.missing) == (filled.samples, filled.missing)


def test_gaps_next_to_gaps_equal_pushing_them_slot_by_slot() -> None:
    rng = np.random.default_rng(16)
    values = rng.standard_normal(20_000)
    is_kept = np.ones(len(values), np.bool_)
    for start in rng.integers(0, len(values), 60):
        is_kept[start : start + rng.integers(1, 200)] = False
    is_kept[0] = True
    filled = push(AllanDeviation(2), np.where(is_kept, values, np.nan))
    skipped = AllanDeviation(2)
    edges = np.flatnonzero(np.diff(is_kept.astype(int), prepend=0, append=0))
    for start, stop in edges.reshape(-1, 2).tolist():
        push(skipped, values[start:stop], first_slot=start)
    assert_same(skipped, filled)


def test_years_of_gap_at_1_khz_cost_nothing_and_change_nothing() -> None:
    rng = np.random.default_rng(8)
    first, second = rng.standard_normal(4096), rng.standard_normal(4096)
    gap = (1 << 37) - 4096
    jumped = push(push(AllanDeviation(), first), second, first_slot=4096 + gap)
    # the same place on every block that holds a sample, near enough to be pushed slot by slot
    filled = push(AllanDeviation(), np.concatenate([first, np.full((1 << 17) - 4096, np.nan), second]))
    assert_same(jumped, filled)
    assert jumped.missing == gap


def test_a_large_offset_costs_no_digits() -> None:
    values = np.random.default_rng(9).standard_normal(100_000)
    plain = push(AllanDeviation(), values)
    shifted = push(AllanDeviation(), values + 2.0**20)
    assert_same(plain, shifted, rel=1e-8)


@pytest.mark.parametrize("level", [0.0, 3.7, -1e9])
def test_constant_input_is_a_deviation_of_zero(level: float) -> None:
    estimator = push(AllanDeviation(), np.full(5000, level))
    points = estimator.estimate()
    assert not isinstance(points, NoEstimate)
    assert len(points) > 10
    assert {(point.value, point.lo, point.hi) for point in points} == {(0.0, 0.0, 0.0)}


def test_irregular_samples_have_no_allan_deviation() -> None:
    estimator = AllanDeviation()
    times_ns = np.array([0, 1, 5, 6, 6.5], np.float64) * DT_NS
    estimator.update(
        SampleBatch(
            "FOG-1",
            "rate",
            "r1",
            UUID(int=1),
            0,
            0,
            DT_NS,
            "deg/h",
            values=np.arange(5.0),
            times_ns=times_ns.astype(np.int64),
            irregular=True,
        )
    )
    estimate = estimator.estimate()
    assert isinstance(estimate, NoEstimate)
    assert "no grid of 0.01 s" in estimate.reason
    assert "--resample SECONDS" in estimate.reason


def test_values_too_large_to_square_give_a_reason() -> None:
    estimate = push(AllanDeviation(), np.array([1e200, -1e200, 1e200])).estimate()
    assert isinstance(estimate, NoEstimate)
    assert "too large" in estimate.reason


def test_no_neighbouring_samples_give_a_reason() -> None:
    values = np.array([1.0, np.nan] * 50)
    estimate = push(AllanDeviation(), values).estimate()
    assert isinstance(estimate, NoEstimate)
    assert "50 samples, 50 missing" in estimate.reason


def test_memory_is_small() -> None:
    assert AllanDeviation().state_bytes <= 32_768


def test_other_densities_are_refused() -> None:
    with pytest.raises(EstimatorError, match="1, 2, 4 or 8"):
        AllanDeviation(3)
