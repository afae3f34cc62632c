"""Messages read many at a time have the effect of the same messages read one after another."""

import random
from collections.abc import Callable
from uuid import UUID

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stream.batch import SampleBatch
from stream.estimators.base import default_estimators
from stream.events import RunEnded, encode_event
from stream.identity import Place, event_key, sample_key
from stream.security.proof import Proof, joined
from stream.wire import samples_pb2
from stream.wire.batches import encode_batch
from stream.wire.continued_batches import JoinedMessages, StreamStates
from stream.worker.estimation import Estimation
from tests.stream.examples import examples

DT_NS = 10**7
EVERY_NS = 20 * 10**9
COUNTS = np.random.default_rng(3).integers(-(2**15), 2**15, 9000).astype(np.int32)
PLACES = (Place("plant", "a"), Place("plant", "b"))
Message = tuple[str, bytes]


def mutated(payload: bytes, rng: random.Random) -> bytes:
    """A message that is not quite the one that was expected."""
    message = samples_pb2.SampleBatch.FromString(payload)
    n = message.samples
    change = rng.randrange(12)
    if change == 0:
        message.values, message.count_residuals = np.arange(n, dtype="<f8").tobytes(), b""
    elif change == 1:
        message.times_ns = (message.t0_ns + message.dt_ns * np.arange(n, dtype="<i8")).tobytes()
    elif change == 2:
        message.flags = bytes(n)
    elif change == 3:
        message.counts, message.count_residuals = np.arange(n, dtype="<i4").tobytes(), b""
    elif change == 4:
        message.scale = 2.0
    elif change == 5:
        message.seq += 1
    elif change == 6:
        message.t0_ns += 5 * DT_NS
    elif change == 7:
        message.count_residuals = message.count_residuals[:-1]
    elif change == 8:
        return payload[: rng.randrange(len(payload))]
    elif change == 9:
        return payload + bytes([rng.randrange(256) for _ in range(rng.randrange(1, 9))])
    elif change == 10:
        return bytes(byte ^ (rng.random() < 0.02) * rng.randrange(1, 256) for byte in payload)
    else:
        message.unit = "U9"
    return bytes(message.SerializeToString())


def messages(seed: int, *, spoiled: float) -> list[Message]:
    """Messages of a few signals in turn: gaps, repetitions, new epochs, proofs, ends of runs, and spoiled ones."""
    rng = random.Random(seed)
    found: list[Message] = []
    state = {key: [0, 0, 1] for key in range(5)}  # number, time, epoch of each stream
    size = rng.choice([1, 40, 256, 1000])
    for turn in range(rng.randrange(20, 50)):
        for stream, (seq, t_ns, epoch) in state.items():
            # streams 3 and 4 are one signal of one run from two stations
            place, unit, run = PLACES[stream == 4], f"U{min(stream, 3)}", f"r{turn // 25}"
            n = rng.randrange(1, size + 1) if stream == 0 else size
            counts = COUNTS[seq % 8000 : seq % 8000 + n] >> rng.choice([0, 0, 8])
            batch = SampleBatch(
                unit, "rate", run, UUID(int=epoch), seq, t_ns, DT_NS, "deg/s", counts=counts, scale=0.25
            )
            payload = encode_batch(batch)
            key = sample_key(place, unit, "rate")
            if rng.random() < 0.3:
                payload = joined(payload, Proof("station:a", macs={"r": b"0" * 16}))
            found.append((key, mutated(payload, rng) if rng.random() < spoiled else payload))
            if rng.random() < 0.02:
                found.append(found[-1])
            state[stream] = [seq + len(counts), t_ns + len(counts) * DT_NS, epoch]
            if rng.random() < 0.02:
                state[stream] = [0, t_ns + 10**10, epoch + 1]
            elif rng.random() < 0.02:
                state[stream][1] += 3 * DT_NS
        if turn == 24:
            ended = RunEnded(run="r0", t_ns=state[0][1])
            found.append((event_key(PLACES[0]), encode_event(ended, "e", 0)))
    return found


def effect(feed: Callable[[Estimation], None]) -> tuple[list[tuple[str, bytes]], bytes, str]:
    published: list[tuple[str, bytes]] = []
    few = {key: make for key, make in default_estimators().items() if key == "bias_stability_1s"}
    estimation = Estimation(
        EVERY_NS, few, lambda key, document: published.append((key, msgspec.json.encode(document))), spectrum=False
    )
    feed(estimation)
    return published, msgspec.msgpack.encode(estimation.checkpoint("s")), str(estimation.counts)


@examples(
    6, 25, seed=st.integers(0, 2**32 - 1), spoiled=st.sampled_from([0.0, 0.0, 0.05, 0.3]), at_once=st.integers(1, 200)
)
def test_many_at_a_time_have_the_same_effect(seed: int, spoiled: float, at_once: int) -> None:
    given_messages = messages(seed, spoiled=spoiled)

    def alone(estimation: Estimation) -> None:
        for key, payload in given_messages:
            estimation.take(key, payload)

    def together(estimation: Estimation) -> None:
        for begin in range(0, len(given_messages), at_once):
            estimation.take_all(given_messages[begin : begin + at_once])

    assert effect(together) == effect(alone)


def test_nearly_all_messages_are_read_many_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    key = sample_key(PLACES[0], "U1", "rate")
    given_messages = [
        (
            key,
            encode_batch(
                SampleBatch("U1", "rate", "r", UUID(int=1), i, i * DT_NS, DT_NS, "deg/s", counts=COUNTS[:100])
            ),
        )
        for i in range(0, 20_000, 100)
    ]
    read_alone: list[str] = []
    take = Estimation.take

    def counted(estimation: Estimation, key: str, payload: bytes) -> None:
        read_alone.append(key)
        take(estimation, key, payload)

    monkeypatch.setattr(Estimation, "take", counted)
    published: list[str] = []
    estimation = Estimation(EVERY_NS, default_estimators(), lambda key, _: published.append(key))
    for begin in range(0, len(given_messages), 10):
        estimation.take_all(given_messages[begin : begin + 10])
    assert estimation.counts.samples == 20_000
    assert published  # across borders and times when documents are due
    assert len(read_alone) == 10  # the first, whose stream was not known when they were joined


@given(st.binary(max_size=300), st.integers(0, 2**16))
@settings(max_examples=200, deadline=None)
def test_no_message_reaches_beyond_its_end(tail: bytes, at: int) -> None:
    start_ns = 10**18
    before, follows = (
        encode_batch(
            SampleBatch(
                "U1", "rate", "r", UUID(int=1), i, start_ns + i * DT_NS, DT_NS, "deg/s", counts=COUNTS[i : i + 50]
            )
        )
        for i in (50, 100)
    )
    states = StreamStates()
    number = states.add()
    states.expect(number, before, 100, start_ns + 100 * DT_NS, DT_NS, 8192, 2**62)
    assert states.read(JoinedMessages([follows], [number]), 0).samples == [50]
    states.expect(number, before, 100, start_ns + 100 * DT_NS, DT_NS, 8192, 2**62)
    cut = at % len(follows)
    read = states.read(JoinedMessages([follows[:cut] + tail], [number]), 0)
    assert read.samples in ([], [50])
    states.expect(number, tail, 50, 0, DT_NS, 8192, 2**62)  # whatever it is
    states.read(JoinedMessages([tail], [number]), 0)
