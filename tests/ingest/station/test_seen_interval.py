"""An interval_s that is not the unit's own is found by counter and arrivals, on serial lines and CAN, and first reads
that come late leave no trace."""

from collections.abc import Iterator
from pathlib import Path
from uuid import UUID

import msgspec
import numpy as np
import pytest

from ingest.can.frames import CanFrame, frame_block
from ingest.can.logs.log_file import CanLogFile
from ingest.can.plan import CanPlan
from ingest.can.stream import CanDecoder
from ingest.can.summary import MessageCount
from ingest.seen_interval import IntervalWatch, SeenInterval
from ingest.serial.serial_frames import SerialFrames
from stream.batch import SampleBatch
from stream.errors import BadInput
from tests.ingest.can.test_can_mapping import GRID, imu, mapped
from tests.ingest.instruments.serial_gyros import EPOCH, FIXED, SECOND, fixed

MS = 1_000_000
READ = 50  # frames of 5 ms that one read gives


def reads(seconds: float, late_ns: np.ndarray | None = None, interval_ns: int = 5 * MS) -> Iterator[tuple[int, int]]:
    """Number of the last frame of each read, and when it was read: with the jitter of a line, and late on top."""
    rng = np.random.default_rng(3)
    for k in range(round(seconds * 1e9 / interval_ns / READ)):
        last = (k + 1) * READ - 1
        more = 0 if late_ns is None or k >= len(late_ns) else int(late_ns[k])
        yield last, SECOND + last * interval_ns + int(rng.exponential(2 * MS)) + more


def serial(
    stated_s: float, arrivals: Iterator[tuple[int, int]], lost: range = range(0)
) -> tuple[SerialFrames, list[tuple[SampleBatch, int, int]]]:
    """Frames of FIXED as they come; batches with the number of their last frame, and its arrival."""
    frames = SerialFrames(msgspec.structs.replace(FIXED, interval_s=stated_s), "U", "r", EPOCH)
    made = [fixed(i, 0) for i in range(256)]
    found = []
    for last, t_ns in arrivals:
        mine = [made[i % 256] for i in range(last - READ + 1, last + 1) if i not in lost]
        found += [(each, last, t_ns) for each in frames.feed(b"".join(mine), t_ns) if each.signal == "rate"]
    return frames, found


@pytest.mark.parametrize(("stated_s", "within_s"), [(0.01, 3.0), (0.05, 3.0), (0.001, 3.0), (0.0051, 17.0)])
def test_a_wrong_interval_is_seen_and_its_samples_are_in_no_future(stated_s: float, within_s: float) -> None:
    frames, found = serial(stated_s, reads(40.0))
    seen = frames.times.seen
    assert seen is not None
    assert seen.is_wrong
    assert abs(seen.interval_ns - 5 * MS) <= 2 * seen.uncertainty_ns + 5 * MS * 1e-3
    assert seen.to_write_s == 0.005
    assert "write interval_s = 0.005" in seen.sentence("unit U", "layout.toml")
    wrong = [batch.irregular for batch, _, _ in found]
    assert wrong.index(True) * READ * 0.005 <= within_s
    assert all(wrong[wrong.index(True) :])
    times = np.concatenate([batch.time_array for batch, _, _ in found])
    assert (np.diff(times) > 0).all()
    assert max(batch.last_ns - t_ns for batch, _, t_ns in found) <= 5 * MS
    # once it is certain: the delay of a read is 2 ms on average, above 40 ms once in 5e8
    assert all(abs(batch.last_ns - SECOND - last * 5 * MS) < 40 * MS for batch, last, _ in found[80:])
    assert frames.counts.lost == 0


@pytest.mark.parametrize("case", ["sound", "jitter", "stall", "silence", "flaky", "drift"])
def test_a_sound_interval_is_never_wrong(case: str) -> None:
    rng = np.random.default_rng(11)
    late = np.zeros(1200)
    if case == "jitter":
        late = rng.exponential(60 * MS, 1200)
    if case == "stall":  # each tenth read comes a second late
        late[5::10] = SECOND
    arrivals = reads(300.0, late, round(5 * MS * 1.0008) if case == "drift" else 5 * MS)
    if case == "silence":
        arrivals = (each for each in arrivals if not 100 <= each[0] // READ < 140)
    if case == "flaky":  # 3 s of each 10 s are lost: more than two turns of the counter
        arrivals = (each for each in arrivals if each[0] // READ % 40 < 28)
    frames, found = serial(0.005, arrivals)
    assert not frames.times.is_wrong
    assert not any(batch.irregular for batch, _, _ in found)


def test_a_late_first_read_is_made_good_at_once() -> None:
    """The first read comes 83 ms late, at 200 Hz: the second shows it, with its own jitter."""
    _, found = serial(0.005, reads(20.0, np.array([83 * MS])))
    late = [(batch.last_ns - SECOND - last * 5 * MS) / MS for batch, last, _ in found]
    assert late[0] > 83
    assert max(late[1:]) < 20
    assert max(late[8:]) < 6  # the least jitter of 8 reads is 0.25 ms on average, and 5 ms are left to the steering
    times = np.concatenate([batch.time_array for batch, _, _ in found])
    assert (np.diff(times) > 0).all()
    assert not any(batch.irregular for batch, _, _ in found)


def received(late_ns: int = 0, count: int = 4000) -> list[CanFrame]:
    """Frames of a message that comes every 10 ms, and up to 1 ms late; the first more."""
    jitter = np.minimum(np.random.default_rng(5).exponential(0.2 * MS, count), MS)
    jitter[0] += late_ns
    return [imu(SECOND + i * 10 * MS + int(jitter[i]), i) for i in range(count)]


def bus(plan: CanPlan, frames: list[CanFrame]) -> tuple[list[SampleBatch], MessageCount]:
    decoder = CanDecoder(plan, run="r1", epoch_of=lambda _: UUID(int=1), is_live=True)
    blocks = [frames[:1], *(frames[i : i + 5] for i in range(1, len(frames), 5))]
    batches = [batch for block in blocks for batch in decoder.take(frame_block(block))]
    [count] = decoder.counts.messages
    return batches, count


def stated(interval_s: float) -> str:
    return GRID.replace("interval_s = 0.001", f"interval_s = {interval_s}")


@pytest.mark.parametrize(("stated_s", "within_s"), [(0.02, 3.0), (0.002, 3.0), (0.0102, 7.0)])
def test_a_wrong_interval_of_a_message_is_seen(stated_s: float, within_s: float, tmp_path: Path) -> None:
    frames = received()
    batches, count = bus(mapped(tmp_path, stated(stated_s)), frames)
    assert count.seen is not None
    assert count.seen.is_wrong
    assert count.seen.to_write_s == 0.01
    times = np.concatenate([batch.time_array for batch in batches])
    came = np.array([each.t_ns for each in frames])
    assert len(times) == len(frames)
    assert (np.diff(times) > 0).all()
    assert (times[1:] - came[1:]).max() <= 5 * MS
    wrong = np.concatenate([np.full(len(batch), batch.irregular) for batch in batches])
    begins = int(wrong.argmax())
    assert begins * 0.01 <= within_s
    assert wrong[begins:].all()
    assert (times[begins + 100 :] == came[begins + 100 :]).all()


def test_a_first_frame_that_is_received_late_leaves_no_trace(tmp_path: Path) -> None:
    frames = received(late_ns=83 * MS, count=400)
    batches, count = bus(mapped(tmp_path, stated(0.01)), frames)
    late = np.concatenate([batch.time_array for batch in batches]) - SECOND - np.arange(400) * 10 * MS
    assert late[0] >= 83 * MS
    assert (late[10:] <= 5 * MS).all()
    assert (late[10:] >= 0).all()
    assert (np.diff(late) >= -10 * MS).all()
    assert count.seen is None
    assert not any(batch.irregular for batch in batches)


def test_a_log_with_another_interval_than_its_mapping_is_refused(tmp_path: Path) -> None:
    log = tmp_path / "bus.log"
    lines = [f"({each.t_ns / 1e9:.6f}) can0 101#{each.data.hex().upper()}" for each in received(count=1000)]
    log.write_text("\n".join(lines) + "\n")
    with pytest.raises(BadInput, match=r"message IMU of unit FOG-1: .*every 0.01 s .*: write interval_s = 0.01 there"):
        CanLogFile(log, mapped(tmp_path, stated(0.02))).check()
    assert CanLogFile(log, mapped(tmp_path, stated(0.01))).check().signals[0].sampling.dt_ns == 10 * MS


def test_one_jump_is_no_interval() -> None:
    """Frames or time that lack at one place move all that follows: no line."""
    for at in range(1, 500, 7):
        watch = IntervalWatch(10.0 * MS)
        seen = [watch.see(25 * k + (256 if k >= at else 0), 250 * MS * k) for k in range(512)]
        assert seen == [None] * 512


def test_what_is_near_is_not_wrong() -> None:
    assert not SeenInterval(1e7, 1.004e7, 1e3).is_wrong
    assert not SeenInterval(1e7, 1.006e7, 2e4).is_wrong
    assert SeenInterval(1e7, 0.994e7, 1e3).is_wrong


@pytest.mark.parametrize("nearer_ns", [5_100_000, 5_200_000, 7 * MS])
def test_stored_times_increase_however_the_grid_is_moved(nearer_ns: int) -> None:
    """Of reads that each come less late than the one before: stored as even, one ended behind the next one's begin."""
    ends = [(k + 1) * READ - 1 for k in range(12)]
    late_ns = [max(0, 60 * MS - k * nearer_ns) for k in range(12)]
    arrivals = [(last, SECOND + last * 5 * MS + more) for last, more in zip(ends, late_ns, strict=True)]
    _, found = serial(0.005, iter(arrivals))
    times_ns = np.concatenate([batch.time_array for batch, _, _ in found])
    assert (np.diff(times_ns) > 0).all()


def test_a_unit_that_changes_its_rate_is_seen_within_20_s() -> None:
    """100 to 98 Hz after 30 s of the right interval: all arrivals together lie on no line."""
    watch, rng = IntervalWatch(10.0 * MS), np.random.default_rng(1)
    sampled_ns = np.cumsum(np.where(np.arange(6000) < 3000, 10.0, 10.2041)) * MS
    seen: dict[float, SeenInterval] = {}
    for number in range(0, 6000, 25):
        found = watch.see(number, int(sampled_ns[number] + rng.exponential(2 * MS)))
        if found is not None and found.is_wrong:
            seen.setdefault(sampled_ns[number] / 1e9, found)
    first_s = min(seen)
    assert 30.0 < first_s < 50.0
    assert abs(seen[first_s].interval_ns - 10.2041 * MS) <= 2 * seen[first_s].uncertainty_ns
