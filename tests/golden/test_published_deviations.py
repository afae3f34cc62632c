"""Published Allan, modified Allan and Hadamard deviations: the NIST SP 1065 data sets and Stable32 on PHASE.DAT."""

from collections.abc import Sequence
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from stream.batch import FloatArray, SampleBatch
from stream.estimators.base import NoEstimate
from stream.estimators.confidence import deviation_bounds, edf
from stream.estimators.full_overlap.deviation_forms import Deviation
from stream.estimators.full_overlap.full_overlap import FullOverlap
from stream.events import EstimatePoint

REFERENCE = Path(__file__).parents[2].parent / "shared" / "reference"
STABLE32_CONFIDENCE = 0.683
SP1065_NINE = (892.0, 809.0, 823.0, 798.0, 671.0, 644.0, 883.0, 903.0, 677.0)
SP1065_NINE_DEVIATIONS = {
    Deviation.ALLAN: (91.22945, 115.8082),
    Deviation.OVERLAPPING_ALLAN: (91.22945, 85.95287),
    Deviation.MODIFIED_ALLAN: (91.22945, 74.78849),
    Deviation.HADAMARD: (70.80608, 116.7980),
    Deviation.OVERLAPPING_HADAMARD: (70.80607, 85.61487),
}

needs_reference = pytest.mark.skipif(not REFERENCE.is_dir(), reason=f"the published data sets are not in {REFERENCE}")


def deviations(values: FloatArray, kind: Deviation, factors: Sequence[int]) -> dict[int, EstimatePoint]:
    with FullOverlap() as record:
        record.update(SampleBatch("clock", "y", "r", UUID(int=0), 0, 0, 10**9, "1", values=values))
        points = record.evaluate(kind, factors=factors)
    assert not isinstance(points, NoEstimate)
    return {round(point.tau_s): point for point in points}


def stable32_frequency() -> FloatArray:
    return np.diff(np.loadtxt(REFERENCE / "phasedat" / "PHASE.DAT"))


@pytest.mark.parametrize("kind", Deviation)
def test_sp_1065_nine_frequencies(kind: Deviation) -> None:
    found = deviations(np.array(SP1065_NINE), kind, (1, 2))
    assert [point.value for point in found.values()] == pytest.approx(SP1065_NINE_DEVIATIONS[kind], rel=3e-7)


@needs_reference
@pytest.mark.parametrize("kind", Deviation)
def test_sp_1065_thousand_frequencies(kind: Deviation) -> None:
    lines = (REFERENCE / "nbs14_1000_expected.txt").read_text().splitlines()[1:]
    published = {name: list(map(float, numbers)) for name, *numbers in map(str.split, lines)}
    found = deviations(np.loadtxt(REFERENCE / "nbs14_1000_freq.txt"), kind, (1, 10, 100))
    assert len(published[kind]) == 3
    assert [point.value for point in found.values()] == pytest.approx(published[kind], rel=3e-7)


@needs_reference
@pytest.mark.parametrize("kind", Deviation)
@pytest.mark.in_gate("hdev")
def test_stable32_all_taus(kind: Deviation) -> None:
    table = np.loadtxt(REFERENCE / "phasedat" / f"phase_dat_{kind}.txt")
    assert len(table) > 100
    found = deviations(stable32_frequency(), kind, table[:, 0].astype(int).tolist())
    assert list(found) == table[:, 0].tolist()
    for m, _, windows, _, _, value, _ in table.tolist():
        assert found[int(m)].value == pytest.approx(value, rel=5e-5)
        assert found[int(m)].n == windows


@needs_reference
def test_stable32_octave_limits() -> None:
    """Stable32 takes white noise (alpha 0) throughout; ours never hold a narrower interval than with that."""
    table = np.loadtxt(REFERENCE / "phasedat" / "phase_dat_oadev_octave.txt")
    found = deviations(stable32_frequency(), Deviation.OVERLAPPING_ALLAN, table[:, 0].astype(int).tolist())
    assert len(found) == len(table) == 8
    for row in table.tolist():
        m, windows, alpha = int(row[0]), int(row[2]), int(row[3])
        low, value, high = row[4:7]
        white = edf(alpha, 2, m, windows, m)
        assert deviation_bounds(value, white, STABLE32_CONFIDENCE) == pytest.approx((low, high), rel=2e-3)
        assert found[m].edf <= white * (1 + 1e-9)
