"""Rollups of many channels made at once are those of each channel alone; those of very large values."""

from collections.abc import Callable
from random import Random

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from storage.lake.rollups import Rollup, _bucket_arrays, merge, roll_up, roll_up_channels, rollup_tables
from storage.lake.tables import ROLLUP_COLUMNS
from stream.batch import FloatArray, IntArray

_SECOND_NS = 1_000_000_000
_channels = st.lists(st.lists(st.integers(-(10**9), 4 * 10**10), max_size=30), max_size=6)


def test_the_edges_of_each_channel_are_its_first_and_last_row() -> None:
    two = roll_up(np.arange(3) * 10 * _SECOND_NS, np.array([1.0, 2.0, 4.0]))
    one = roll_up(np.array([5 * _SECOND_NS]), np.array([7.0]))
    empty = roll_up(np.array([5 * _SECOND_NS]), np.array([np.nan]))
    for table in rollup_tables([(3, two), (8, empty), (9, one), (11, one)]):
        assert table.column("channel").to_pylist() == [3, 3, 3, 9, 11]
        assert table.column("edge").to_pylist() == [True, False, True, True, True]


@given(_channels)
@settings(deadline=None)
def test_channels_together_are_as_each_alone(steps: list[list[int]]) -> None:
    rng = np.random.default_rng(2)
    channels = [
        (number, roll_up(np.cumsum(np.array(each, np.int64)), rng.normal(0, 50, len(each))))
        for number, each in enumerate(steps)
    ]
    seconds, tens = rollup_tables(channels)
    for every, table in ((1, seconds), (10, tens)):
        alone = [merge(rollup, every) for _, rollup in channels]
        assert table.schema == ROLLUP_COLUMNS
        assert table.column("channel").to_pylist() == [n for n, each in enumerate(alone) for _ in each.bucket]
        for name in ("bucket", "n", "mean", "m2", "lo", "hi"):
            expected = np.concatenate([np.empty(0), *(getattr(each, name) for each in alone)])
            assert np.array_equal(table.column(name).to_numpy(), expected)
    assert pa.concat_tables([rollup_tables([each])[1] for each in channels] or [tens]).equals(tens)


@given(_channels, st.randoms(use_true_random=False))
@settings(deadline=None)
def test_samples_of_channels_together_are_rolled_up_as_those_of_each(steps: list[list[int]], draw: Random) -> None:
    """Also where a channel goes back in time, and where a channel begins in the second in which another ends."""
    times_ns = [np.cumsum(np.array(each, np.int64)) for each in steps if each]
    data = [np.random.default_rng(len(each)).normal(0, 50, len(each)) for each in times_ns]
    scales, offsets = (np.array([draw.choice([1.0, -0.5, 3.0]) for _ in data]) for _ in range(2))
    if not data:
        return
    sizes = np.array([len(each) for each in data])
    of, together = roll_up_channels(
        np.concatenate(times_ns), np.concatenate(data), np.cumsum(sizes) - sizes, scales, offsets
    )
    each = [roll_up(*samples) for samples in zip(times_ns, data, scales, offsets, strict=True)]
    assert of.tolist() == [number for number, own in enumerate(each) for _ in own.bucket]
    for name in Rollup._fields:
        assert np.array_equal(getattr(together, name), np.concatenate([getattr(own, name) for own in each]))


def by_arrays(t_ns: IntArray, data: FloatArray) -> Rollup:
    bucket, n, mean, m2, lo, hi, _ = _bucket_arrays(t_ns, data, np.zeros(1, np.int64))
    return Rollup(bucket, n, mean, m2, lo, hi)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("make", [roll_up, by_arrays])
def test_means_of_values_whose_sum_overflows_are_right(make: Callable[..., Rollup]) -> None:
    """Deviations of more than 1e154 are infinite, as their squares are no numbers; nothing is NaN."""
    t_ns = np.arange(2000) * 10_000_000
    still = np.full(2000, 1.7e307)
    steep = np.where(np.arange(2000) < 1000, 1.7e308, -1.7e308)
    nearly = np.where(np.arange(2000) == 5, 0.0, 1.7e308)
    for data, mean_of_first in ((still, 1.7e307), (steep, 1.7e308), (nearly, 0.99 * 1.7e308)):
        seconds = make(t_ns, data)
        assert seconds.mean[0] == pytest.approx(mean_of_first, rel=1e-12)
        assert seconds.m2[-1] == 0.0
        _, tens = rollup_tables([(1, seconds)])
        means = [data[:1000].mean(dtype=np.longdouble), data[1000:].mean(dtype=np.longdouble)]
        assert tens["mean"].to_pylist() == pytest.approx([float(each) for each in means], rel=1e-12)
        assert not np.isnan(tens["m2"].to_numpy()).any()
    both = merge(make(t_ns, steep), every=20)
    assert (both.mean.tolist(), both.m2.tolist(), both.lo[0], both.hi[0]) == ([0.0], [np.inf], -1.7e308, 1.7e308)
