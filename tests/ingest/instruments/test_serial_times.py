"""Times and numbers of serial frames: lost and repeated ones, the jitter of the line, clocks and counters."""

import msgspec
import numpy as np
import pytest

from ingest.serial.serial_frames import SerialFrames
from tests.ingest.instruments.serial_gyros import EPOCH, FIXED, SECOND, VARIABLE, fixed, rates, variable


def test_lost_frames_are_gaps_in_the_times_and_numbers_go_on() -> None:
    frames = SerialFrames(FIXED, "U", "r", EPOCH)
    kept = [i for i in range(600) if i not in {5, 6, 7, 300}]
    batches = []
    for start in range(0, 600, 50):
        part = [i for i in kept if start <= i < start + 50]
        batches += frames.feed(b"".join(fixed(i, i) for i in part), SECOND + part[-1] * 5_000_000)
    mine = [batch for batch in batches if batch.signal == "rate"]
    times = np.concatenate([batch.time_array for batch in mine])
    assert times.tolist() == [SECOND + i * 5_000_000 for i in kept]
    assert frames.counts.lost == 4
    assert [batch.seq for batch in mine] == np.cumsum([0, *(len(batch) for batch in mine[:-1])]).tolist()
    assert [batch.times_ns is None for batch in mine].count(False) == 1  # a gap between two batches needs none


def test_a_frame_that_comes_twice_is_one() -> None:
    frames = SerialFrames(FIXED, "U", "r", EPOCH)
    assert rates(frames.feed(fixed(1, 1) + fixed(1, 1) + fixed(2, 2), 0)) == pytest.approx([1e-6, 2e-6])
    assert frames.counts.repeated == 1
    assert frames.feed(fixed(2, 2), 1) == []


def test_the_jitter_of_the_line_is_not_in_the_times() -> None:
    rng = np.random.default_rng(7)
    frames = SerialFrames(FIXED, "U", "r", EPOCH)
    batches = []
    for k in range(400):
        late_ns = 0 if k == 0 else int(rng.exponential(3e6))
        batches += frames.feed(fixed(2 * k, 0) + fixed(2 * k + 1, 0), SECOND + (2 * k + 1) * 5_000_000 + late_ns)
    times = np.concatenate([batch.time_array for batch in batches if batch.signal == "rate"])
    assert np.abs(times - SECOND - np.arange(800) * 5_000_000).max() < 100_000
    assert frames.counts.lost == 0


@pytest.mark.long
@pytest.mark.parametrize("error", [80e-6, -80e-6])
def test_a_clock_that_runs_otherwise_is_followed(error: float) -> None:
    """At 80e-6 a free grid is 96 ms off after 20 min; steered by half of each 10 s it is twice 0.8 ms behind, and one
    window more of drift between two steerings."""
    frames = SerialFrames(FIXED, "U", "r", EPOCH)
    worst = 0.0
    made = [fixed(i, 0) for i in range(256)] * 2
    for k in range(0, 240_000, 50):
        true = SECOND + round((k + 49) * 5_000_000 * (1 + error))
        [batch, _] = frames.feed(b"".join(made[k % 256 : k % 256 + 50]), true)
        worst = max(worst, abs(batch.last_ns - true) / 1e9)
    assert worst < 80e-6 * 10 * 3 + 0.001
    assert frames.times.steering == pytest.approx(error, rel=0.1)
    assert frames.counts.lost == 0


def test_a_whole_turn_of_the_counter_that_was_lost_is_counted() -> None:
    frames = SerialFrames(FIXED, "U", "r", EPOCH)
    frames.feed(b"".join(fixed(i, 0) for i in range(10)), SECOND)
    [batch, _] = frames.feed(b"".join(fixed(i, 0) for i in range(10 + 512, 20 + 512)), SECOND + 522 * 5_000_000)
    assert frames.counts.lost == 512
    assert batch.last_ns == SECOND + 522 * 5_000_000


def test_a_counter_that_starts_anew_is_no_loss_of_a_million_frames() -> None:
    frames = SerialFrames(VARIABLE, "U", "r", EPOCH)
    frames.feed(b"".join(variable(i, 0.0) for i in range(30_000, 30_010)), SECOND)
    [batch] = frames.feed(b"".join(variable(i, 0.0) for i in range(10)), 4 * SECOND)
    assert (frames.counts.restarts, frames.counts.lost) == (1, 0)
    assert batch.t0_ns == 4 * SECOND - 90_000_000
    assert batch.last_ns == 4 * SECOND


def test_without_a_counter_time_tells_of_lost_frames() -> None:
    layout = msgspec.structs.replace(FIXED, counter=None)
    frames = SerialFrames(layout, "U", "r", EPOCH)
    frames.feed(fixed(0, 0) * 10, SECOND)
    [batch, _] = frames.feed(fixed(0, 0) * 10, 3 * SECOND)
    assert frames.counts.lost == 390
    assert batch.last_ns == 3 * SECOND
