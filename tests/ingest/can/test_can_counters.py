"""Counters say which frame of the device each one was, however many were lost between."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ingest.can.counters import FrameCounter
from ingest.can.forward_times import ForwardTimes
from tests.stream.examples import examples

INTERVAL_NS = 1_000_000


@examples(
    40,
    200,
    modulus=st.sampled_from([4, 16, 256]),
    steps=st.lists(st.integers(1, 700), min_size=1, max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=4),
    first=st.integers(0, 255),
    seed=st.integers(0, 2**32 - 1),
    derandomize=True,
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


def placed(counter: FrameCounter, t_ns: np.ndarray, counts: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the frames, and which are kept, taken in blocks of `size`."""
    parts = [counter.follow(t_ns[i : i + size], counts[i : i + size]) for i in range(0, len(t_ns), size)]
    return np.concatenate([numbers for numbers, _ in parts]), np.concatenate([keep for _, keep in parts])


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    modulus=st.sampled_from([65536, 2**32]),  # of fewer bits it may agree with the time by chance
    lengths=st.lists(st.integers(150, 1500), min_size=2, max_size=5),
    silences=st.lists(st.integers(1, 4000), min_size=5, max_size=5),
    size=st.sampled_from([7, 256, 100_000]),
    stale=st.integers(0, 3),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_counter_that_begins_anew_is_placed_by_time(
    modulus: int, lengths: list[int], silences: list[int], size: int, stale: int, seed: int
) -> None:
    """Power cycles of any length; the last frames before one may come within the next."""
    rng = np.random.default_rng(seed)
    begins = np.cumsum([0, *(length + silence for length, silence in zip(lengths, silences, strict=False))])[:-1]
    counts = np.concatenate([np.arange(length) for length in lengths]) % modulus
    slots = np.concatenate([begin + np.arange(length) for begin, length in zip(begins, lengths, strict=True)])
    t_ns = slots * INTERVAL_NS + rng.integers(0, 5 * INTERVAL_NS, len(slots))
    for end in np.cumsum(lengths)[:-1]:
        t_ns[end - stale : end] = (slots[end] - 1) * INTERVAL_NS  # they waited for as long
    order = np.maximum.accumulate(t_ns)
    numbers, keep = placed(FrameCounter(modulus, INTERVAL_NS), order, counts, size)
    is_stale = np.zeros(len(slots), np.bool_)
    for end in np.cumsum(lengths)[:-1]:
        is_stale[end - stale : end] = True
    # a time is wrong by no more than the delays of the frames that set it, and by the stale frames that are before it
    judged = keep & ~is_stale
    assert np.abs(numbers - slots)[judged].max() <= 5 + stale + 1
    # at most the first frame of each block that is cut off after a restart is missing
    assert (~keep).sum() <= len(lengths) * (1 + stale)
    assert np.all(np.diff(numbers[keep]) > 0)


@pytest.mark.parametrize("size", [1, 5, 1000])
@pytest.mark.parametrize("wrong", [0, 20_000, 40_000])
def test_a_corrupted_counter_costs_its_frame_alone(wrong: int, size: int) -> None:
    counts = np.arange(7000, 7300)
    counts[150] = wrong
    counter = FrameCounter(65536, INTERVAL_NS)
    numbers, keep = placed(counter, np.arange(300) * INTERVAL_NS, counts, size)
    assert np.flatnonzero(~keep).tolist() == [150]
    assert numbers[keep].tolist() == [*range(150), *range(151, 300)]
    assert (counter.strays, counter.restarts, counter.lost) == (1, 0, 1)


@pytest.mark.parametrize("size", [1, 1000])
def test_late_frames_are_no_restart_and_frames_lost_while_the_receiver_stalls_are_no_new_time(size: int) -> None:
    counts = np.r_[0:2000, 1700:1990, 2000:3000, 4000:5000]
    t_ns = np.r_[0:2000, np.full(290, 2000), 2000:3000, 4000:5000] * INTERVAL_NS
    t_ns[2800:3290] = t_ns[3290] - INTERVAL_NS  # frames waited, those after them were lost
    counter = FrameCounter(65536, INTERVAL_NS)
    numbers, keep = placed(counter, t_ns, counts, size)
    assert counter.restarts == 0
    assert np.array_equal(numbers[keep], counts[keep])
    assert counter.strays + counter.repeated == 290
    assert counter.lost == 1000 + (counts.size - 290 - keep.sum())


def test_a_restart_whose_first_frames_were_lost_is_found_by_the_pace() -> None:
    counts = np.r_[0:5000, 300:3000]
    t_ns = np.r_[0:5000, 5010:7710] * INTERVAL_NS
    counter = FrameCounter(65536, INTERVAL_NS)
    numbers, keep = placed(counter, t_ns, counts, 64)
    assert (counter.restarts, int((~keep).sum()) <= 64) == (1, True)
    assert np.array_equal(numbers[keep], (t_ns // INTERVAL_NS)[keep])


def test_a_restart_is_no_loss_where_the_interval_is_not_given() -> None:
    counts = np.r_[0:5000, 0:500]
    t_ns = np.r_[0:5000, 5300:5800] * INTERVAL_NS  # 300 intervals without a frame
    counter = FrameCounter(65536)
    _, keep = placed(counter, t_ns, counts, 100)
    assert keep.all()
    assert (counter.restarts, counter.lost) == (1, 300)


@pytest.mark.parametrize("silence", [1, 16, 60, 130, 200, 250])
@pytest.mark.parametrize("last", [20, 100, 200, 250])  # after 255, 0 is the next
def test_a_counter_of_8_bits_that_begins_anew_is_near_its_time(silence: int, last: int) -> None:
    before = np.arange(256 * 3 + last + 1)
    counts = np.r_[before, np.arange(600)] % 256
    slots = np.r_[before, before[-1] + silence + np.arange(600)]
    t_ns = slots * INTERVAL_NS + np.random.default_rng(last).integers(0, INTERVAL_NS // 2, slots.size)
    numbers, keep = placed(FrameCounter(256, INTERVAL_NS), t_ns, counts, 32)
    assert np.abs(numbers - slots)[keep].max() <= 21
    assert (~keep).sum() <= 21  # at most those by whose pace it is found
