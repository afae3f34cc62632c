"""Laws of estimators; a new estimator in the package is found automatically and checked against them."""

import itertools
import math
import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stream.batch import FloatArray
from stream.errors import EstimatorError
from stream.estimators.base import Estimator, NoEstimate, estimator_classes
from stream.worker.compile_kernels import warm_up
from tests.laws.estimator_cases import (
    DEFAULTS,
    DT_NS,
    EVERY,
    FACTORIES,
    MOST_BYTES,
    MOST_BYTES_BEHIND,
    assert_legal,
    assert_same,
    fed,
    make,
    rows_of,
    signal,
    size_of,
)


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
@pytest.mark.parametrize("samples", [250_000, pytest.param(2_500_000, marks=pytest.mark.long)])
def test_memory_is_bounded(key: str, samples: int) -> None:
    values = np.random.default_rng(3).standard_normal(samples)
    estimator = DEFAULTS[key]()
    sizes = []
    for i in range(40):
        estimator.update(make(values, i * len(values)))
        sizes.append(size_of(estimator))
    assert estimator.samples == 40 * samples
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
