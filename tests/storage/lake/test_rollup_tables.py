"""Rollups of many channels made at once are those of each channel alone."""

import numpy as np
import pyarrow as pa
from hypothesis import given, settings
from hypothesis import strategies as st

from storage.lake.rollups import merge, roll_up, rollup_tables
from storage.lake.tables import ROLLUP_COLUMNS

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
