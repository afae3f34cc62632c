"""Messages that continue their streams are followed in the bytes of the log: the same is found as by reading each."""

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import pyarrow as pa
import pytest

from analytics.serve.live.rows import LiveRows
from analytics.serve.live.tail import LiveTail
from storage.check.ahead import ahead
from storage.check.continued_messages import ContinuedMessages
from storage.check.verify_log import LogState, verify_log
from storage.lake.segment_content import SegmentContent
from storage.log.event_log import EventLog
from storage.log.follower import ContinuedBatch, LogFollower
from storage.log.sequence import place_of
from storage.segments.records import SAMPLES, LogRecord
from storage.store import Store, WriterLock
from stream.batch import SampleBatch
from stream.identity import Place, sample_key
from stream.wire.batches import RawBatch, encode_batch

START_NS, DT_NS = 1_763_683_200 * 10**9, 10**7
PLACE = Place("plant", "bench")
Change = Callable[[dict[str, Any]], dict[str, Any] | None]


def fields(unit: str, seq: int, size: int, rng: np.random.Generator) -> dict[str, Any]:
    return {
        "unit": unit, "signal": "rate", "run": "r1", "epoch": UUID(int=1), "seq": seq, "t0_ns": START_NS + seq * DT_NS,
        "dt_ns": DT_NS, "unit_of_measure": "deg/s", "scale": 1e-5,
        "counts": rng.integers(-100_000, 100_000, size).astype(np.int32),
    }  # fmt: skip


def as_values(found: dict[str, Any]) -> dict[str, Any]:
    counts = found.pop("counts")
    return found | {"values": counts.astype(np.float64), "scale": 1.0}


def irregular(found: dict[str, Any]) -> dict[str, Any]:
    times_ns = found["t0_ns"] + np.arange(len(found["counts"])) * DT_NS
    return found | {"irregular": True, "times_ns": times_ns}


CHANGES: dict[str, Change] = {
    "lost": lambda _: None,
    "later": lambda f: f | {"t0_ns": f["t0_ns"] + 12_345},
    "early": lambda f: f | {"t0_ns": 17},
    "far": lambda f: f | {"t0_ns": 2**62 - 10**15},
    "epoch": lambda f: f | {"epoch": UUID(int=2)},
    "run": lambda f: f | {"run": "r2"},
    "scale": lambda f: f | {"scale": 2e-5},
    "one": lambda f: f | {"counts": f["counts"][:1]},
    "small": lambda f: f | {"counts": f["counts"] // 100_000},
    "large": lambda f: f | {"counts": f["counts"] * 20_000},
    "flags": lambda f: f | {"flags": np.ones(len(f["counts"]), np.uint8)},
    "values": as_values,
    "irregular": irregular,
    "again": lambda f: f | {"seq": max(0, f["seq"] - 40), "t0_ns": f["t0_ns"] - 40 * DT_NS},
}


def encoded(found: dict[str, Any], proof: int) -> LogRecord:
    """A message, with room for a proof after its samples."""
    batch = SampleBatch(**found)
    data = encode_batch(batch) + (b"\x9a\x01" + bytes([proof | 128, 1]) + b"p" * (proof + 128) if proof else b"")
    return LogRecord(sample_key(PLACE, batch.unit, "rate"), SAMPLES, batch.t0_ns, batch.t0_ns, data)


def write(store: Store, seed: int) -> None:
    """A few hundred messages of four streams, some of which are changed, in three segments."""
    rng, odd = np.random.default_rng(seed), random.Random(seed)
    names = list(CHANGES)
    seqs = {f"U{number}": 0 for number in range(4)}
    with WriterLock(store, "test"):
        log = EventLog(store)
        for number in range(300):
            unit = odd.choice(list(seqs))
            found: dict[str, Any] | None = fields(unit, seqs[unit], 40, rng)
            seqs[unit] += 40
            if odd.random() < 0.1:
                assert found is not None
                found = CHANGES[odd.choice(names)](found)
            if found is not None:
                record = encoded(found, 5 if unit == "U3" else 0)
                place = place_of(record)
                assert place is not None
                log.append(place, record)
            if number % 100 == 99:
                log.seal()


def outcome(state: LogState) -> tuple[Any, ...]:
    check = state.check
    return state.findings, state.samples, state.messages, check.next_seq, check.lost, check.repeated, check._last_ns


@pytest.mark.long
@pytest.mark.parametrize("seed", range(12))
def test_both_ways_find_the_same(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store.create(tmp_path / "store")
    write(store, seed)
    followed, follow = [], ContinuedMessages.follow

    def counted(self: ContinuedMessages, topic: str, content: bytes, begin: int, end: int) -> int:
        followed.append(follow(self, topic, content, begin, end))
        return followed[-1]

    with monkeypatch.context() as patch:
        patch.setattr(ContinuedMessages, "follow", counted)
        state = verify_log(store)
    assert sum(map(bool, followed)) > 100  # most messages, else nothing is compared
    with monkeypatch.context() as patch:
        patch.setattr(ContinuedMessages, "follow", lambda *_: 0)
        alone = verify_log(store)
    assert outcome(state) == outcome(alone)
    assert state.check.lost


@pytest.mark.parametrize("seed", range(3))
def test_a_follower_finds_the_same_in_batches_that_it_leaves_unread(seed: int, tmp_path: Path) -> None:
    store = Store.create(tmp_path / "store")
    write(store, seed)
    found: dict[bool, list[Any]] = {}
    for unread in (True, False):
        rows, tail, content = LiveRows(), LiveTail(), SegmentContent(store.identity, "all")
        with LogFollower(store, unread=unread) as follower:
            messages = list(follower.poll())
        places = []
        for message in messages:
            rows.take(message)
            assert isinstance(message.content, RawBatch | ContinuedBatch)
            content.take(message.record, message.content)
            tail.take(message.segment, message.content, len(message.record.data))
            places.append((message.segment, message.place, message.content.t0_ns, message.content.last_ns))
        rows.publish()
        found[unread] = [places, rows.beyond(()).channels.to_pylist(), tail.channels("r1"), content.event_rows()]
        for channel in content.channels.values():
            tables = pa.concat_tables(channel.message_tables())
            found[unread] += [channel.row(), tables.to_pylist()]
        for unit in ("U0", "U1", "U2", "U3"):
            samples = tail.samples((unit, "r1", "rate"), ())
            assert samples is not None
            found[unread].append([each.tolist() if isinstance(each, np.ndarray) else each for each in samples])
        unread_of = [each.content.decoded() for each in messages if isinstance(each.content, ContinuedBatch)]
        assert (len(unread_of) > 100) == unread  # most, else nothing is compared
    assert found[True] == found[False]


def test_a_message_that_differs_in_any_byte_before_its_samples_is_read_alone(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    first, second = (encoded(fields("U1", seq, 40, rng), 0) for seq in (40, 80))
    place = place_of(first)
    assert place is not None
    samples = len(second.data) - 40 * 3 - 4
    state = LogState("")
    state.check.follow(place)
    continued = ContinuedMessages(state.check)
    continued.expect(first, place)
    for at in range(samples):
        for bit in range(8):
            data = bytearray(second.data)
            data[at] ^= 1 << bit
            found = continued.follow(first.topic, bytes(data), 0, len(data))
            if found:  # another time is followed: only that of the last sample is kept
                other, was = place_of(second._replace(data=bytes(data))), place_of(second)
                assert other is not None
                assert was is not None
                assert other.first_ns != was.first_ns
                assert other._replace(first_ns=0, last_ns=0) == was._replace(first_ns=0, last_ns=0)
                continued.settle(first.topic)
                assert state.check._last_ns[place.stream] == other.last_ns
                state.check.skip_to(place.stream, place.next_seq, place.last_ns)
                continued.expect(first, place)
    for end in range(len(second.data)):
        assert not continued.follow(first.topic, second.data, 0, end)
    assert continued.follow(first.topic, second.data, 0, len(second.data)) == 40


def test_what_is_made_ahead_comes_in_its_turn_and_so_does_its_error() -> None:
    def values() -> Any:
        yield from range(3)
        raise ValueError("the fourth")

    found = ahead(values())
    assert [next(found) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="the fourth"):
        next(found)
