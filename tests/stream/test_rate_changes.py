"""Changes of the sample rate are found at their place, however the times come; losses and jitter are none."""

from uuid import UUID

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stream.batch import IntArray, SampleBatch
from stream.defects.rate_changes import RateChange, RateChanges


def found(times_ns: IntArray, cuts: list[int]) -> list[RateChange]:
    changes = RateChanges()
    for piece in np.split(times_ns, sorted(cuts)):
        changes.follow(piece)
    return changes.found


@given(
    st.integers(70, 300), st.integers(70, 300), st.sampled_from([0.1, 0.8, 1.2, 2.0, 10.0]),
    st.lists(st.integers(0, 600), max_size=6),
)  # fmt: skip
def test_a_change_is_found_at_its_place(before: int, after: int, ratio: float, cuts: list[int]) -> None:
    at_ns = before * 10**7
    times_ns = np.concatenate([np.arange(before) * 10**7, at_ns + np.arange(after) * round(ratio * 10**7)])
    (change,) = found(times_ns, cuts)
    assert abs(change.t_ns - at_ns) <= max(1.0, ratio) * 10**7
    assert (change.from_hz, change.to_hz) == pytest.approx((100.0, 100.0 / ratio), rel=0.03)


@pytest.mark.parametrize("kind", ["lost", "rounded", "jittered", "at random", "gaps"])
def test_what_keeps_its_rate_has_no_change(kind: str) -> None:
    rng = np.random.default_rng(3)
    times_ns = np.arange(5000) * 10**7
    if kind == "lost":
        times_ns = times_ns[rng.random(5000) < 0.4]
    elif kind == "rounded":
        times_ns = np.unique(times_ns // 7_000_000 * 7_000_000)
    elif kind == "jittered":
        times_ns = np.unique(times_ns + rng.normal(0.0, 3e6, 5000).astype(np.int64))
    elif kind == "at random":
        times_ns = np.cumsum(rng.exponential(1e7, 5000).astype(np.int64) + 1)
    else:
        times_ns = times_ns + np.repeat(np.arange(50) * 77_000_000, 100)
    assert found(times_ns, [1000, 1017, 4000]) == []


@given(st.lists(st.tuples(st.integers(1, 900), st.sampled_from([10**7, 10**7 + 3, 10**8])), min_size=1, max_size=8))
def test_even_batches_are_judged_by_their_ends(pieces: list[tuple[int, int]]) -> None:
    by_batch, by_sample, t0_ns = RateChanges(), RateChanges(), 0
    for n, dt_ns in pieces:
        batch = SampleBatch("U1", "rate", "r1", UUID(int=1), 0, t0_ns, dt_ns, "deg/s", values=np.zeros(n))
        by_batch.follow_batch(batch)
        by_sample.follow(batch.time_array)
        t0_ns += n * dt_ns
    assert [each.t_ns for each in by_batch.found] == [each.t_ns for each in by_sample.found]
    for one, other in zip(by_batch.found, by_sample.found, strict=True):
        assert (one.from_hz, one.to_hz) == pytest.approx((other.from_hz, other.to_hz), rel=0.03)
