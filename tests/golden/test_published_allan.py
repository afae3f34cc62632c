"""Published Allan deviations: the NIST SP 1065 data sets and Stable32 on PHASE.DAT."""

from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from stream.batch import FloatArray, SampleBatch
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import NoEstimate
from stream.estimators.confidence import deviation_bounds, edf, least_edf
from stream.events import EstimatePoint
from tests.allan_definition import overlapping_allan_variance

REFERENCE = Path(__file__).parents[2].parent / "shared" / "reference"
STABLE32_CONFIDENCE = 0.683
SP1065_NINE = (892.0, 809.0, 823.0, 798.0, 671.0, 644.0, 883.0, 903.0, 677.0)

needs_reference = pytest.mark.skipif(not REFERENCE.is_dir(), reason=f"the published data sets are not in {REFERENCE}")


def pyramid(values: FloatArray) -> dict[int, EstimatePoint]:
    estimator = AllanDeviation(points_per_octave=8)
    estimator.update(SampleBatch("clock", "y", "r", UUID(int=0), 0, 0, 10**9, "1", values=values))
    points = estimator.estimate()
    assert not isinstance(points, NoEstimate)
    return {round(point.tau_s): point for point in points}


def stable32_frequency() -> FloatArray:
    return np.diff(np.loadtxt(REFERENCE / "phasedat" / "PHASE.DAT"))


@pytest.mark.parametrize(("m", "published"), [(1, 91.22945), (2, 85.95287)])
def test_sp_1065_nine_frequencies(m: int, published: float) -> None:
    values = np.array(SP1065_NINE)
    assert np.sqrt(overlapping_allan_variance(values, m)) == pytest.approx(published, rel=1e-7)
    assert pyramid(values)[m].value == pytest.approx(published, rel=1e-7)


@needs_reference
@pytest.mark.parametrize(("m", "published"), [(1, 2.922319e-01), (10, 9.159953e-02), (100, 3.241343e-02)])
def test_sp_1065_thousand_frequencies(m: int, published: float) -> None:
    values = np.loadtxt(REFERENCE / "nbs14_1000_freq.txt")
    assert np.sqrt(overlapping_allan_variance(values, m)) == pytest.approx(published, rel=3e-7)
    if m <= 16:
        assert pyramid(values)[m].value == pytest.approx(published, rel=3e-7)


@needs_reference
def test_stable32_all_taus() -> None:
    values = stable32_frequency()
    found = pyramid(values)
    table = np.loadtxt(REFERENCE / "phasedat" / "phase_dat_oadev.txt")
    assert len(table) > 100
    for row in table:
        m, published = int(row[0]), row[5]
        assert np.sqrt(overlapping_allan_variance(values, m)) == pytest.approx(published, rel=5e-5)
        if m <= 16:
            assert found[m].value == pytest.approx(published, rel=5e-5)
            assert found[m].n == row[2]


@needs_reference
def test_stable32_octave_limits() -> None:
    """Stable32 takes white noise (alpha 0) throughout; ours never hold a narrower interval than with that."""
    table = np.loadtxt(REFERENCE / "phasedat" / "phase_dat_oadev_octave.txt")
    assert len(table) == 8
    for row in table.tolist():
        m, windows, alpha = int(row[0]), int(row[2]), int(row[3])
        low, value, high = row[4:7]
        lo, hi = deviation_bounds(value, edf(alpha, 2, m, windows, m), STABLE32_CONFIDENCE)
        assert (lo, hi) == pytest.approx((low, high), rel=2e-3)
        wide_lo, wide_hi = deviation_bounds(value, least_edf(m, windows, m), STABLE32_CONFIDENCE)
        assert wide_lo <= lo
        assert wide_hi >= hi
