"""Damage to the files of a store, at random: is each found, and what is not damaged saved.

``python tests/crash/damage.py --count 1000``. A byte is flipped, the file is cut off, or a block is zeroed, in a
segment, a Parquet file, a manifest, a description of a part, or a checkpoint, anywhere in the file. Each time `verify`
must say so, naming the file; `recover` must leave a sound store that has all but the damaged chunk, and has not
removed the damaged file.
"""

import argparse
import json
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np

from storage.check.recover import recover
from storage.check.verify import CHECKPOINT, verify
from storage.lake.builder import build_missing, builder_lock
from storage.log.event_log import EventLog
from storage.log.tail import LogTail
from storage.recording.recorder import Recorder
from storage.segments.reader import SegmentScan
from storage.segments.records import SAMPLES
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.events import RunStarted
from stream.identity import Place, event_key, sample_key
from stream.transport.bus import LocalBus
from stream.worker.worker import EstimationWorker

PLACE = Place("plant", "bench")
N = 200
SEGMENTS = 4
BATCHES = 25
UNITS = 3


def make(folder: Path, segments: int = SEGMENTS) -> None:
    """A store with some segments of some chunks each, their lake, and two checkpoints."""
    store = Store.create(folder)
    bus = LocalBus()
    rng = np.random.default_rng(1)
    seq = 0
    for segment in range(segments):
        with (
            Recorder(store, bus_ := LocalBus(), EventLog(store), sync_interval_s=0.001, builds_lake=False),
            DurablePublisher(bus_) as publisher,
            EstimationWorker(bus_, publisher, every_s=10, log=LogTail(store), checkpoint=folder / CHECKPOINT),
        ):
            if segment == 0:
                publisher.send_event(event_key(PLACE), RunStarted(run="r1", t_ns=0))
            for _ in range(BATCHES):
                for unit in range(UNITS):
                    counts = rng.normal(0, 50, N).astype(np.int32)
                    batch = SampleBatch(
                        f"U{unit}", "rate", "r1", UUID(int=1), seq, seq * 10**7, 10**7, "deg/s", counts=counts
                    )
                    publisher.send_batch(sample_key(PLACE, batch.unit, "rate"), batch)
                publisher.drain()
                seq += N
            publisher.drain()
    bus.close()
    with builder_lock(store):
        list(build_missing(store))


def inflict(rng: random.Random, path: Path) -> tuple[str, range]:
    """Damage a file; what was done to it, and to which bytes."""
    content = bytearray(path.read_bytes())
    size = len(content)
    head, tail = rng.randrange(min(64, len(content))), len(content) - 1 - rng.randrange(min(64, len(content)))
    at = rng.choice([rng.randrange(len(content)), head, tail])
    how = rng.choice(["flip", "cut", "zero"])
    if how == "flip":
        content[at] ^= 1 << rng.randrange(8)
    elif how == "cut":
        del content[at:]
    else:
        end = min(len(content), at + rng.choice([16, 512, 4096]))
        if not any(content[at:end]):
            content[at] ^= 0xFF
            end = at + 1
            how = "flip"
        else:
            content[at:end] = bytes(end - at)
    path.write_bytes(content)
    touched = {"flip": range(at, at + 1), "cut": range(at, size), "zero": range(at, at + 4096)}[how]
    return f"{how} at byte {at} of {path.name}", touched


def untouched(segment: Path, touched: range) -> int:
    """Samples of a whole segment in chunks that do not meet the damaged bytes."""
    scan = SegmentScan(segment, sealed=True)
    list(scan)
    samples = 0
    for chunk in scan.summary.chunks:
        begin, end = chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length
        if end <= touched.start or begin >= touched.stop:
            of_rate = [n for n, channel in scan.summary.channels.items() if channel.topic.endswith("/rate")]
            samples += N * sum(n in chunk.message_index_offsets for n in of_rate)
    return samples


def victims(store: Store) -> dict[str, list[Path]]:
    """Files of each kind."""
    return {
        "segment": sorted(store.log.glob("*.mcap")),
        "log manifest": [store.log / "manifest.jsonl"],
        "parquet": sorted(store.lake.glob("*/*.parquet")),
        "part": sorted(store.lake.glob("*/part.json")),
        "lake manifest": [store.lake / "manifest.json"],
        "checkpoint": [store.folder / CHECKPOINT, store.folder / f"{CHECKPOINT}.previous"],
    }


def samples_in(store: Store) -> tuple[int, int]:
    """Samples in the log and in the lake."""
    in_log = 0
    for segment in store.log.glob("*.mcap"):
        in_log += sum(record.schema == SAMPLES for record in SegmentScan(segment, sealed=True)) * N
    with Catalog(store) as catalog:
        ((in_lake,),) = catalog.rows("select count(*) from samples")
    return in_log, int(in_lake)


def judge(store: Store, kind: str, path: Path, all_samples: int, least: int) -> str | None:
    """What is wrong with how a damage was treated; None if nothing is."""
    damaged = path.read_bytes()
    found, _ = verify(store)
    if found.is_sound:
        return "verify says that the store is sound"
    name = path.name if kind != "part" else path.parent.name
    # a manifest that ends early lists fewer segments: that is how it is seen
    is_short = kind == "log manifest" and any(finding.kind == "segment_unlisted" for finding in found.findings)
    if not is_short and not any(name in f"{finding.where} {finding.what}" for finding in found.findings):
        return f"verify does not name the file: {[finding.where for finding in found.findings]}"
    list(recover(store))
    again, _ = verify(store)
    if not again.is_sound:
        return f"not sound after recover: {[(each.kind, each.where, each.what) for each in again.findings]}"
    in_log, in_lake = samples_in(store)
    if in_lake != all_samples:
        return f"{in_lake} samples in the lake"
    if in_log < least:
        return f"{in_log} samples in the log, {least} are not touched"
    folders = (store.aside, store.folder / "lake-aside", store.folder / "checkpoints")
    kept = [each for folder in folders for each in folder.rglob("*")]
    if not is_short and not any(each.is_file() and each.read_bytes() == damaged for each in kept):
        return "the damaged file is not kept"
    return None


def trials(count: int, seed: int, segments: int = SEGMENTS) -> dict[str, Any]:
    """Damage so often a store of so many segments; what came of it."""
    rng = random.Random(seed)
    wrong: list[str] = []
    done: Counter[str] = Counter()
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as temporary:
        whole = Path(temporary) / "whole"
        make(whole, segments)
        all_samples = samples_in(Store.open(whole))[0]
        for number in range(count):
            folder = Path(temporary) / "store"
            shutil.rmtree(folder, ignore_errors=True)
            shutil.copytree(whole, folder)
            store = Store.open(folder)
            kinds = sorted(victims(store))
            kind = kinds[number] if number < len(kinds) else rng.choice(kinds)  # each at least once
            path = rng.choice(victims(store)[kind])
            reported, touched = inflict(rng, path)
            least = all_samples
            if kind == "segment":
                original = whole / path.relative_to(folder)
                least -= untouched(original, range(0)) - untouched(original, touched)
            failure = judge(store, kind, path, all_samples, least)
            done[kind] += 1
            if failure is not None:
                wrong.append(f"trial {number}, {kind}, {path.relative_to(folder)}, {reported}: {failure}")
                print(wrong[-1], file=sys.stderr)
    return {"trials": count, "by_kind": done, "wrong": wrong, "seconds": round(time.monotonic() - began)}


def main() -> None:
    """Run the trials and say what came of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    result = trials(arguments.count, arguments.seed)
    wrong = result["wrong"]
    text = f"{arguments.count} damages {dict(result['by_kind'])} in {result['seconds']} s: {len(wrong)} treated wrongly"
    print(json.dumps(result) if arguments.json else text)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
