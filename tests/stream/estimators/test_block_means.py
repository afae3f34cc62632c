"""Block means do not depend on how the stream is cut, and are those of NumPy."""

import itertools
from uuid import UUID

import numpy as np
import pytest
from hypothesis import strategies as st

from stream.batch import SampleBatch
from stream.errors import BadInput
from stream.estimators.block_means import BlockMeans
from tests.stream.examples import examples

RNG = np.random.default_rng(3)
N = 2000
DT_NS = 10**7
TIMES_NS = np.arange(N) * DT_NS + np.where(np.arange(N) >= 1200, 37 * DT_NS + 3, 0) + RNG.integers(0, DT_NS // 2, N)
VALUES = RNG.standard_normal(N)


def cut(cuts: list[int]) -> list[SampleBatch]:
    edges = [0, *sorted(set(cuts)), N]
    return [
        SampleBatch(
            "U", "rate", "r", UUID(int=1), a, int(TIMES_NS[a]), DT_NS, "deg/s",
            values=VALUES[a:b], times_ns=TIMES_NS[a:b], irregular=True,
        )
        for a, b in itertools.pairwise(edges) if a < b
    ]  # fmt: skip


def means(block_s: float, batches: list[SampleBatch]) -> tuple[list[int], list[float]]:
    stage = BlockMeans(block_s)
    given_out = [out for out in map(stage.push, batches) if out is not None]
    return (
        [int(t) for out in given_out for t in out.time_array],
        [float(v) for out in given_out for v in out.value_array],
    )


@examples(20, 100, st.lists(st.integers(1, N - 1), max_size=8), st.sampled_from([0.05, 0.1, 0.5, 1.0]))
def test_the_cut_does_not_matter_and_the_means_are_right(cuts: list[int], block_s: float) -> None:
    times_ns, values = means(block_s, cut(cuts))
    block = (TIMES_NS - TIMES_NS[0]) // round(block_s * 1e9)
    whole = [b for b in range(int(block[-1])) if 10 * DT_NS * (block == b).sum() >= 9 * round(block_s * 1e9)]
    assert times_ns == [int(TIMES_NS[0]) + b * round(block_s * 1e9) for b in whole]
    assert values == pytest.approx([VALUES[block == b].mean() for b in whole], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("block_s", [0.0, -1.0, float("nan"), float("inf")])
def test_a_length_that_is_none_is_refused(block_s: float) -> None:
    with pytest.raises(BadInput, match="positive"):
        BlockMeans(block_s)


def test_what_is_not_finite_is_missing_and_a_state_goes_on() -> None:
    values = np.arange(100.0)
    values[12] = np.nan
    whole, first = BlockMeans(2.0), BlockMeans(2.0)
    batches = [
        SampleBatch("U", "rate", "r", UUID(int=1), i, i * 10**8, 10**8, "deg/s", values=values[i : i + 10])
        for i in range(0, 100, 10)
    ]
    expected = [whole.push(each) for each in batches]
    found = [first.push(each) for each in batches[:5]]
    second = BlockMeans(2.0)
    second.import_state(first.export_state())
    found += [second.push(each) for each in batches[5:]]
    assert found == expected
    means = np.concatenate([each.value_array for each in expected if each is not None])
    assert means[0] == pytest.approx(np.nanmean(values[:20]))
    assert len(means) == 4


def test_blocks_of_no_whole_number_of_samples_hold_what_falls_into_them() -> None:
    values = np.arange(100.0)
    batch = SampleBatch("U", "rate", "r", UUID(int=1), 0, 0, 10**8, "deg/s", values=values)
    means = BlockMeans(0.15).push(batch)
    assert means is not None
    expected = [values[[i for i in range(100) if b * 15 <= i * 10 < (b + 1) * 15]].mean() for b in range(66)]
    assert means.value_array.tolist() == expected
