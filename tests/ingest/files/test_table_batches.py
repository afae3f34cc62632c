"""Sampling and batches: nothing lost, whatever the pieces."""

from pathlib import Path
from uuid import UUID

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ingest.tables.batches import Batcher, SignalHead
from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from ingest.tables.timing.grid import MEDIAN_INTERVALS, Sampling, SamplingGrid
from stream.batch import IntArray, SampleBatch

INTERVALS = st.lists(st.sampled_from([10, 10, 10, 10, 11, 9, 13, 20, 100, 1005]), min_size=0, max_size=80)
CUTS = st.lists(st.integers(0, 80), max_size=6)


def sampling(times_ns: IntArray, cuts: list[int] | None = None) -> Sampling:
    grid = SamplingGrid()
    for piece in np.split(times_ns, sorted(cuts or [])):
        grid.add(piece)
    return grid.finish()


def batched(times_ns: IntArray, cuts: list[int], batch_samples: int, *, splits_at_gaps: bool) -> list[SampleBatch]:
    head = SignalHead("G1", "rate", "r", UUID(int=1), 10, "deg/s", irregular=False)
    batcher = Batcher(head, batch_samples, splits_at_gaps=splits_at_gaps)
    values = np.arange(len(times_ns), dtype=np.float64) / 2
    batches: list[SampleBatch] = []
    for piece in np.split(np.arange(len(times_ns)), sorted(cuts)):
        batches.extend(batcher.push(times_ns[piece], values[piece]))
    return [*batches, *batcher.flush()]


@pytest.mark.parametrize(
    ("times_ns", "dt_ns", "off_grid", "worst_ns", "gaps"),
    [
        ([5], 10**9, 0, 0, 0),
        ([0, 100, 200, 300], 100, 0, 0, 0),
        ([0, 100, 210, 300, 400], 100, 0, 10, 0),
        ([0, 100, 211, 300, 400], 100, 2, 11, 0),
        ([0, 100, 200, 1205, 1305], 100, 0, 5, 1),
        ([0, 100, 200, 250, 350, 450], 100, 1, 50, 0),
        ([0, 100, 200, 1_000_237, 1_000_337], 100, 0, 0, 1),
    ],
)
def test_the_grid_is_a_tenth_of_an_interval_wide(
    times_ns: list[int], dt_ns: int, off_grid: int, worst_ns: int, gaps: int
) -> None:
    found = sampling(np.array(times_ns))
    assert (found.dt_ns, found.off_grid, found.worst_ns, found.gaps) == (dt_ns, off_grid, worst_ns, gaps)
    assert found.irregular == (off_grid > 0)


def test_the_median_is_of_the_first_intervals_only() -> None:
    intervals_ns = np.concatenate([np.full(MEDIAN_INTERVALS, 10), np.full(5 * MEDIAN_INTERVALS, 14)])
    found = sampling(np.cumsum(intervals_ns), cuts=[3, 9_999, 10_000, 20_000])
    assert (found.dt_ns, found.off_grid) == (10, 5 * MEDIAN_INTERVALS)


@given(INTERVALS, CUTS)
def test_pieces_do_not_change_the_sampling(intervals_ns: list[int], cuts: list[int]) -> None:
    times_ns = np.cumsum([7, *intervals_ns])
    assert sampling(times_ns, cuts) == sampling(times_ns)


@given(INTERVALS, CUTS, st.integers(1, 20), st.booleans())
def test_batches_lose_nothing_and_do_not_depend_on_pieces(
    intervals_ns: list[int], cuts: list[int], batch_samples: int, splits_at_gaps: bool
) -> None:
    times_ns = np.cumsum([7, *intervals_ns])
    batches = batched(times_ns, cuts, batch_samples, splits_at_gaps=splits_at_gaps)
    assert batches == batched(times_ns, [], batch_samples, splits_at_gaps=splits_at_gaps)
    assert np.concatenate([batch.time_array for batch in batches]).tolist() == times_ns.tolist()
    assert np.concatenate([batch.value_array for batch in batches]).tolist() == (np.arange(len(times_ns)) / 2).tolist()
    assert [batch.seq for batch in batches] == np.cumsum([0, *map(len, batches)])[:-1].tolist()
    for batch in batches:
        intervals = np.diff(batch.time_array)
        assert len(batch) <= batch_samples
        assert (batch.times_ns is None) == bool((intervals == 10).all())
        assert not (splits_at_gaps and (intervals > 15).any())
    if not splits_at_gaps:
        assert {len(batch) for batch in batches[:-1]} <= {batch_samples}


def test_a_batch_does_not_keep_the_block_alive_nor_share_it() -> None:
    times_ns, values = np.arange(10) * 10, np.zeros(10)
    head = SignalHead("G1", "rate", "r", UUID(int=1), 10, "deg/s", irregular=False)
    (batch,) = Batcher(head, 10, splits_at_gaps=True).push(times_ns, values)
    values[:] = 9.0
    assert batch.value_array.sum() == 0.0
    assert batch.value_array.flags.writeable


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_signals_of_a_file_come_side_by_side(tmp_path: Path, suffix: str) -> None:
    seconds = np.arange(9000)
    table = pl.DataFrame({"time[s]": seconds, "rate[deg/h]": seconds / 7, "temperature[degC]": 20 + seconds / 500})
    path = tmp_path / f"run.{suffix}"
    table.write_csv(path) if suffix == "csv" else table.write_parquet(path)
    options = TableOptions(unit="G1", run="r")
    batches = list(TableFile(path, options).batches(lambda unit, run: UUID(int=1)))
    found = [each for each in batches if isinstance(each, SampleBatch)]
    assert len(found) == 18
    reached = dict.fromkeys(("rate", "temperature"), 0)
    for batch in found:
        assert batch.seq == reached[batch.signal]
        reached[batch.signal] = batch.next_seq
        assert abs(reached["rate"] - reached["temperature"]) <= 1000  # a batch
