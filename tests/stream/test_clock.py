"""Places of samples on the grid of their nominal interval."""

from uuid import UUID

import numpy as np
import pytest

from stream.batch import FloatArray, SampleBatch
from stream.clock import GridTracker, Piece
from stream.errors import EstimatorError

DT_NS = 10_000_000


def regular(t0_ns: int, n: int, dt_ns: int = DT_NS, values: FloatArray | None = None) -> SampleBatch:
    data = np.zeros(n) if values is None else values
    return SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, t0_ns, dt_ns, "deg/s", values=data)


def timed(times_ns: list[int], irregular: bool = False, values: FloatArray | None = None) -> SampleBatch:
    data = np.zeros(len(times_ns)) if values is None else values
    return SampleBatch(
        "FOG-1",
        "rate",
        "r1",
        UUID(int=1),
        0,
        times_ns[0],
        DT_NS,
        "deg/s",
        values=data,
        times_ns=np.array(times_ns, np.int64),
        irregular=irregular,
    )


def slots(pieces: list[Piece]) -> list[int]:
    return [piece.first_slot + i for piece in pieces for i in range(piece.stop - piece.start)]


def test_regular_batches_follow_each_other() -> None:
    tracker = GridTracker()
    assert tracker.place(regular(0, 5)) == [Piece(0, 0, 5)]
    assert tracker.place(regular(5 * DT_NS, 3)) == [Piece(5, 0, 3)]
    assert (tracker.samples, tracker.missing, tracker.late) == (8, 0, 0)
    assert tracker.sample_interval_s == 0.01


def test_a_gap_takes_its_true_place() -> None:
    tracker = GridTracker()
    tracker.place(regular(0, 5))
    assert tracker.place(regular(5 * DT_NS + 1000 * DT_NS + 3_000_000, 2)) == [Piece(1005, 0, 2)]
    assert tracker.missing == 1000


def test_times_give_the_same_places_as_regular_batches() -> None:
    tracker = GridTracker()
    kept = [0, 1, 2, 5, 6, 9]
    pieces = tracker.place(timed([slot * DT_NS + (slot % 3 - 1) * 900_000 for slot in kept]))
    assert slots(pieces) == kept
    assert pieces == [Piece(0, 0, 3), Piece(5, 3, 5), Piece(9, 5, 6)]
    assert tracker.missing == 4


@pytest.mark.parametrize("drift", [-5e-3, 5e-3])
def test_a_drifting_clock_never_makes_a_hole(drift: float) -> None:
    rng = np.random.default_rng(7)
    n = 20_000
    times = np.cumsum(np.full(n, DT_NS * (1 + drift))) + rng.uniform(-0.05, 0.05, n) * DT_NS
    tracker = GridTracker()
    for part in np.array_split(times.astype(np.int64), 37):
        tracker.place(timed(part.tolist()))
    assert (tracker.missing, tracker.late, tracker.next_slot) == (0, 0, n)


def test_what_is_not_later_is_left_out_and_counted() -> None:
    tracker = GridTracker()
    tracker.place(regular(0, 5))
    assert tracker.place(regular(0, 5)) == []
    assert tracker.place(regular(3 * DT_NS, 4)) == [Piece(5, 2, 4)]
    assert tracker.late == 7
    assert slots(tracker.place(timed([s * DT_NS for s in (5, 7, 8, 6, 8, 9, 2, 10)]))) == [7, 8, 9, 10]
    assert tracker.late == 11
    assert tracker.place(timed([0, DT_NS])) == []
    assert (tracker.samples, tracker.missing, tracker.late) == (11, 0, 13)


def test_later_by_less_than_half_an_interval_is_the_next_slot() -> None:
    tracker = GridTracker()
    tracker.place(regular(0, 2))
    assert tracker.place(regular(DT_NS + 1, 2)) == [Piece(2, 0, 2)]


def test_nan_is_missing_at_its_place() -> None:
    tracker = GridTracker()
    assert tracker.place(regular(0, 4, values=np.array([1.0, np.nan, np.inf, 2.0]))) == [Piece(0, 0, 4)]
    assert (tracker.samples, tracker.missing) == (2, 2)
    tracker.place(timed([4 * DT_NS, 6 * DT_NS], values=np.array([np.nan, 1.0])))
    assert (tracker.samples, tracker.missing) == (3, 4)


def test_values_whose_squares_overflow_are_still_finite() -> None:
    tracker = GridTracker()
    tracker.place(regular(0, 3, values=np.array([1e200, -1e200, 1e308])))
    assert (tracker.samples, tracker.missing) == (3, 0)


def test_the_nominal_interval_may_not_change() -> None:
    tracker = GridTracker()
    tracker.place(regular(0, 5))
    tracker.place(regular(5 * DT_NS, 5, dt_ns=DT_NS + DT_NS // 1000))
    with pytest.raises(EstimatorError, match=r"run r1, unit FOG-1, signal rate: .*from 0\.01 s to 0\.0101 s"):
        tracker.place(regular(10 * DT_NS, 5, dt_ns=DT_NS + DT_NS // 100))


def test_irregular_samples_take_one_slot_each() -> None:
    tracker = GridTracker()
    assert tracker.place(timed([0, 3 * DT_NS, 3 * DT_NS + 5], irregular=True)) == [Piece(0, 0, 3)]
    assert tracker.irregular
    assert tracker.place(regular(100 * DT_NS, 2)) == [Piece(3, 0, 2)]
    assert tracker.irregular
    assert tracker.missing == 0


def test_a_gap_of_years_is_a_number_and_of_centuries_an_error() -> None:
    year_ns = 31_557_600 * 10**9
    tracker = GridTracker()
    tracker.place(regular(0, 1))
    assert tracker.place(timed([50 * year_ns, 100 * year_ns]))[-1].first_slot == 100 * year_ns // DT_NS
    tracker = GridTracker()
    tracker.place(regular(-70 * year_ns, 1))
    with pytest.raises(EstimatorError, match="check the clock"):
        tracker.place(regular(140 * year_ns, 1))
    with pytest.raises(EstimatorError, match="check the clock"):
        tracker.place(timed([141 * year_ns, 145 * year_ns]))
