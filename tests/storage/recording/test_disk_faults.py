"""Disks that fail and disks that forget: what was acknowledged is in the log, once, whatever they do."""

import errno
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.segments.disk import Disk, OpenFile
from storage.segments.reader import read_segment
from storage.segments.records import SAMPLES, LogRecord
from storage.store import Store
from stream.batch import SampleBatch
from stream.identity import Place, sample_key
from stream.wire.acknowledgement import StreamId
from stream.wire.batches import decode_batch, encode_batch

PLACE = Place("plant", "bench")
UNITS = ("U1", "U2")
BLOCK = 4096


def samples(unit: str, first: int, n: int = 50) -> LogRecord:
    values = np.random.default_rng(first).standard_normal(n)
    batch = SampleBatch(unit, "rate", "r1", UUID(int=1), first, first * 10**6, 10**6, "deg/s", values=values)
    return LogRecord(sample_key(PLACE, unit, "rate"), SAMPLES, 10**18 + first, batch.t0_ns, encode_batch(batch))


def append(log: EventLog, record: LogRecord) -> None:
    place = place_of(record)
    assert place is not None
    log.append(place, record)


def numbers(store: Store) -> dict[str, list[int]]:
    """First numbers of the batches of each unit in the sealed segments, in the order of the log."""
    found: dict[str, list[int]] = {unit: [] for unit in UNITS}
    for segment in sorted(store.log.glob("*.mcap")):
        for record in read_segment(segment):
            batch = decode_batch(record.data)
            found[batch.unit].append(batch.seq)
    return found


@dataclass
class _File:
    """What was written to a file, a cut being an empty write, and how much of that a power loss cannot take back."""

    writes: list[tuple[int, bytes]] = field(default_factory=list)
    length: int = 0
    durable: int = 0


class ForgetfulDisk(Disk):
    """Notes every write and name, so that any state that a power loss may leave can be made of them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[int, _File] = {}
        self._names: list[tuple[str, Path, int]] = []  # what was done to the names of the folder, in turn
        self._durable_names = 0

    def create(self, path: Path) -> OpenFile:
        file = super().create(path)
        self._names.append(("put", path, self._number(path)))
        return file

    def reopen(self, path: Path, length: int) -> OpenFile:
        file = super().reopen(path, length)
        found = self._files[self._number(path)]
        found.writes.append((length, b""))
        found.length = length
        return file

    def write(self, file: OpenFile, content: bytes) -> None:
        super().write(file, content)
        found = self._files[self._number(file.path)]
        found.writes.append((found.length, bytes(content)))
        found.length += len(content)

    def sync_data(self, file: OpenFile) -> None:
        super().sync_data(file)
        found = self._files[self._number(file.path)]
        found.durable = len(found.writes)

    def sync(self, file: OpenFile) -> None:
        self.sync_data(file)

    def rename(self, path: Path, target: Path) -> None:
        number = self._number(path)
        super().rename(path, target)
        self._names += [("put", target, number), ("drop", path, number)]

    def replace(self, path: Path, target: Path) -> None:
        number = self._number(path)
        super().replace(path, target)
        self._names += [("put", target, number), ("drop", path, number)]

    def link(self, path: Path, target: Path) -> None:
        super().link(path, target)
        self._names.append(("put", target, self._number(path)))

    def remove(self, path: Path) -> None:
        self._names.append(("drop", path, self._number(path)))
        super().remove(path)

    def sync_folder(self, folder: Path) -> None:
        super().sync_folder(folder)
        self._durable_names = len(self._names)

    def _number(self, path: Path) -> int:
        number = path.stat().st_ino
        self._files.setdefault(number, _File())
        return number

    def after_power_loss(self, rng: random.Random, target: Path) -> None:
        """Make a state that may be found: what was not made durable is there in part, in blocks of any order."""
        shutil.copytree(self._folder, target, ignore=shutil.ignore_patterns("log"))
        names: dict[Path, int] = {}
        kept = rng.randint(self._durable_names, len(self._names))
        for what, path, number in self._names[:kept]:
            if what == "put":
                names[path] = number
            else:
                names.pop(path, None)
        (target / "log").mkdir()
        for path, number in names.items():
            place = target / path.relative_to(self._folder)
            place.parent.mkdir(exist_ok=True)
            place.write_bytes(self._content(self._files[number], rng))

    @staticmethod
    def _content(file: _File, rng: random.Random) -> bytes:
        content = bytearray()
        for at, written in file.writes[: file.durable]:
            del content[at:]
            content += written
        pieces = []
        for at, written in file.writes[file.durable :]:
            if not written:
                if rng.random() < 0.5:
                    del content[at:]
                continue
            pieces += [(at + begin, written[begin : begin + BLOCK]) for begin in range(0, len(written), BLOCK)]
        for at, piece in pieces:
            if rng.random() < 0.5:
                continue
            if len(content) < at:
                content += bytes(at - len(content))  # the length is there, its blocks are not
            content[at : at + len(piece)] = piece
        return bytes(content)


@pytest.mark.in_gate("11")
@pytest.mark.parametrize("seed", range(12))
def test_after_a_power_loss_the_log_has_what_was_acknowledged(tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    store = Store.create(tmp_path / "store")
    disk = ForgetfulDisk(store.folder)
    log = EventLog(store, rotate_bytes=6000, disk=disk)
    acknowledged = dict.fromkeys(UNITS, 0)
    sent = dict.fromkeys(UNITS, 0)
    crashes = 0
    for _ in range(120):
        unit = rng.choice(UNITS)
        append(log, samples(unit, sent[unit]))
        sent[unit] += 50
        if rng.random() < 0.3:
            log.sync()
            acknowledged = dict(sent)
        if log.due:
            log.seal()
            acknowledged = dict(sent)
        if rng.random() < 0.25:
            crashes += 1
            copy = tmp_path / f"crash-{crashes}"
            disk.after_power_loss(rng, copy)
            check_crash(copy, acknowledged, sent)
    assert crashes > 15


def check_crash(folder: Path, acknowledged: dict[str, int], sent: dict[str, int]) -> None:
    store = Store.open(folder)
    log = EventLog(store)
    found = numbers(store)
    for unit in UNITS:
        count = len(found[unit])
        assert found[unit] == list(range(0, 50 * count, 50)), "each once, in order, without a hole"
        assert acknowledged[unit] <= 50 * count <= sent[unit]
        assert log.marks.get(StreamId(sample_key(PLACE, unit, "rate"), UUID(int=1).hex), 0) == 50 * count
    # and what was recovered is itself durable and goes on
    append(log, samples("U1", 50 * len(found["U1"])))
    log.seal()
    assert len(numbers(store)["U1"]) == len(found["U1"]) + 1
    again = EventLog(store)
    assert again.recovered == []
    assert again.warnings == []


class FailingDisk(Disk):
    """Refuses one operation, or every one from it on."""

    def __init__(self, at: int, error: int, *, forever: bool = False, half: bool = False) -> None:
        self.at, self.error, self.forever, self.half = at, error, forever, half
        self.count = 0

    def _maybe(self) -> bool:
        self.count += 1
        return self.count == self.at or (self.forever and self.count > self.at)

    def _fail(self) -> None:
        raise OSError(self.error, "injected")

    def write(self, file: OpenFile, content: bytes) -> None:
        if self._maybe():
            if self.half:
                super().write(file, content[: len(content) // 2])
            self._fail()
        super().write(file, content)


def _failing(name: str) -> Callable[..., None]:
    def fail(self: FailingDisk, *arguments: object) -> None:
        if self._maybe():
            self._fail()
        getattr(Disk, name)(self, *arguments)

    return fail


for _name in ("sync_data", "sync", "rename", "sync_folder"):
    setattr(FailingDisk, _name, _failing(_name))


def record_through(log: EventLog, rounds: int) -> dict[str, int]:
    """Send in rounds as a source does, what was not acknowledged again; how far it was acknowledged."""
    acknowledged = dict.fromkeys(UNITS, 0)
    for round_ in range(rounds):
        try:
            for unit in UNITS:
                position = log.marks.get(StreamId(sample_key(PLACE, unit, "rate"), UUID(int=1).hex), 0)
                assert position >= acknowledged[unit], "what was acknowledged is forgotten"
                append(log, samples(unit, position))
            log.sync()
            acknowledged = {
                unit: log.marks[StreamId(sample_key(PLACE, unit, "rate"), UUID(int=1).hex)] for unit in UNITS
            }
            if round_ % 4 == 3:
                log.seal()
                log.recover()
        except OSError as error:
            if error.strerror != "injected":
                raise
            log.abandon()
    return acknowledged


@pytest.mark.long
@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("error", [errno.EIO, errno.ENOSPC])
def test_an_error_at_any_operation_loses_nothing_acknowledged(tmp_path: Path, error: int, half: bool) -> None:
    for at in range(1, 70):
        store = Store.create(tmp_path / f"{at}")
        disk = FailingDisk(at, error, half=half)
        log = EventLog(store, disk=disk)
        acknowledged = record_through(log, 16)
        assert disk.count >= at, "the fault was never reached"
        log.seal()
        log.recover()
        found = numbers(store)
        for unit in UNITS:
            assert found[unit] == list(range(0, 50 * len(found[unit]), 50)), f"fault {at}"
            assert 50 * len(found[unit]) >= acknowledged[unit] >= 50 * 14, f"fault {at}"
        assert EventLog(store).recovered == []
        assert EventLog(store).warnings == []


@pytest.mark.parametrize("at", range(3, 60, 3))
def test_a_process_killed_after_an_error_loses_nothing_acknowledged(tmp_path: Path, at: int) -> None:
    store = Store.create(tmp_path)
    disk = FailingDisk(at, errno.EIO, forever=at % 2 == 0, half=True)
    acknowledged = record_through(EventLog(store, disk=disk), 9)
    EventLog(store)  # the next process
    found = numbers(store)
    for unit in UNITS:
        assert found[unit] == list(range(0, 50 * len(found[unit]), 50))
        assert 50 * len(found[unit]) >= acknowledged[unit]
