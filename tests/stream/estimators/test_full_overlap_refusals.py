"""What a record with full overlap refuses, leaves out or has no estimate for, and what it leaves behind."""

from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from stream.batch import FloatArray, SampleBatch
from stream.errors import EstimatorError
from stream.estimators.base import NoEstimate
from stream.estimators.full_overlap import prefix_record
from stream.estimators.full_overlap.deviation_forms import Deviation
from stream.estimators.full_overlap.full_overlap import FullOverlap
from tests.batches import rate_batch

DT_NS = 10_000_000


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of 7, more than three of them on disk."""
    monkeypatch.setattr(prefix_record, "BLOCK", 7)
    monkeypatch.setattr(prefix_record, "MEMORY_SAMPLES", 21)


def taken(values: FloatArray, first_slot: int = 0, record: FullOverlap | None = None) -> FullOverlap:
    record = record or FullOverlap()
    record.update(rate_batch(values, first_slot))
    return record


def test_a_long_gap_takes_no_room_and_an_absurd_one_is_refused() -> None:
    values = np.random.default_rng(8).standard_normal(5000)
    record = taken(values, first_slot=90_000_000, record=taken(values))
    assert record.missing == 90_000_000 - 5000
    assert record.file_bytes == 0
    points = record.evaluate(Deviation.OVERLAPPING_ALLAN, factors=[1, 100])
    assert not isinstance(points, NoEstimate)
    assert [point.n for point in points] == [2 * 4999, 2 * (4801 + 10)]
    with pytest.raises(EstimatorError, match=r"run r1, unit FOG-1.*10001 samples spread over.*check the clock"):
        record.update(rate_batch(values[:1], first_slot=10**9))
    with pytest.raises(EstimatorError, match="is closed"):
        record.update(rate_batch(values, first_slot=2 * 10**9))


def test_too_few_samples_give_a_reason() -> None:
    for kind, reach in (("adev", 2), ("oadev", 2), ("mdev", 3), ("hdev", 3), ("ohdev", 3)):
        values = np.arange(float(reach - 1))
        estimate = taken(values).evaluate(Deviation(kind))
        assert isinstance(estimate, NoEstimate)
        assert f"{reach} samples" in estimate.reason
    assert isinstance(FullOverlap().evaluate(Deviation.ALLAN), NoEstimate)
    long = taken(np.arange(10.0)).evaluate(Deviation.ALLAN, factors=[6])
    assert isinstance(long, NoEstimate)


@pytest.mark.parametrize("nothing", [np.nan, np.inf])
@pytest.mark.parametrize("kind", Deviation)
def test_no_finite_value_gives_a_reason(nothing: float, kind: Deviation) -> None:
    record = taken(np.full(100, nothing))
    estimate = record.evaluate(kind)
    assert isinstance(estimate, NoEstimate)
    assert "0 samples, 100 missing" in estimate.reason


@pytest.mark.parametrize("kind", Deviation)
@pytest.mark.parametrize("size", [1e200, 1e308])
def test_values_too_large_to_square_give_a_reason(kind: Deviation, size: float) -> None:
    values = np.array([1.0, np.nan, 1.0, 1.0, size, -size, size, size, size, -size] * 3)
    estimate = taken(values).evaluate(kind)
    assert isinstance(estimate, NoEstimate)
    assert "too large" in estimate.reason


def test_irregular_samples_have_no_deviation() -> None:
    times_ns = np.array([0, DT_NS, 5 * DT_NS, 6 * DT_NS, 6 * DT_NS + 5], np.int64)
    record = FullOverlap()
    values = np.arange(5.0)
    irregular = SampleBatch(
        "FOG-1", "rate", "r1", UUID(int=1), 0, 0, DT_NS, "1", values=values, times_ns=times_ns, irregular=True
    )
    record.update(irregular)
    estimate = record.evaluate(Deviation.OVERLAPPING_HADAMARD)
    assert isinstance(estimate, NoEstimate)
    assert "no grid of 0.01 s, and the Hadamard deviation needs one" in estimate.reason
    assert "--resample SECONDS" in estimate.reason


def test_another_interval_or_unit_is_refused() -> None:
    record = taken(np.arange(10.0))
    with pytest.raises(EstimatorError, match=r"run r1, unit FOG-1.*changes from 0.01 s to 0.02 s"):
        record.update(rate_batch(np.arange(5.0), 10, dt_ns=2 * DT_NS))
    with pytest.raises(EstimatorError, match="in deg/h cannot take a batch of unit FOG-1, signal rate in deg/s"):
        record.update(rate_batch(np.arange(5.0), 10, unit="deg/s"))


def test_late_samples_are_counted_and_left_out() -> None:
    values = np.random.default_rng(13).standard_normal(100)
    record = taken(values, first_slot=0)
    record.update(rate_batch(values[90:], 90))
    assert (record.samples, record.late, record.missing, record.sample_interval_s) == (100, 10, 0, 0.01)
    assert record.evaluate(Deviation.ALLAN) == taken(values).evaluate(Deviation.ALLAN)


def test_angular_rates_are_reported_in_degrees_per_hour() -> None:
    values = np.random.default_rng(14).standard_normal(100)
    seconds = FullOverlap()
    seconds.update(rate_batch(values, unit="deg/s"))
    assert seconds.unit_of_measure == "deg/h"
    for kind in Deviation:
        expected, found = taken(values).evaluate(kind), seconds.evaluate(kind)
        assert not isinstance(expected, NoEstimate)
        assert not isinstance(found, NoEstimate)
        for one, other in zip(expected, found, strict=True):
            assert (other.value, other.hi) == pytest.approx((3600 * one.value, 3600 * one.hi), rel=1e-12)


def test_factors_below_one_are_refused() -> None:
    with pytest.raises(EstimatorError, match="an averaging time of 0 sample intervals"):
        taken(np.arange(10.0)).evaluate(Deviation.ALLAN, factors=[1, 0])


def test_closing_frees_everything() -> None:
    with taken(np.arange(5000.0)) as record:
        pass
    record.close()
    with pytest.raises(EstimatorError, match=r"unit FOG-1, signal rate: .* is closed"):
        record.evaluate(Deviation.ALLAN)
    with pytest.raises(EstimatorError, match="is closed"):
        record.update(rate_batch(np.arange(3.0), 5000))


@pytest.mark.usefixtures("tiny")
def test_a_folder_without_room_is_named(tmp_path: Path) -> None:
    record = FullOverlap(tmp_path / "absent")
    with pytest.raises(EstimatorError, match=r"run r1, unit FOG-1.*absent.*name another folder"):
        record.update(rate_batch(np.arange(1000.0)))


@pytest.mark.usefixtures("tiny")
def test_the_file_lies_in_the_folder_named(tmp_path: Path) -> None:
    with taken(np.arange(1000.0), record=FullOverlap(tmp_path)) as record:
        assert record.file_bytes > 8000
        assert list(tmp_path.iterdir()) == []
    assert record.file_bytes == 0


def test_values_whose_squares_vanish_are_refused_and_equal_ones_are_not() -> None:
    """Their deviation would be 0, with bounds of 0."""
    noise = np.random.default_rng(15).standard_normal(300)
    for tiny in (1e-200, 1e-162, 5e-324):
        found = taken(tiny * noise).evaluate(Deviation.OVERLAPPING_ALLAN)
        assert isinstance(found, NoEstimate)
        assert "differ by too little to be squared" in found.reason
    small = taken(1e-140 * noise).evaluate(Deviation.OVERLAPPING_ALLAN)
    usual = taken(noise).evaluate(Deviation.OVERLAPPING_ALLAN)
    assert not isinstance(small, NoEstimate)
    assert not isinstance(usual, NoEstimate)
    assert [each.value for each in small] == pytest.approx([1e-140 * each.value for each in usual], rel=1e-9, abs=0.0)
    for still in (np.zeros(300), np.full(300, 1e-200)):
        found = taken(still).evaluate(Deviation.OVERLAPPING_ALLAN)
        assert not isinstance(found, NoEstimate)
        assert found[0].value == 0.0
    # whose means over two are alike
    found = taken(np.tile([0.0, 1.0], 150)).evaluate(Deviation.OVERLAPPING_ALLAN, factors=[2])
    assert not isinstance(found, NoEstimate)
