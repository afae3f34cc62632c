"""Messages that are not what they should be: cut, flipped, grown, of a wrong schema, under odd keys."""

import random
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple
from uuid import UUID

import numpy as np

from stream.batch import SampleBatch
from stream.bounds import MAX_MESSAGE_BYTES
from stream.errors import GyrofleetError
from stream.events import NoteAdded, RunStarted, encode_event
from stream.identity import Place, SampleKey, estimate_key, event_key, is_name, parse_key, sample_key
from stream.wire import samples_pb2
from stream.wire.batches import decode_batch, encode_batch
from stream.wire.event_validation import decode_received

PLACE = Place("plant", "bench")
GOOD = sample_key(PLACE, "GOOD", "rate")
VICTIM = sample_key(PLACE, "VICTIM", "rate")
EPOCH, OTHER = UUID(int=1), UUID(int=2)
AHEAD = 5000  # number of the well-formed messages that are made malformed: far from what any stream expects
BATCH = 100
ODD_KEYS = (
    "gyrofleet/x", "gyrofleet/plant", "gyrofleet/plant/bench", "gyrofleet/plant/bench/U1", "gyrofleet//bench/U1/rate",
    "gyrofleet/plant/bench/U1/rate/estimate", "gyrofleet/plant/bench/U1/rate/other/x", "gyrofleet/a/b/c/d/e/f/g",
    "gyrofleet/plant/bench/U1/rate/estimate/allan/x", "gyrofleet/plant/bench/event/x/y/z/1", "gyrofleet/" + "x" * 3000,
    "gyrofleet/\u96f6\u504f", "gyrofleet/plant/bench/U1/rate/", "gyrofleet/plant/bench/\x00/\n/'/\"",
)  # fmt: skip
ODD_JSON = (
    b"", b"{}", b"null", b"[]", b"7", b'"x"', b"{" * 5000, b"[" * 100_000, b'{"schema":1}', b'{"schema":"1"}',
    b"\xff\xfe", b'{"schema":1,"epoch":"v","seq":5000,"document":{"kind":"NoSuchThing","run":"r","t_ns":0}}',
    b'{"schema":1,"epoch":"v","seq":5000,"document":{"run":"r","t_ns":0}}',
    b'{"schema":1,"epoch":"v","seq":5000,"document":{"kind":"NoteAdded","run":7,"t_ns":0,"text":"x"}}',
    b'{"schema":1,"epoch":"v","seq":5000,"document":{"kind":"NoteAdded","run":"r","t_ns":NaN,"text":"x"}}',
    b'{"schema":1,"epoch":"v","seq":0,"document":{"kind":"NoteAdded","run":"r","t_ns":1e400,"text":"x"}}',
    b'{"schema":1,"epoch":"v","seq":0,"document":{"kind":"NoteAdded","run":"r","t_ns":99999999999999999999,"text":"x"}}',
    b'{"schema":1,"epoch":"v","seq":0,"document":{"kind":"NoteAdded","run":"r","t_ns":-9223372036854775808,"text":"x"}}',
    b'{"schema":1,"epoch":"v","seq":99999999999999999999,"document":{"kind":"NoteAdded","run":"r","t_ns":0,"text":"x"}}',
    b'{"schema":0,"epoch":"v","seq":0,"document":{"kind":"NoteAdded","run":"r","t_ns":0,"text":"x"}}',
    b'{"schema":-1,"epoch":"v","seq":0,"document":{"kind":"NoteAdded","run":"r","t_ns":0,"text":"x"}}',
    b'{"schema":2,"epoch":"v","seq":0,"document":{"kind":"NoteAdded","run":"r","t_ns":0,"text":"x"}}',
    b'{"schema":1,"epoch":"v","seq":-1,"document":{"kind":"NoteAdded","run":"r","t_ns":0,"text":"x"}}',
)  # fmt: skip


class Message(NamedTuple):
    """What is sent under which key; whether it must be quarantined."""

    how: str
    key: str
    payload: bytes
    is_malformed: bool


def is_malformed(key: str, payload: bytes) -> bool | None:
    """Whether nobody can read it; None where it can be read, and its stream would take it."""
    try:
        parsed = parse_key(key)
        if len(payload) > MAX_MESSAGE_BYTES:
            return True
        if isinstance(parsed, SampleKey):
            batch = decode_batch(payload)
            seq = batch.seq
            if (batch.unit, batch.signal) != (parsed.unit, parsed.signal) or (batch.run and not is_name(batch.run)):
                return True
        else:
            seq = decode_received(payload).seq
    except GyrofleetError:
        return True
    return False if seq else None


class Forge:
    """Makes messages that are not what they should be.

    Parameters
    ----------
    rng : random.Random
        Decides.
    """

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        counts = np.arange(BATCH, dtype=np.int32)
        plain = SampleBatch("VICTIM", "rate", "r1", OTHER, AHEAD, 10**12, 10**7, "deg/s", counts=counts, scale=0.01)
        times = SampleBatch(
            "VICTIM", "rate", "r1", OTHER, AHEAD, 10**12, 10**7, "deg/s", values=np.linspace(0, 1, BATCH),
            times_ns=10**12 + 10**7 * np.arange(BATCH), flags=np.ones(BATCH, np.uint8),
        )  # fmt: skip
        self.batches = [encode_batch(plain), encode_batch(times)]
        note, started = NoteAdded(run="r1", t_ns=5, text="door opened"), RunStarted(run="r1", t_ns=5, units=("VICTIM",))
        self.documents = [encode_event(note, "v", AHEAD), encode_event(started, "v", AHEAD)]
        self.event_keys = [event_key(PLACE), estimate_key(PLACE, "VICTIM", "rate", "allan_deviation")]
        self.never_right = [self.field, self.odd_key, self.of_another, self.odd_json]
        self.kinds = [self.noise, self.cut, self.flip, self.grow, *self.never_right]

    def messages(self) -> Iterator[Message]:
        """One after the other, without end."""
        while True:
            kind = self.rng.choice(self.kinds)
            key, payload = kind()
            judged = True if kind in self.never_right else is_malformed(key, payload)
            if judged is not None:
                yield Message(kind.__name__, key, payload, judged)

    def whole(self) -> tuple[str, bytes]:
        """A well-formed message."""
        if self.rng.random() < 0.5:
            return VICTIM, self.rng.choice(self.batches)
        return self.rng.choice(self.event_keys), self.rng.choice(self.documents)

    def noise(self) -> tuple[str, bytes]:
        key, _ = self.whole()
        return key, self.rng.randbytes(self.rng.choice([0, 1, 7, 64, 2000]))

    def cut(self) -> tuple[str, bytes]:
        key, payload = self.whole()
        return key, payload[: self.rng.randrange(len(payload))]

    def flip(self) -> tuple[str, bytes]:
        key, payload = self.whole()
        flipped = bytearray(payload)
        for _ in range(self.rng.randint(1, 3)):
            flipped[self.rng.randrange(min(len(flipped), 200))] ^= 1 << self.rng.randrange(8)
        return key, bytes(flipped)

    def grow(self) -> tuple[str, bytes]:
        key, payload = self.whole()
        at = self.rng.randrange(len(payload) + 1)
        return key, payload[:at] + self.rng.randbytes(self.rng.randint(1, 40)) + payload[at:]

    def field(self) -> tuple[str, bytes]:
        """One field of a batch has a value that it cannot have."""
        message = samples_pb2.SampleBatch.FromString(self.batches[0])
        wrong: dict[str, list[Any]] = {
            "schema": [0, 4, 2**32 - 1],
            "samples": [0, 1, 99, 101, 2**32 - 1],
            "epoch": [b"", bytes(15), bytes(17)],
            "seq": [-1, -(2**63), 2**63 - 1, 2**53],
            "dt_ns": [0, -1, -(2**63), 2**63 - 1, 2**58 + 1],
            "t0_ns": [-(2**63), -(2**61) - 1, 2**62, 2**63 - 20],
            "scale": [float("nan"), float("inf"), float("-inf")],
            "offset": [float("nan"), float("inf"), float("-inf")],
            "counts": [bytes(4 * BATCH), bytes(3)],
            "count_planes": [bytes(1), bytes(BATCH - 1), bytes(5 * BATCH)],
            "count_residuals": [b"", bytes(1), bytes(BATCH + 3), bytes(5 * BATCH + 4)],
            "values": [bytes(3), bytes(8 * BATCH - 8)],
            "times_ns": [
                bytes(7),
                struct.pack("<q", -(2**63)) * BATCH,
                struct.pack("<3q", 0, 2**63 - 20, 1).ljust(8 * BATCH, b"\x00"),
            ],
            "flags": [bytes(1), bytes(BATCH + 1)],
        }
        name = self.rng.choice(sorted(wrong))
        setattr(message, name, self.rng.choice(wrong[name]))
        return VICTIM, message.SerializeToString()

    def odd_key(self) -> tuple[str, bytes]:
        _, payload = self.whole()
        key = self.rng.choice(ODD_KEYS)
        return (f"gyrofleet/odd/{self.rng.randrange(500)}" if self.rng.random() < 0.3 else key), payload

    def of_another(self) -> tuple[str, bytes]:
        """What belongs under another key."""
        wrong = [GOOD, sample_key(PLACE, "VICTIM", "temperature"), sample_key(PLACE, "X", "rate")]
        if self.rng.random() < 0.5:
            return self.rng.choice([*wrong, *self.event_keys]), self.rng.choice(self.batches)
        return self.rng.choice([*wrong, VICTIM]), self.rng.choice(self.documents)

    def odd_json(self) -> tuple[str, bytes]:
        return self.rng.choice(self.event_keys), self.rng.choice(ODD_JSON)
