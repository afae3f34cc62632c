"""Messages that are none, by the ten thousand, beside a good source: does the recorder keep them aside and live.

``python -m tests.crash.fuzz --count 100000``. Random bytes, messages that are cut, flipped, grown, of a wrong schema,
with wrong lengths and numbers, under odd keys or those of others, too large; and messages of the good source's own
numbers that are forged: once more, overlapping, far ahead. Before the recorder, a handler that raises hears everything.
All that is malformed must be found in the log, byte for byte, and nothing of it in the lake; every good sample must be
there once and unchanged, and estimated. With ``--process`` the recorder is a process, reached over Zenoh.

A message that is well formed and has just the next number of a stream is taken: nobody can know that it is forged.
"""

import argparse
import json
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from storage.check.verify import verify
from storage.lake.builder import build_missing, builder_lock
from storage.log.event_log import EventLog
from storage.log.tail import LogTail
from storage.recording.intake import MAX_REJECT_BYTES
from storage.recording.recorder import Recorder
from storage.segments.reader import SegmentScan
from storage.segments.records import REJECTED
from storage.sql.catalog import Catalog
from storage.store import Store, WriterLock
from stream.batch import SampleBatch
from stream.bounds import MAX_MESSAGE_BYTES
from stream.delivery.publisher import DurablePublisher
from stream.errors import BusError
from stream.events import RunEnded, RunStarted, StreamTotal
from stream.identity import EVERYTHING, event_key
from stream.transport.bus import Bus, LocalBus
from stream.transport.zenoh_bus import ZenohBus
from stream.wire.batches import encode_batch
from stream.worker.worker import EstimationWorker
from tests.crash.forged_messages import BATCH, EPOCH, GOOD, PLACE, VICTIM, Forge, Message

GOOD_EVERY = 20  # messages
PATIENCE_S = 120.0


class GoodSource:
    """A source that is as it should be, and what others forge in its name."""

    def __init__(self, bus: Bus, rng: random.Random) -> None:
        self._rng = rng
        self.publisher = DurablePublisher(bus)
        self.counts: list[np.ndarray[Any, np.dtype[np.int32]]] = []
        self._draw = np.random.default_rng(rng.randrange(2**32))
        self.publisher.send_event(event_key(PLACE), RunStarted(run="good", t_ns=0))

    @property
    def samples(self) -> int:
        """How many were sent."""
        return BATCH * len(self.counts)

    def send(self) -> None:
        """Send the next batch."""
        counts = self._draw.normal(0, 50, BATCH).astype(np.int32)
        self.publisher.send_batch(GOOD, self._batch(self.samples, counts))
        self.counts.append(counts)

    def forged(self) -> Message:
        """One that has numbers of this source, but not the next."""
        counts = np.full(BATCH, 666, np.int32)
        how = self._rng.choices(["again", "ahead", "overlap"], [5, 4, 1])[0]
        if how == "overlap":
            self.publisher.drain()  # with which numbers it overlaps is known only when they are recorded
        seq = {"again": 0, "ahead": self.samples + 10**6, "overlap": self.samples - BATCH // 2}[how]
        return Message(how, GOOD, encode_batch(self._batch(seq, counts)), how != "ahead")

    def end(self) -> None:
        """End the run."""
        total = StreamTotal(unit="GOOD", signal="rate", epoch=str(EPOCH), samples=self.samples)
        self.publisher.send_event(event_key(PLACE), RunEnded(run="good", t_ns=self.samples * 10**7, totals=(total,)))
        self.publisher.drain()
        self.publisher.close()

    @staticmethod
    def _batch(seq: int, counts: np.ndarray[Any, np.dtype[np.int32]]) -> SampleBatch:
        return SampleBatch("GOOD", "rate", "good", EPOCH, seq, seq * 10**7, 10**7, "deg/s", counts=counts, scale=0.01)


class Trial:
    """What was sent, and what must therefore be in the log."""

    def __init__(self, bus: Bus, rng: random.Random) -> None:
        self._bus = bus
        self._rng = rng
        self.source = GoodSource(bus, rng)
        self.by_kind: Counter[str] = Counter()
        self.aside: Counter[tuple[str, str]] = Counter()
        self.refused = 0

    def run(self, count: int, oversize: int, wait_for: Callable[[int], None]) -> None:
        """Send so many malformed messages, and good ones between them; `wait_for` so many that are quarantined."""
        forge = Forge(self._rng).messages()
        self.source.send()
        for number in range(count):
            if number % GOOD_EVERY == 0:
                self.source.send()
            self.send(self.source.forged() if self._rng.random() < 0.1 else next(forge))
            if number % 1000 == 0:
                wait_for(self.aside.total())
        for _ in range(oversize):
            wait_for(self.aside.total())
            self.send(Message("oversize", VICTIM, bytes(MAX_MESSAGE_BYTES) + self._rng.randbytes(10), True))
            self.source.send()
        wait_for(self.aside.total())
        self.source.end()

    def send(self, message: Message) -> None:
        """Send one."""
        try:
            self._bus.publish(message.key, message.payload)
        except BusError:
            self.refused += 1  # Zenoh itself takes no such key
            return
        self.by_kind[message.how] += 1
        if message.is_malformed:
            self.aside[message.key[:1000], sha256(message.payload[:MAX_REJECT_BYTES]).hexdigest()] += 1

    @property
    def expected(self) -> tuple[int, int]:
        """How many must be rejected, and how many have numbers that came with other content."""
        conflicts = self.by_kind["again"]
        return self.aside.total() - conflicts, conflicts

    def wrong(self, store: Store) -> list[str]:
        """What is not in the store as it must be."""
        found: Counter[tuple[str, str]] = Counter()
        for segment in sorted(store.log.glob("*.mcap")):
            for record in SegmentScan(segment, sealed=True):
                if record.schema == REJECTED:
                    found[record.topic, sha256(record.data).hexdigest()] += 1
        wrong = []
        if found != self.aside:
            missing, more = list(self.aside - found), list(found - self.aside)
            wrong.append(f"quarantined: {len(missing)} are missing, {missing[:3]}, {len(more)} too many, {more[:3]}")
        with builder_lock(store):
            list(build_missing(store))
        verified, _ = verify(store)
        if not verified.is_sound:
            wrong.append(f"verify: {[(each.kind, each.where, each.what) for each in verified.findings][:5]}")
        with Catalog(store) as catalog:
            rows = catalog.rows("select unit, seq, counts from samples order by unit, seq")
            finals = catalog.rows(
                "select distinct samples, missing from estimates where unit = 'GOOD' and final and signal = 'rate'"
            )
        sent = np.concatenate(self.source.counts).tolist()
        if rows != [("GOOD", seq, count) for seq, count in enumerate(sent)]:
            wrong.append(f"{len(rows)} samples in the lake, {len(sent)} good ones were sent; or they are others")
        if finals and finals != [(len(sent), 0)]:
            wrong.append(f"estimated of samples and missing: {finals}, sent were {len(sent)}")
        return wrong


class Raising:
    """A handler that fails at every message, and how often that was reported."""

    def __init__(self) -> None:
        self.heard = self.reported = 0

    def __call__(self, key: str, payload: bytes) -> None:
        self.heard += 1
        raise ValueError("a handler with a mistake")

    def tell(self, failure: threading.ExceptHookArgs) -> None:
        self.reported += failure.exc_type is ValueError
        if failure.exc_type is not ValueError:
            sys.__excepthook__(failure.exc_type, failure.exc_value or failure.exc_type(), failure.exc_traceback)


def in_this_process(folder: Path, count: int, rng: random.Random, oversize: int) -> tuple[Trial, list[str]]:
    """A recorder and an estimator on a bus in this process."""
    store = Store.create(folder)
    raising = Raising()
    threading.excepthook = raising.tell
    wrong = []
    with ExitStack() as stack:
        bus = stack.enter_context(LocalBus())
        bus.subscribe(EVERYTHING, raising)
        stack.enter_context(WriterLock(store, "fuzz"))
        log = EventLog(store, rotate_bytes=8 << 20)
        recorder = stack.enter_context(Recorder(store, bus, log, sync_interval_s=0.005, builds_lake=False))
        estimates = stack.enter_context(DurablePublisher(bus))
        worker = stack.enter_context(EstimationWorker(bus, estimates, every_s=60.0, log=LogTail(store)))

        def wait_for(rejected: int) -> None:
            deadline = time.monotonic() + PATIENCE_S
            counts = recorder.counts
            while counts.rejected + counts.conflicts < rejected and recorder.failure is None:
                if time.monotonic() > deadline:
                    raise TimeoutError(f"{counts.rejected + counts.conflicts} were counted, {rejected} are malformed")
                time.sleep(0.005)

        trial = Trial(bus, rng)
        trial.run(count, oversize, wait_for)
        worker.close()
        estimates.drain()
        counted = (recorder.counts.rejected, recorder.counts.conflicts)
        if counted != trial.expected:
            wrong.append(f"{counted} were counted as rejected and conflicts, {trial.expected} are malformed")
    if raising.reported != raising.heard or not raising.heard:
        wrong.append(f"a handler failed at {raising.heard} messages, {raising.reported} times it was reported")
    found = trial.wrong(store)
    with Catalog(store) as catalog:
        if not catalog.rows("select 1 from estimates where unit = 'GOOD' and final limit 1"):
            wrong.append("there is no final estimate")
    return trial, wrong + found


def over_zenoh(folder: Path, count: int, rng: random.Random, oversize: int) -> tuple[Trial, list[str]]:
    """`gyrofleet record` as a process of its own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    program = str(Path(sys.executable).with_name("gyrofleet"))
    command = [program, "record", "--listen", endpoint, "--store", str(folder), "--sync-ms", "5", "--json"]
    recorder = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert recorder.stdout is not None
    try:
        recorder.stdout.readline()
        with ZenohBus(connect=[endpoint]) as bus:
            trial = Trial(bus, rng)
            trial.run(count, oversize, lambda _: trial.source.publisher.drain())
        recorder.send_signal(signal.SIGINT)
        said = json.loads(recorder.communicate(timeout=PATIENCE_S)[0].splitlines()[-1])
    finally:
        recorder.kill()
        recorder.wait()
    wrong = [] if recorder.returncode == 0 else [f"the recorder ended with exit code {recorder.returncode}"]
    counted = (said["rejected"], said["conflicts"])
    if counted != trial.expected:
        wrong.append(f"{counted} were counted as rejected and conflicts, {trial.expected} are malformed")
    return trial, wrong + trial.wrong(Store.open(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--oversize", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--process", action="store_true", help="The recorder is a process, reached over Zenoh.")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as temporary:
        tried = over_zenoh if arguments.process else in_this_process
        rng = random.Random(arguments.seed)
        trial, wrong = tried(Path(temporary) / "store", arguments.count, rng, arguments.oversize)
    result = {
        "messages": trial.by_kind.total(),
        "by_kind": dict(sorted(trial.by_kind.items())),
        "malformed": trial.aside.total(),
        "refused_by_zenoh": trial.refused,
        "good_samples": trial.source.samples,
        "resent": trial.source.publisher.resent,
        "seconds": round(time.monotonic() - began),
        "wrong": wrong,
    }
    if arguments.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name}: {value}")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
