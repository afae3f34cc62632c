"""Every deviation with full overlap against its definition, independent code, and what it must not see."""

from collections.abc import Sequence

import allantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stream.batch import FloatArray
from stream.errors import EstimatorError
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import LEAST_SHARE, NoEstimate
from stream.estimators.confidence import least_edf
from stream.estimators.full_overlap import deviation_forms, prefix_record
from stream.estimators.full_overlap.deviation_forms import Deviation
from stream.estimators.full_overlap.full_overlap import FullOverlap, averaging_factors
from stream.events import EstimatePoint
from tests.batches import rate_batch

DT_NS = 10_000_000
OVERLAPPED = (Deviation.OVERLAPPING_ALLAN, Deviation.OVERLAPPING_HADAMARD, Deviation.MODIFIED_ALLAN)
HADAMARD = (Deviation.HADAMARD, Deviation.OVERLAPPING_HADAMARD)


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    make_tiny(monkeypatch)


def make_tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of 7, more than three of them on disk, and running sums that begin again every 5."""
    monkeypatch.setattr(prefix_record, "BLOCK", 7)
    monkeypatch.setattr(prefix_record, "MEMORY_SAMPLES", 21)
    monkeypatch.setattr(deviation_forms, "_RESTART", 5)


def taken(values: FloatArray, size: int = 1000, first_slot: int = 0, record: FullOverlap | None = None) -> FullOverlap:
    record = record or FullOverlap()
    for i in range(0, len(values), size):
        record.update(rate_batch(values[i : i + size], first_slot + i))
    return record


def evaluated(record: FullOverlap, kind: Deviation, factors: Sequence[int] | None = None) -> dict[int, EstimatePoint]:
    points = record.evaluate(kind, factors=factors)
    assert not isinstance(points, NoEstimate)
    return {round(point.tau_s / (DT_NS / 1e9)): point for point in points}


def mean_or_nan(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.mean(finite)) if len(finite) and len(finite) >= LEAST_SHARE * len(values) else np.nan


def defined(values: FloatArray, kind: Deviation, m: int) -> tuple[float, int]:
    """The definition, window by window."""
    means = np.array([mean_or_nan(values[i : i + m]) for i in range(len(values) - m + 1)])
    terms = means[m:] - means[:-m]
    if kind in HADAMARD:
        terms = terms[m:] - terms[:-m]
    if kind is Deviation.MODIFIED_ALLAN:
        terms = np.array([mean_or_nan(terms[i : i + m]) for i in range(len(terms) - m + 1)])
    if kind not in OVERLAPPED:
        terms = terms[::m]
    terms = terms[np.isfinite(terms)]
    norm = 6 if kind in HADAMARD else 2
    return (float(np.sqrt(np.mean(terms**2) / norm)), len(terms)) if len(terms) else (0.0, 0)


def assert_defined(record: FullOverlap, values: FloatArray, kind: Deviation, factors: Sequence[int]) -> None:
    reach = 2 if kind in {Deviation.ALLAN, Deviation.OVERLAPPING_ALLAN} else 3
    expected = {m: defined(values, kind, m) for m in factors if reach * m <= len(values)}
    expected = {m: pair for m, pair in expected.items() if pair[1]}
    if not expected:
        assert isinstance(record.evaluate(kind, factors=factors), NoEstimate)
        return
    found = evaluated(record, kind, factors)
    assert {m: point.n for m, point in found.items()} == {m: n for m, (_, n) in expected.items()}
    scale = float(np.nanmax(np.abs(values[np.isfinite(values)])))
    for m, (value, _) in expected.items():
        assert found[m].value == pytest.approx(value, rel=1e-11, abs=1e-12 * scale)


@pytest.mark.in_gate(
    "3-hdev", "3-ohdev", "4-hdev", "3-oadev", "3-mdev", "4-adev", "4-oadev", "4-mdev", "4-ohdev", "100-adev"
)
@pytest.mark.parametrize("kind", Deviation)
@pytest.mark.parametrize("n", [3, 4, 100, 4095, 4096, 4097, 9001])
def test_equal_to_the_definition(kind: Deviation, n: int) -> None:
    values = np.random.default_rng(n).standard_normal(n) + 3.0
    with taken(values) as record:
        assert_defined(record, values, kind, [m for m in (1, 2, 3, 10, 31, 100, 1365, 2048, 3000) if 2 * m <= n])


@pytest.mark.in_gate("0.5-ohdev", "0.1-hdev")
@pytest.mark.parametrize("kind", Deviation)
@pytest.mark.parametrize("loss", [0.0005, 0.02, 0.1, 0.5])
def test_gaps_by_the_definition(kind: Deviation, loss: float) -> None:
    rng = np.random.default_rng(5)
    values = rng.standard_normal(12_000)
    values[rng.random(len(values)) < loss] = np.nan
    values[3000:3400] = np.nan
    with taken(values, size=333) as record:
        assert_defined(record, values, kind, [1, 2, 5, 64, 500, 2500, 4500, 6000])


@pytest.mark.long
@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize("kind", Deviation)
def test_gaps_by_the_definition_in_tiny_blocks_on_disk(kind: Deviation) -> None:
    rng = np.random.default_rng(15)
    values = rng.standard_normal(500).cumsum()
    values[rng.random(500) < 0.02] = np.nan
    values[50:80] = np.inf
    with taken(values, size=11) as record:
        assert record.file_bytes > 3000
        assert_defined(record, values, kind, range(1, 250))


@pytest.mark.long
@settings(deadline=None, max_examples=150)
@given(
    samples=st.lists(st.one_of(st.integers(-1000, 1000).map(float), st.just(np.nan), st.just(-np.inf)), max_size=70),
    size=st.integers(1, 80),
    kind=st.sampled_from(Deviation),
)
def test_any_record_by_the_definition(samples: list[float], size: int, kind: Deviation) -> None:
    values = np.array([1.0, *samples])
    with pytest.MonkeyPatch.context() as patch:
        make_tiny(patch)
        with taken(values, size=size) as record:
            assert_defined(record, values, kind, range(1, 40))


@pytest.mark.long
@pytest.mark.parametrize("kind", Deviation)
def test_blocks_batches_and_disk_make_no_difference(kind: Deviation, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(7)
    values = rng.standard_normal(20_000)
    values[rng.integers(0, 20_000, 40)] = np.nan
    plain = evaluated(taken(values), kind)
    make_tiny(monkeypatch)
    for size in (1, 13, 20_000):
        with taken(values, size=size) as record:
            found = evaluated(record, kind)
        assert list(found) == list(plain)
        for m, point in found.items():
            assert point.value == pytest.approx(plain[m].value, rel=1e-11)
            assert (point.n, point.edf) == (plain[m].n, plain[m].edf)


@pytest.mark.parametrize("kind", Deviation)
def test_equal_to_allantools(kind: Deviation) -> None:
    values = np.random.default_rng(3).standard_normal(30_000) + 5.0
    phase = np.concatenate([[0.0], np.cumsum(values - values[0])])
    found = evaluated(taken(values), kind, [1, 2, 3, 10, 100, 777, 5000])
    reference = getattr(allantools, kind)
    for m, point in found.items():
        expected = reference(phase, rate=1.0, data_type="phase", taus=[m])
        assert point.value == pytest.approx(expected[1][0], rel=1e-11 if kind == "mdev" else 1e-12)
        assert point.n == expected[3][0]


def test_more_samples_may_follow_an_evaluation() -> None:
    values = np.random.default_rng(21).standard_normal(10_000)
    record = taken(values[:5555])
    record.evaluate(Deviation.MODIFIED_ALLAN)
    taken(values[5555:], first_slot=5555, record=record)
    assert record.evaluate(Deviation.MODIFIED_ALLAN) == taken(values).evaluate(Deviation.MODIFIED_ALLAN)


@pytest.mark.long
@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize("before", [1, 6, 7, 8, 30])
@pytest.mark.parametrize("gap", [1, 6, 7, 8, 13, 14, 100])
def test_a_gap_equals_samples_without_a_value(before: int, gap: int) -> None:
    rng = np.random.default_rng(6)
    first, second = rng.standard_normal(before), rng.standard_normal(90)
    with taken(first, 4) as skipped, taken(np.concatenate([first, np.full(gap, np.nan), second]), 10) as filled:
        taken(second, 17, before + gap, skipped)
        assert (skipped.samples, skipped.missing) == (filled.samples, filled.missing) == (before + 90, gap)
        for kind in Deviation:
            assert skipped.evaluate(kind, 8) == filled.evaluate(kind, 8)


@pytest.mark.parametrize("kind", HADAMARD)
def test_hadamard_does_not_see_a_ramp(kind: Deviation) -> None:
    """Whole numbers leave no rounding; others that of a sample, 1e-16 of the ramp, times a block."""
    n = 300_000
    found = evaluated(taken(np.arange(n, dtype=np.float64)), kind)
    assert max(point.value for point in found.values()) < 1e-12 * n
    found = evaluated(taken(np.arange(n, dtype=np.float64) * 1e-3 + 0.7), kind)
    assert max(point.value for point in found.values()) < 1e-12 * 1e-3 * n


@pytest.mark.long
@pytest.mark.parametrize("kind", Deviation)
@pytest.mark.parametrize("is_gapped", [False, True])
def test_a_mean_of_a_million_sigma_costs_no_digits(kind: Deviation, is_gapped: bool) -> None:
    """Not even where the first sample, to which the sums are relative, is far from all others."""
    values = np.round(np.random.default_rng(9).standard_normal(1_000_000) * 2**20) / 2**20
    if is_gapped:
        values[::97] = np.nan
    values[:20_000] = np.nan
    values[0] = 0.0
    factors = [1, 10, 1000, 100_000]
    plain = evaluated(taken(values, 100_000), kind, factors)
    values[1:] += 2.0**20
    shifted = evaluated(taken(values, 100_000), kind, factors)
    for m in factors[:3]:
        assert shifted[m].n == plain[m].n
        assert shifted[m].value == pytest.approx(plain[m].value, rel=1e-9)
    values[0] = np.nan
    shifted = evaluated(taken(values, 100_000), kind, factors)
    values[1:] -= 2.0**20
    plain = evaluated(taken(values, 100_000), kind, factors)
    for m in factors:
        assert shifted[m].value == pytest.approx(plain[m].value, rel=1e-11)


@pytest.mark.parametrize("level", [0.0, 3.7, -1e9])
@pytest.mark.parametrize("kind", Deviation)
def test_constant_input_is_a_deviation_of_zero(level: float, kind: Deviation) -> None:
    values = np.full(10_000, level)
    values[5000:5100] = np.nan
    found = evaluated(taken(values), kind)
    assert len(found) > 10
    assert {(point.value, point.lo, point.hi) for point in found.values()} == {(0.0, 0.0, 0.0)}


@pytest.mark.long
def test_averaging_times_are_those_of_the_flowing_estimator() -> None:
    values = np.random.default_rng(10).standard_normal(20_000)
    for points_per_octave in (1, 2, 4, 8):
        estimator = AllanDeviation(points_per_octave)
        estimator.update(rate_batch(values))
        flowing = estimator.estimate()
        full = taken(values).evaluate(Deviation.OVERLAPPING_ALLAN, points_per_octave)
        assert not isinstance(flowing, NoEstimate)
        assert not isinstance(full, NoEstimate)
        ours = {point.tau_s: point for point in full}
        assert {point.tau_s for point in flowing} <= ours.keys()
        for point in flowing:
            assert point.lo < ours[point.tau_s].value < point.hi
            if point.tau_s <= 16 * DT_NS / 1e9:
                assert ours[point.tau_s].n == point.n
                assert ours[point.tau_s].value == pytest.approx(point.value, rel=1e-12)
                assert ours[point.tau_s].edf == pytest.approx(point.edf, rel=1e-12)
    with pytest.raises(EstimatorError, match="1, 2, 4 or 8"):
        averaging_factors(3, 100)


@pytest.mark.parametrize("m", [33, 100, 257])
def test_few_windows_in_a_tau_hold_the_freedom_of_all(m: int) -> None:
    values = np.random.default_rng(11).standard_normal(20 * m)
    for kind in OVERLAPPED:
        point = evaluated(taken(values), kind, [m])[m]
        filter_factor = 1 if kind is Deviation.MODIFIED_ALLAN else m
        every = least_edf(filter_factor, point.n, m, d=3 if kind in HADAMARD else 2)
        assert point.edf == pytest.approx(every, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize(("kind", "sigma"), [("oadev", 1.0), ("adev", 1.0), ("mdev", 0.5), ("ohdev", 1.0)])
def test_limits_cover_white_noise(kind: str, sigma: float) -> None:
    rng = np.random.default_rng(12)
    m, covered = 16, 0
    for _ in range(300):
        point = evaluated(taken(rng.standard_normal(1024)), Deviation(kind), [m])[m]
        true = np.sqrt(sigma / m) * (np.sqrt(1 + 0.5 / m**2) if kind == "mdev" else 1.0)
        covered += point.lo <= true <= point.hi
    assert covered >= 275
