"""Laws of estimators; a new estimator in the package is found automatically and checked against them."""

import itertools
import math
import pickle
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stream.batch import FloatArray, IntArray, SampleBatch
from stream.errors import EstimatorError
from stream.estimators import snapshot as snapshot_module
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import Estimator, NoEstimate, all_estimators, estimator_classes
from stream.estimators.snapshot import SNAPSHOT_VERSION, restore, take_snapshot
from stream.estimators.spectral_density import SpectralDensity
from stream.estimators.spectrum.spectral_lines import Spectrum
from stream.events import EstimatePoint
from stream.worker.compile_kernels import warm_up

DT_NS = 100_000_000
DEFAULTS = all_estimators()
# as they are made by default they would say nothing of records as short as those here
SHORT: dict[str, Callable[[], Estimator[Any]]] = {"spectral_density": partial(SpectralDensity, segment_samples=256)}
FACTORIES = DEFAULTS | SHORT
EVERY = pytest.mark.parametrize("key", sorted(FACTORIES))
RELATIVE = 1e-11
# pickled, of the defaults; what continuation() begins may keep more
MOST_BYTES = {"spectral_density": 12 * 4096 + 1024}
MOST_BYTES_BEHIND = {"spectral_density": 20 * 4096 + 1024}


def make(
    values: FloatArray,
    first_slot: int = 0,
    unit: str = "deg/s",
    times_ns: IntArray | None = None,
    irregular: bool = False,
) -> SampleBatch:
    t0_ns = first_slot * DT_NS if times_ns is None else int(times_ns[0])
    return SampleBatch(
        "FOG-1",
        "rate",
        "r1",
        UUID(int=1),
        max(first_slot, 0),
        t0_ns,
        DT_NS,
        unit,
        values=values,
        times_ns=times_ns,
        irregular=irregular,
    )


def signal(n: int = 6000, seed: int = 1) -> FloatArray:
    rng = np.random.default_rng(seed)
    values: FloatArray = rng.standard_normal(n) + 0.01 * np.cumsum(rng.standard_normal(n)) + 15.0
    return values


def fed(key: str, batches: list[SampleBatch]) -> Estimator[Any]:
    estimator = FACTORIES[key]()
    for batch in batches:
        estimator.update(batch)
    return estimator


class Row(NamedTuple):
    """One of the values that an estimate consists of."""

    at: float
    value: float
    lo: float
    hi: float
    edf: float
    n: int
    more: object = None
    power: int = 1


def rows_of(estimator: Estimator[Any]) -> list[Row] | NoEstimate:
    estimate = estimator.estimate()
    if isinstance(estimate, NoEstimate):
        return estimate
    if isinstance(estimate, Spectrum):
        columns = (estimate.frequency_hz, estimate.density, estimate.lo, estimate.hi)
        lines = zip(*(column.tolist() for column in columns), strict=True)
        return [
            Row(at, value, lo, hi, estimate.edf, estimate.segments, estimate.confidence, power=2)
            for at, value, lo, hi in lines
        ]
    assert isinstance(estimate, tuple)
    assert all(isinstance(point, EstimatePoint) for point in estimate)
    return [Row(p.tau_s, p.value, p.lo, p.hi, p.edf, p.n, p.plausible) for p in estimate]


def assert_legal(rows: list[Row] | NoEstimate) -> None:
    if isinstance(rows, NoEstimate):
        assert len(rows.reason) > 10
        return
    assert len(rows) > 0
    for row in rows:
        assert all(math.isfinite(x) for x in row[:5]), row
        assert row.lo <= row.value <= row.hi
        assert row.edf > 0
        assert row.n > 0


def assert_same(a: Estimator[Any], b: Estimator[Any]) -> None:
    first, second = rows_of(a), rows_of(b)
    assert (a.samples, a.missing, a.late) == (b.samples, b.missing, b.late)
    if isinstance(first, NoEstimate) or isinstance(second, NoEstimate):
        assert first == second
        return
    assert [(p.at, p.n) for p in first] == [(p.at, p.n) for p in second]
    np.testing.assert_allclose([p[1:5] for p in first], [p[1:5] for p in second], rtol=RELATIVE, atol=1e-12)


def size_of(estimator: Estimator[Any]) -> int:
    return len(pickle.dumps(estimator))


def test_every_class_is_among_the_defaults() -> None:
    assert {type(factory()) for factory in DEFAULTS.values()} == set(estimator_classes())
    assert FACTORIES.keys() == DEFAULTS.keys()
    warm_up()


@EVERY
def test_names_in_two_languages(key: str) -> None:
    estimator = FACTORIES[key]()
    assert estimator.key == key
    assert all(estimator.names[language].strip() for language in ("en", "zh"))
    assert estimator.confidence == 0.95
    assert (estimator.samples, estimator.missing, estimator.late, estimator.sample_interval_s) == (0, 0, 0, 0.0)


@EVERY
@settings(max_examples=40, deadline=None, derandomize=True)
@given(cuts=st.lists(st.integers(1, 5999), max_size=40), holes=st.lists(st.integers(0, 5900), max_size=5))
def test_the_result_does_not_depend_on_how_the_stream_is_cut(key: str, cuts: list[int], holes: list[int]) -> None:
    values = signal()
    for hole in holes:
        values[hole : hole + 7] = np.nan
    edges = sorted({0, *cuts, len(values)})
    pieces = [make(values[a:b], a) for a, b in itertools.pairwise(edges)]
    assert_same(fed(key, pieces), fed(key, [make(values)]))


@EVERY
def test_single_samples_give_the_same_as_one_batch(key: str) -> None:
    values = signal(2500)
    assert_same(fed(key, [make(values[i : i + 1], i) for i in range(len(values))]), fed(key, [make(values)]))


@EVERY
def test_the_input_is_not_modified_and_may_be_read_only(key: str) -> None:
    values = signal()
    values[17] = np.nan
    times_ns = np.arange(len(values), dtype=np.int64) * DT_NS
    before = values.copy(), times_ns.copy()
    fed(key, [make(values, times_ns=times_ns)]).estimate()
    np.testing.assert_array_equal(values, before[0])
    np.testing.assert_array_equal(times_ns, before[1])
    locked = values.copy()
    locked.flags.writeable = False
    assert_same(fed(key, [make(locked)]), fed(key, [make(values)]))
    spread = np.repeat(values, 2)[::2]
    assert_same(fed(key, [make(spread)]), fed(key, [make(values)]))


@EVERY
def test_estimating_changes_nothing(key: str) -> None:
    values = signal()
    watched = FACTORIES[key]()
    for i in range(0, len(values), 500):
        watched.update(make(values[i : i + 500], i))
        assert rows_of(watched) == rows_of(watched)
    plain = fed(key, [make(values[i : i + 500], i) for i in range(0, len(values), 500)])
    assert rows_of(plain) == rows_of(watched)


@EVERY
@settings(max_examples=40, deadline=None, derandomize=True)
@given(gaps=st.lists(st.tuples(st.integers(1, 5990), st.integers(1, 1500)), min_size=1, max_size=12))
def test_a_gap_is_the_same_as_nan_at_its_place(key: str, gaps: list[tuple[int, int]]) -> None:
    values = signal()
    is_sent = np.ones(len(values), np.bool_)
    for start, length in gaps:
        is_sent[start : min(start + length, len(values) - 1)] = False
    filled = fed(key, [make(np.where(is_sent, values, np.nan))])
    edges = np.flatnonzero(np.diff(is_sent.astype(np.int8), prepend=0, append=0)).reshape(-1, 2).tolist()
    assert_same(fed(key, [make(values[a:b], a) for a, b in edges]), filled)
    slots = np.flatnonzero(is_sent)
    jitter = np.random.default_rng(2).integers(-DT_NS // 20, DT_NS // 20, len(slots))
    timed = make(values[slots], times_ns=slots * DT_NS + jitter)
    assert_same(fed(key, [timed]), filled)
    assert filled.samples + filled.missing == len(values)


@EVERY
def test_a_gap_is_not_closed_up(key: str) -> None:
    """The halves of a ramp are torn apart in time: closing the gap would give another count of averages."""
    values = signal(4000)
    torn = fed(key, [make(values[:2000]), make(values[2000:], 7000)])
    assert torn.missing == 5000
    assert_same(torn, fed(key, [make(np.concatenate([values[:2000], np.full(5000, np.nan), values[2000:]]))]))


@EVERY
def test_memory_is_bounded(key: str) -> None:
    values = np.random.default_rng(3).standard_normal(2_500_000)
    estimator = DEFAULTS[key]()
    sizes = []
    for i in range(40):
        estimator.update(make(values, i * len(values)))
        sizes.append(size_of(estimator))
    assert estimator.samples == 100_000_000
    # a few bytes more are integers that have grown
    assert sizes[-1] <= sizes[0] + 64
    assert sizes[-1] <= MOST_BYTES.get(key, 32_768)
    assert_legal(rows_of(estimator))
    behind = estimator.continuation()
    behind.update(make(values, 40 * len(values)))
    assert size_of(behind) <= MOST_BYTES_BEHIND.get(key, 32_768)
    estimator.merge(behind)
    assert size_of(estimator) <= sizes[0] + 64


@EVERY
@pytest.mark.parametrize("values", [[], [1.0], [math.nan], [math.nan] * 5000, [1.0, math.nan, math.inf]])
def test_too_little_data_is_a_reason(key: str, values: list[float]) -> None:
    estimator = fed(key, [make(np.array(values))] if values else [])
    rows = rows_of(estimator)
    assert isinstance(rows, NoEstimate)
    assert_legal(rows)


@EVERY
def test_a_constant_output_is_zero_or_a_reason(key: str) -> None:
    """A dead sensor: no deviation at all, and never a limit that is not zero."""
    rows = rows_of(fed(key, [make(np.full(6000, 7.25))]))
    assert_legal(rows)
    if not isinstance(rows, NoEstimate):
        assert all((row.value, row.lo, row.hi) == (0.0, 0.0, 0.0) for row in rows)


@EVERY
@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    values=st.lists(st.floats(width=64) | st.sampled_from([0.0, 1.0, math.nan]), min_size=1, max_size=300),
    repeats=st.integers(1, 30),
)
def test_whatever_comes_the_estimate_is_finite_or_a_reason(key: str, values: list[float], repeats: int) -> None:
    assert_legal(rows_of(fed(key, [make(np.tile(np.array(values), repeats))])))


@EVERY
def test_irregular_samples_are_an_estimate_or_a_reason(key: str) -> None:
    rng = np.random.default_rng(4)
    times_ns = np.cumsum(rng.integers(1, 2 * DT_NS, 5000)).astype(np.int64)
    estimator = fed(key, [make(rng.standard_normal(5000), times_ns=times_ns, irregular=True)])
    assert_legal(rows_of(estimator))
    assert (estimator.samples, estimator.late) == (5000, 0)


@EVERY
def test_angular_rates_are_reported_in_degrees_per_hour(key: str) -> None:
    values = signal()
    in_s = fed(key, [make(values, unit="deg/s")])
    in_h = fed(key, [make(values * 3600.0, unit="deg/h")])
    assert in_s.unit_of_measure == in_h.unit_of_measure == "deg/h"
    assert_same(in_s, in_h)
    plain = fed(key, [make(values, unit="degC")])
    assert plain.unit_of_measure == "degC"
    first, second = rows_of(plain), rows_of(in_s)
    assert not isinstance(first, NoEstimate)
    assert not isinstance(second, NoEstimate)
    for p, q in zip(first, second, strict=True):
        factor = 3600.0**p.power
        assert (q.value, q.lo, q.hi) == pytest.approx((factor * p.value, factor * p.lo, factor * p.hi), rel=1e-12)


@EVERY
def test_counts_give_the_same_as_values(key: str) -> None:
    counts = np.random.default_rng(5).integers(-1000, 1000, 5000).astype(np.int32)
    values: FloatArray = counts.astype(np.float64) * 0.25 + 3.0
    in_counts = replace(make(values), values=None, counts=counts, scale=0.25, offset=3.0)
    assert_same(fed(key, [in_counts]), fed(key, [make(values)]))


@EVERY
def test_late_and_repeated_batches_are_counted_and_change_nothing(key: str) -> None:
    values = signal()
    batches = [make(values[i : i + 600], i) for i in range(0, len(values), 600)]
    plain = fed(key, batches)
    disturbed = fed(key, [batches[0], batches[1], batches[0], *batches[2:5], *batches[:5], *batches[5:]])
    overlapping = make(values[5400:], 5400)
    disturbed.update(overlapping)
    assert rows_of(disturbed) == rows_of(plain)
    assert (disturbed.samples, disturbed.missing) == (plain.samples, plain.missing)
    assert disturbed.late == 600 * 7


@EVERY
def test_a_batch_of_another_signal_is_refused(key: str) -> None:
    values = signal(500)
    for other in (
        replace(make(values, 500), unit="FOG-2"),
        replace(make(values, 500), signal="temperature"),
        replace(make(values, 500), unit_of_measure="deg/h"),
        replace(make(values, 500), dt_ns=2 * DT_NS),
    ):
        estimator = fed(key, [make(values)])
        before = rows_of(estimator)
        with pytest.raises(EstimatorError, match="unit FOG-"):
            estimator.update(other)
        assert rows_of(estimator) == before
        assert estimator.samples == 500


@EVERY
def test_instances_may_live_in_different_threads(key: str) -> None:
    streams = [signal(30_000, seed) for seed in range(6)]
    done: dict[int, Estimator[Any]] = {}

    def run(which: int) -> None:
        values = streams[which]
        done[which] = fed(key, [make(values[i : i + 250], i) for i in range(0, len(values), 250)])

    threads = [threading.Thread(target=run, args=(which,)) for which in range(len(streams))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for which, values in enumerate(streams):
        alone = fed(key, [make(values[i : i + 250], i) for i in range(0, len(values), 250)])
        assert rows_of(done[which]) == rows_of(alone)


def parts(key: str, batches: list[SampleBatch], cuts: list[int]) -> list[Estimator[Any]]:
    """Estimators of neighbouring parts of a stream, cut before the batches of those numbers."""
    edges = [0, *sorted(cuts), len(batches)]
    found = [FACTORIES[key]()]
    for first, stop in itertools.pairwise(edges):
        for batch in batches[first:stop]:
            found[-1].update(batch)
        found.append(found[-1].continuation())
    return found


@EVERY
@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=st.data())
def test_parts_merge_in_any_order_to_one_pass(key: str, data: st.DataObject) -> None:
    values = signal(3000, 4)
    values[1400:1410] = np.nan
    if data.draw(st.booleans()):
        values[:200] = np.nan
    size = data.draw(st.sampled_from([7, 64, 100]))
    hole = data.draw(st.sampled_from([0, 1, 33, 5000]))
    batches = [make(values[i : i + size], i + (hole if i >= 2000 else 0)) for i in range(0, len(values), size)]
    cuts = data.draw(st.lists(st.integers(0, len(batches)), min_size=1, max_size=6))
    waiting = parts(key, batches, cuts)
    whole = fed(key, batches)
    while len(waiting) > 1:
        at = data.draw(st.integers(0, len(waiting) - 2))
        if data.draw(st.booleans()):
            waiting[at] = restore(take_snapshot(waiting[at]))
        waiting[at].merge(waiting.pop(at + 1))
    assert_same(waiting[0], whole)
    more = make(signal(3000, 5), 10_000)
    waiting[0].update(more)
    whole.update(more)
    assert_same(waiting[0], whole)


@EVERY
def test_irregular_parts_merge_to_one_pass(key: str) -> None:
    rng = np.random.default_rng(6)
    times_ns = np.cumsum(rng.integers(1, 2 * DT_NS, 4000)).astype(np.int64)
    values = signal(4000)
    batches = [make(values[i : i + 50], times_ns=times_ns[i : i + 50], irregular=True) for i in range(0, 4000, 50)]
    merged, *others = parts(key, batches, [1, 20, 21, 79])
    for other in others:
        merged.merge(other)
    assert_same(merged, fed(key, batches))


@EVERY
def test_merging_leaves_the_later_part_as_it_is(key: str) -> None:
    earlier, later, _ = parts(key, [make(signal(3000)), make(signal(3000, 2), 3000)], [1])
    before = take_snapshot(later)
    earlier.merge(later)
    later_again = restore(before)
    assert rows_of(later) == rows_of(later_again)
    assert take_snapshot(later) == before


@EVERY
def test_what_does_not_go_together_is_not_merged(key: str) -> None:
    batches = [make(signal(500, i), 500 * i) for i in range(4)]
    first, second, third, _ = parts(key, batches, [1, 2])
    before = rows_of(first)
    with pytest.raises(EstimatorError, match=r"only neighbours can be merged; begin the later part with continuation"):
        first.merge(third)
    with pytest.raises(EstimatorError, match="only neighbours can be merged"):
        first.merge(fed(key, batches[1:2]))
    stranger = FACTORIES[key]()
    stranger.update(replace(batches[1], unit="FOG-2"))
    with pytest.raises(EstimatorError, match="of unit FOG-1, signal rate in deg/s cannot be merged with that of unit"):
        first.merge(stranger)
    other = next(make() for name, make in FACTORIES.items() if name != key)
    with pytest.raises(EstimatorError, match="kind and settings must agree"):
        first.merge(other)
    assert rows_of(first) == before
    first.merge(second)
    with pytest.raises(EstimatorError, match="only neighbours"):
        first.merge(second)


@EVERY
@given(cut=st.integers(0, 40), seed=st.integers(0, 3))
@settings(max_examples=25, deadline=None)
def test_a_snapshot_in_mid_stream_goes_on_as_if_nothing_had_happened(key: str, cut: int, seed: int) -> None:
    values = signal(4000, seed)
    values[1000:1010] = np.nan
    batches = [make(values[i : i + 100], i + (500 if i >= 2000 else 0)) for i in range(0, 4000, 100)]
    interrupted = fed(key, batches[:cut])
    restored = restore(take_snapshot(interrupted))
    assert type(restored) is type(interrupted)
    assert restored.key == key
    for batch in batches[cut:]:
        restored.update(batch)
    whole = fed(key, batches)
    assert rows_of(restored) == rows_of(whole)  # to the last bit
    assert (restored.samples, restored.missing, restored.late) == (whole.samples, whole.missing, whole.late)
    assert restored.unit_of_measure == whole.unit_of_measure


@EVERY
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_a_damaged_snapshot_is_a_named_error(key: str, data: st.DataObject) -> None:
    snapshot = bytearray(take_snapshot(fed(key, [make(signal(500))])))
    at = data.draw(st.integers(0, len(snapshot) - 1))
    snapshot[at] ^= data.draw(st.integers(1, 255))
    cut = data.draw(st.integers(0, len(snapshot) - 1))
    for damaged in (bytes(snapshot), bytes(snapshot[:cut])):
        with pytest.raises(EstimatorError, match=r"damaged|no snapshot"):
            restore(damaged)


@EVERY
def test_a_snapshot_is_compact_and_independent(key: str) -> None:
    estimator = fed(key, [make(signal(6000))])
    snapshot = take_snapshot(estimator)
    assert len(snapshot) < estimator.state_bytes + 400
    before = rows_of(estimator)
    restore(snapshot).update(make(signal(100, seed=9), 6000))
    assert rows_of(estimator) == before
    assert b"stream." not in snapshot  # no name of a Python module, as pickle would have


@EVERY
def test_a_snapshot_of_a_newer_version_is_refused(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snapshot_module, "SNAPSHOT_VERSION", 99)
    newer = take_snapshot(fed(key, [make(signal(500))]))
    monkeypatch.undo()
    with pytest.raises(EstimatorError, match=f"version 99, this gyrofleet reads up to {SNAPSHOT_VERSION}: upgrade"):
        restore(newer)


@EVERY
def test_other_settings_are_not_merged(key: str) -> None:
    one = fed(key, [make(signal(500))])
    for name, value in one.arguments.items():
        later = one.continuation()
        try:
            other = type(one)(**{**one.arguments, name: value * 2 or 1.0})
        except EstimatorError:
            continue  # twice as much is not offered
        with pytest.raises(EstimatorError, match="kind and settings must agree"):
            one.merge(other)
        one.merge(later)


def test_a_state_of_other_settings_is_refused() -> None:
    state = AllanDeviation(points_per_octave=1).export_state()
    with pytest.raises(EstimatorError, match="of another estimator"):
        AllanDeviation(points_per_octave=4).import_state(state)
