"""What each step of a sample's way takes of a processor: ``python -m tests.bench.sample_path [--json]``.

CPU time of one thread, everything in caches: counts split and joined, a batch encoded and read alone or many at a time,
a message taken in by a recorder (packed and hashed as well), and each estimator at 8192 samples at once. Beside it what
the machine can do: memory copied, SHA-256, CRC-32 and zstd of the same counts.
"""

import argparse
import hashlib
import json
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from uuid import UUID

import numpy as np
import zstandard

from storage.log.event_log import EventLog
from storage.recording.intake import Intake
from storage.store import Store
from stream.batch import SampleBatch
from stream.estimators.base import all_estimators
from stream.identity import Place, sample_key
from stream.wire.batches import encode_batch, read_wire_batch
from stream.wire.continued_batches import JoinedMessages, StreamStates
from stream.wire.count_residuals import join_counts, split_counts
from stream.worker.compile_kernels import warm_up

PLACE = Place("plant", "bench")
DT_NS = 100_000
PIECE = 8192
NOISE = np.round(np.random.default_rng(1).normal(0, 50, 64 * PIECE)).astype(np.int32)


def seconds(what: Callable[[], object], count: int) -> float:
    """CPU seconds of one call, in the fastest of five rounds."""
    what()
    rounds = []
    for _ in range(5):
        began = time.thread_time()
        for _ in range(count):
            what()
        rounds.append((time.thread_time() - began) / count)
    return min(rounds)


def batch(unit: str, seq: int, n: int) -> SampleBatch:
    at = seq % (63 * PIECE)
    return SampleBatch(
        unit, "rate", "r1", UUID(int=1), seq, seq * DT_NS, DT_NS, "deg/h", counts=NOISE[at : at + n], scale=1e-3
    )


def machine() -> dict[str, float]:
    """Nanoseconds a byte."""
    ones, room = np.ones(8 << 20), np.empty(8 << 20)
    noise = np.random.default_rng(2).integers(0, 256, 8 << 20).astype(np.uint8).tobytes()
    packed = b"".join(split_counts(NOISE[i : i + 1000]) for i in range(0, 500_000, 1000))
    zstd = zstandard.ZstdCompressor(level=3)
    return {
        "copy_ns_a_byte": seconds(lambda: np.copyto(room, ones), 3) / ones.nbytes * 1e9,
        "sha256_ns_a_byte": seconds(lambda: hashlib.sha256(noise).digest(), 2) / len(noise) * 1e9,
        "crc32_ns_a_byte": seconds(lambda: zlib.crc32(noise), 2) / len(noise) * 1e9,
        "zstd_ns_a_sample": seconds(lambda: zstd.compress(packed), 5) / 500_000 * 1e9,
    }


def messages(n: int) -> dict[str, float]:
    """Microseconds a message of n samples."""
    counts, residuals = NOISE[:n].copy(), split_counts(NOISE[:n])
    payloads = [encode_batch(batch("U1", seq, n)) for seq in range(n, 512 * n, n)]
    states = StreamStates()
    number = states.add()
    joined = JoinedMessages(payloads[1:], [number] * (len(payloads) - 1))

    def bulk() -> None:
        states.expect(number, payloads[0], 2 * n, 2 * n * DT_NS, DT_NS, 2**60, 2**60)
        assert len(states.read(JoinedMessages(payloads[1:], [number] * len(joined.ends)), 0).streams) == len(
            joined.ends
        )

    one = batch("U1", n, n)
    found = {
        "split": seconds(lambda: split_counts(counts), 2000),
        "join": seconds(lambda: join_counts(residuals, n), 2000),
        "encode": seconds(lambda: encode_batch(one), 2000),
        "read_alone": seconds(lambda: read_wire_batch(payloads[5]), 2000),
        "read_in_bulk": seconds(bulk, 5) / len(joined.ends),
        "taken_in": _taken_in(n),
    }
    return {f"{name}_us_at_{n}": each * 1e6 for name, each in found.items()}


def _taken_in(n: int) -> float:
    keys = [(f"U{i}", sample_key(PLACE, f"U{i}", "rate")) for i in range(500)]
    sent = [(key, encode_batch(batch(unit, turn * n, n))) for turn in range(20) for unit, key in keys]
    with tempfile.TemporaryDirectory() as folder:
        store = Store.create(Path(folder) / "store")
        log = EventLog(store)
        intake = Intake(log, store)
        for key, payload in sent[:1000]:
            intake.add(key, payload, 1)
        began = time.thread_time()
        for key, payload in sent[1000:]:
            intake.add(key, payload, 1)
        log.sync()
        return (time.thread_time() - began) / (len(sent) - 1000)


def estimators() -> dict[str, float]:
    """Nanoseconds a sample at 8192 at once."""
    pieces = [batch("U1", seq, PIECE) for seq in range(0, 300 * PIECE, PIECE)]
    for piece in pieces:
        assert len(piece.own_values) == PIECE
    found = {}
    for key, make in all_estimators().items():
        rounds = []
        for _ in range(3):
            estimator = make()
            began = time.thread_time()
            for piece in pieces:
                estimator.update(piece)
            rounds.append((time.thread_time() - began) / len(pieces) / PIECE * 1e9)
        found[f"{key}_ns"] = min(rounds)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    warm_up()
    found = machine() | messages(1000) | messages(100) | estimators()
    if asked.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        print(f"{name:34} {value:8.2f}")


if __name__ == "__main__":
    main()
