"""Counters say which frame of the device each one was, however many were lost between."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ingest.can.counters import ForwardTimes, FrameCounter

INTERVAL_NS = 1_000_000


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    modulus=st.sampled_from([4, 16, 256]),
    steps=st.lists(st.integers(1, 700), min_size=1, max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=4),
    first=st.integers(0, 255),
    seed=st.integers(0, 2**32 - 1),
)
def test_numbers_survive_loss_jitter_and_cutting(
    modulus: int, steps: list[int], cuts: list[int], first: int, seed: int
) -> None:
    """With jitter of less than half a turn between two frames, the number is certain."""
    truth = np.concatenate([[0], np.cumsum(steps)])
    room_ns = INTERVAL_NS * modulus // 8 - 1  # two of them make less than the quarter turn of a restart
    jitter = np.random.default_rng(seed).integers(-room_ns, room_ns + 1, len(truth))
    counter = FrameCounter(modulus, INTERVAL_NS)
    edges = sorted({0, len(truth), *(min(cut, len(truth)) for cut in cuts)})
    numbers = []
    for begin, end in pairwise(edges):
        part = truth[begin:end]
        found, keep = counter.follow(part * INTERVAL_NS + jitter[begin:end], (part + first) % modulus)
        assert keep.all()
        numbers += found.tolist()
    assert numbers == truth.tolist()
    assert (counter.lost, counter.repeated, counter.restarts) == (truth[-1] - len(steps), 0, 0)


def test_repeated_and_late_frames_are_left_out() -> None:
    counter = FrameCounter(16, 10)
    numbers, keep = counter.follow(np.array([0, 10, 11, 30, 31, 40]), np.array([15, 0, 0, 2, 1, 3]))
    assert numbers[keep].tolist() == [0, 1, 3, 4]
    assert (counter.lost, counter.repeated) == (1, 2)


def test_a_counter_that_began_anew_after_silence_is_placed_by_time() -> None:
    counter = FrameCounter(16, 10)
    counter.follow(np.array([0, 10]), np.array([7, 8]))
    numbers, _ = counter.follow(np.array([10_000 + 80, 10_000 + 90]), np.array([0, 1]))
    assert (counter.restarts, numbers.tolist()) == (1, [1008, 1009])


def test_without_interval_whole_turns_are_not_seen() -> None:
    counter = FrameCounter(4)
    numbers, keep = counter.follow(np.array([0, 1, 2, 3]), np.array([0, 1, 1, 0]))
    assert (numbers.tolist(), keep.tolist(), counter.lost) == ([0, 1, 1, 4], [True, True, False, True], 2)


@pytest.mark.parametrize("size", [1, 2, 5])
def test_times_go_forward_however_they_are_cut(size: int) -> None:
    t_ns = np.array([10, 10, 10, 5, 20, 2_000_000, 1, 2_000_000, 3_000_000], np.int64)
    forward = ForwardTimes()
    parts = [forward.follow(t_ns[i : i + size])[0] for i in range(0, len(t_ns), size)]
    assert np.concatenate(parts).tolist() == [10, 11, 12, 13, 20, 2_000_000, 2_000_001, 3_000_000]
    assert (forward.retimed, forward.late) == (4, 1)
