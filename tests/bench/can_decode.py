"""Frames decoded a second: columns against cantools frame by frame, on the same frames in one run.

python tests/bench/can_decode.py --json
"""

import argparse
import json
import platform
import time
from pathlib import Path
from typing import Any
from uuid import UUID

import cantools
import numpy as np

from ingest.can.decode import FrameBytes, MessageLayout, scaled
from ingest.can.frames import FrameBlock
from ingest.can.mapping import CanMapping
from ingest.can.stream import CanDecoder

DBC = Path(__file__).parents[1] / "ingest" / "can" / "can_bench.dbc"
BLOCK = 10_000


def blocks_of(frames: int, ids: list[int]) -> list[FrameBlock]:
    random = np.random.default_rng(1)
    data = random.integers(0, 256, (frames, 8), np.uint8)
    t_ns = np.arange(frames, dtype=np.int64) * 100_000
    identifiers = np.array(ids, np.uint32)[np.arange(frames) % len(ids)]
    channel, length = np.zeros(frames, np.int16), np.full(frames, 8, np.uint8)
    parts = [slice(i, i + BLOCK) for i in range(0, frames, BLOCK)]
    return [FrameBlock(t_ns[i], channel[i], identifiers[i], length[i], data[i]) for i in parts]


def best_s(times: int, work: Any) -> float:
    found = []
    for _ in range(times):
        begin = time.perf_counter()
        work()
        found.append(time.perf_counter() - begin)
    return min(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--frames", type=int, default=1_000_000, help="frames to decode in columns")
    parser.add_argument("--repeats", type=int, default=3, help="the best of so many counts")
    arguments = parser.parse_args()

    database = cantools.database.load_file(DBC)
    assert isinstance(database, cantools.database.can.Database)
    ids = [message.frame_id for message in database.messages]
    blocks = blocks_of(arguments.frames, ids)
    layouts = {message.frame_id: MessageLayout.of(message) for message in database.messages}
    few = min(arguments.frames, 50_000)
    rows = [
        (int(identifier), bytes(data))
        for block in blocks[: -(-few // BLOCK)]
        for identifier, data in zip(block.arbitration_id, block.data, strict=True)
    ][:few]

    plan = CanMapping([DBC], unit="U1").plan()

    def by_cantools() -> None:
        for identifier, data in rows:
            database.decode_message(identifier, data, decode_choices=False)

    def by_columns() -> None:
        for block in blocks:
            for identifier, layout in layouts.items():
                mine = np.flatnonzero(block.arbitration_id == identifier)
                decoded = layout.decode(FrameBytes(block.data[mine], block.length[mine]), list(layout.signals))
                for name, each in decoded.items():
                    scaled(each.raw, layout.signals[name].scale, layout.signals[name].offset)

    def to_batches() -> None:
        decoder = CanDecoder(plan, run="r1", epoch_of=lambda unit: UUID(int=1))
        for block in blocks:
            decoder.take(block)
        decoder.finish()

    frame_by_frame = few / best_s(arguments.repeats, by_cantools)
    columns = arguments.frames / best_s(arguments.repeats, by_columns)
    batches = arguments.frames / best_s(arguments.repeats, to_batches)
    result = {
        "frames": arguments.frames,
        "signals_per_frame": sum(len(message.signals) for message in database.messages) / len(database.messages),
        "cantools_frames_per_s": round(frame_by_frame),
        "columns_frames_per_s": round(columns),
        "batches_frames_per_s": round(batches),
        "columns_times_faster": round(columns / frame_by_frame, 1),
        "batches_times_faster": round(batches / frame_by_frame, 1),
        "machine": f"{platform.processor() or platform.machine()}, Python {platform.python_version()}",
    }
    if arguments.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name:24} {value:>14,}" if not isinstance(value, str) else f"{name:24} {value}")


if __name__ == "__main__":
    main()
