"""Parts of a power spectral density merge to one pass."""

import itertools
import pickle

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from stream.errors import EstimatorError
from stream.estimators.snapshot import restore, take_snapshot
from stream.estimators.spectral_density import SpectralDensity
from stream.estimators.spectrum.spectral_lines import hann_window, welch_edf
from tests.stream.spectra import RATE_HZ, assert_same, fed, make, spectrum_of, white


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    cuts=st.lists(st.integers(1, 2999), max_size=30),
    holes=st.lists(st.tuples(st.integers(1, 2990), st.integers(1, 600)), max_size=3),
)
def test_the_result_does_not_depend_on_how_the_stream_is_cut(cuts: list[int], holes: list[tuple[int, int]]) -> None:
    values = white(3000) + 15.0
    for start, length in holes:
        values[start : min(start + length, 2999)] = np.nan
    whole = fed([make(values)])
    edges = sorted({0, *cuts, len(values)})
    assert_same(fed([make(values[a:b], a) for a, b in itertools.pairwise(edges)]), whole)
    sent = np.isfinite(values)
    edges = np.flatnonzero(np.diff(sent.astype(np.int8), prepend=0, append=0)).tolist()
    runs = [make(values[a:b], a) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    assert_same(fed(runs), whole)
    used = [i for i in range(0, 3000 - 255, 128) if sent[i : i + 256].all()]
    assert whole.segments == len(used)
    assert whole.segments_left_out == 22 - len(used)
    if used:
        segments = np.array([values[i : i + 256] for i in used])
        _, expected = scipy.signal.periodogram(segments, RATE_HZ, hann_window(256), detrend="constant")
        spectrum = spectrum_of(whole)
        np.testing.assert_allclose(spectrum.density, expected.mean(axis=0)[2:-1], rtol=1e-10)
        pairs = sum(b - a == 128 for a, b in itertools.pairwise(used))
        assert spectrum.edf == welch_edf(len(used), pairs)


@pytest.mark.long
@settings(max_examples=300, deadline=None, derandomize=True)
@given(data=st.data())
def test_parts_merge_to_one_pass_wherever_the_seams_lie(data: st.DataObject) -> None:
    """Around the seams: parts shorter than a segment, gaps at and across them, merged in any association."""
    values = white(3000) + 15.0
    values[: data.draw(st.sampled_from([0, 1, 128, 700]))] = np.nan
    seams = data.draw(st.lists(st.integers(0, 3000) | st.sampled_from([128, 256, 1024, 1025]), min_size=1, max_size=8))
    edges = sorted({0, *seams, 3000})
    shift = 0
    batches = []
    for a, b in itertools.pairwise(edges):
        batches.append(make(values[a:b], a + shift))
        shift += data.draw(st.sampled_from([0, 0, 0, 1, 100, 128, 256, 1000]))
    whole = fed(batches)
    waiting = [SpectralDensity(256)]
    for batch in batches:
        waiting[-1].update(batch)
        waiting.append(waiting[-1].continuation())
        if data.draw(st.booleans()):
            waiting.append(waiting[-1].continuation())
    while len(waiting) > 1:
        at = data.draw(st.integers(0, len(waiting) - 2))
        later = waiting.pop(at + 1)
        waiting[at].merge(pickle.loads(pickle.dumps(later)) if data.draw(st.booleans()) else later)
    assert_same(waiting[0], whole)
    assert waiting[0].state_bytes == whole.state_bytes
    after = make(white(600, 2), edges[-1] + shift)
    for each in (waiting[0], whole):
        each.update(after)
    assert_same(waiting[0], whole)


def test_a_part_alone_is_the_spectrum_of_its_own_segments() -> None:
    values = white(3000)
    first = fed([make(values[:1000])])
    part = first.continuation()
    part.update(make(values[1000:], 1000))
    expected = fed([make(values[1024:])])
    np.testing.assert_allclose(spectrum_of(part).density, spectrum_of(expected).density, rtol=1e-10)
    assert (part.samples, part.segments, part.segments_left_out) == (2000, 14, 0)
    first.merge(part)
    assert (first.segments, first.segments_left_out) == (22, 0)
    assert spectrum_of(first).edf == welch_edf(22, 21)


def test_only_a_part_behind_another_pays_for_its_head() -> None:
    first = fed([make(white(1001))])
    part = first.continuation()
    # segments at 768 and 896 lie across the seam at 1001: slots up to 1152
    assert part.state_bytes - first.state_bytes == 8 * (1152 - 1001)
    assert SpectralDensity(256).continuation().state_bytes == first.state_bytes
    again = restore(take_snapshot(part))
    assert again.state_bytes == part.copy().state_bytes == part.state_bytes
    state = part.export_state()
    with pytest.raises(EstimatorError, match="of another estimator"):
        SpectralDensity(512).import_state(state)
    with pytest.raises(EstimatorError, match="of another estimator"):
        first.import_state(state._replace(arrays=state.arrays[:3]))
    assert first.segments == 6


def test_a_copy_keeps_its_confidence() -> None:
    spectral = SpectralDensity(256, confidence=0.5)
    assert [each.confidence for each in (spectral.copy(), spectral.continuation())] == [0.5, 0.5]
    assert restore(take_snapshot(spectral)).confidence == 0.5
    with pytest.raises(EstimatorError, match="settings must agree"):
        spectral.merge(SpectralDensity(256))
