"""Estimators, batches and comparisons of the laws of estimators."""

import itertools
import math
import pickle
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest

from stream.batch import FloatArray, SampleBatch
from stream.estimators.base import Estimator, NoEstimate, all_estimators
from stream.estimators.spectral_density import SpectralDensity
from stream.estimators.spectrum.spectral_lines import Spectrum
from stream.events import EstimatePoint
from tests.batches import rate_batch

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


make = partial(rate_batch, unit="deg/s", dt_ns=DT_NS)


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


def parts(key: str, batches: list[SampleBatch], cuts: list[int]) -> list[Estimator[Any]]:
    """Estimators of neighbouring parts of a stream, cut before the batches of those numbers."""
    edges = [0, *sorted(cuts), len(batches)]
    found = [FACTORIES[key]()]
    for first, stop in itertools.pairwise(edges):
        for batch in batches[first:stop]:
            found[-1].update(batch)
        found.append(found[-1].continuation())
    return found
