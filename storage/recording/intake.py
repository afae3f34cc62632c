"""What a recorder does with a message: append it, recognise a duplicate, request a rewind, or quarantine it."""

import time
import zlib
from collections import deque
from dataclasses import dataclass, field
from functools import lru_cache

from storage.log.event_log import EventLog
from storage.log.run_owners import RunOwners
from storage.log.sequence import LogPlace
from storage.log.store_documents import forgery
from storage.recording.acts.two_persons import reason_against
from storage.segments.records import EVENTS, PREVIEW, REJECTED, SAMPLES, LogRecord
from storage.store import Store
from stream.bounds import MAX_MESSAGE_BYTES, MAX_NAME_CHARS
from stream.errors import GyrofleetError, WireError
from stream.events import (
    AnyDocument,
    ApprovedAct,
    CheckEntered,
    ExclusionEntered,
    ModelActivated,
    RunEnded,
    RunStarted,
    StoreNoted,
)
from stream.identity import EstimateKey, EventKey, SampleKey, check_name, parse_key
from stream.security.authority import check_authority
from stream.security.proof import SourceVerifier, split
from stream.security.rights import Principal, Role
from stream.wire.acknowledgement import StreamId
from stream.wire.batches import encode_preview, read_batch_head
from stream.wire.event_validation import decode_received

MAX_REJECT_BYTES = 64 << 10
_REJECTS_BYTES = 128 << 20  # kept at once; later this much per second, so that invalid messages fill no disk
_REJECTS_BYTES_PER_S = 64 << 10
_PREVIEW_INTERVAL_NS = 30_000_000_000
_REWIND_INTERVAL_S = 0.2
_MOST_ENDED = 10_000
_MOST_RECENT = 250_000  # of each generation, about 100 bytes each
_parse_key = lru_cache(maxsize=200_000)(parse_key)


@lru_cache(maxsize=200_000)
def _checked_key(key: str) -> SampleKey | EstimateKey | EventKey:
    """The parts of a key of which each is a name."""
    parsed = parse_key(key)
    named = {"site": parsed.place.site, "station": parsed.place.station}
    if not isinstance(parsed, EventKey):
        named |= {"unit": parsed.unit, "signal": parsed.signal}
    for kind, name in named.items():
        check_name(kind, name)
    return parsed


@dataclass
class RecorderCounts:
    """Totals of a recorder since its start."""

    messages: int = 0
    samples: int = 0
    duplicates: int = 0
    conflicts: int = 0
    out_of_order: int = 0
    rejected: int = 0
    rejected_not_kept: int = 0
    backwards: int = 0
    left_to_sources: int = 0
    segments: int = 0
    interruptions: int = 0
    last_sample_ns: int = 0  # when it arrived
    rejections: deque[str] = field(default_factory=lambda: deque(maxlen=20))


@dataclass(frozen=True)
class ClockStep:
    """A batch that begins before the end of the previous one, by the source's clock."""

    key: str
    run: str
    seq: int
    back_ns: int


@dataclass(frozen=True)
class NumberConflict:
    """A message whose numbers are recorded with other content; it is kept beside the recorded one."""

    key: str
    epoch: str
    seq: int
    next_seq: int


class RecentMessages:
    """Digests of the last messages recorded, at least 250,000, to tell duplicates from conflicts.

    Python's salted hashes: another process cannot make a message of equal digest.

    >>> recent = RecentMessages()
    >>> recent.add(("k", "e"), 0, b"a")
    >>> recent.differs(("k", "e"), 0, b"a"), recent.differs(("k", "e"), 0, b"b"), recent.differs(("k", "e"), 7, b"b")
    (False, True, None)
    """

    def __init__(self, most: int = _MOST_RECENT) -> None:
        self._most = most
        self._young: dict[int, int] = {}
        self._old: dict[int, int] = {}

    def add(self, stream: tuple[str, str], seq: int, payload: bytes) -> None:
        """Keep the digest of a message."""
        if len(self._young) >= self._most:
            self._old, self._young = self._young, {}
        self._young[hash((stream, seq))] = hash(payload)

    def differs(self, stream: tuple[str, str], seq: int, payload: bytes) -> bool | None:
        """Whether another message was recorded under that number; None if that is no longer known."""
        name = hash((stream, seq))
        found = self._young.get(name, self._old.get(name))
        return None if found is None else found != hash(payload)


def _unknown_model(store: Store, document: AnyDocument) -> str | None:
    """Why an error model that is put to use cannot be; None if its version is in the store."""
    if not isinstance(document, ModelActivated) or document.stage == "off":
        return None
    folder = store.folder / "models" / document.unit
    if any(path.name.endswith(f"-{document.model}.json") for path in folder.glob("*.json")):
        return None
    return f"the store has no version {document.model[:80]} of the error model of {document.unit}"


class Intake:
    """Appends messages to a log in the order of their numbers.

    `moved` are streams whose source waits for an acknowledgement, `received` the number after the last message received
    of each: no more is acknowledged, whatever the log has. `rewinds` are streams of which messages are missing, to be
    requested; `conflicts` messages whose numbers are recorded with other content. `ended_runs` counts ends of runs,
    `late` messages after the end of their run (resent ones, estimates), `exclusions` and `checks` what people enter
    that evaluations follow; the recorder resets them. With `sources` a message needs a proof of its source, which is
    authorised for it; `owners` say whose runs a station may add to.
    """

    def __init__(
        self, log: EventLog, store: Store, sources: SourceVerifier | None = None, owners: RunOwners | None = None
    ) -> None:
        self._log, self._store, self._sources, self._owners = log, store, sources, owners
        self._recent = RecentMessages()
        self.conflicts: list[NumberConflict] = []
        self.counts = RecorderCounts()
        self.moved: set[StreamId] = set()
        self.received: dict[StreamId, int] = {}
        self.rewinds: list[StreamId] = []
        self.clock_steps: list[ClockStep] = []
        self.ended_runs = self.late = self.exclusions = self.checks = 0
        self._ended: dict[str, None] = {}
        self._authorised: dict[str, Principal] = {}  # who may send samples under a key
        self._runs: dict[str, str] = {}  # of a key's last samples
        self._asked: dict[StreamId, tuple[int, float]] = {}
        self._last_ns: dict[StreamId, int] = {}
        self._previewed: dict[str, int] = {}
        self._rejects_room = float(_REJECTS_BYTES)
        self._rejected_at = time.monotonic()

    def add(self, key: str, payload: bytes, arrival_ns: int) -> None:
        """Append or answer one message; OSError if it cannot be written."""
        self.counts.messages += 1
        try:
            parsed = _checked_key(key)
            if len(payload) > MAX_MESSAGE_BYTES:
                raise WireError(f"{len(payload)} bytes are more than the {MAX_MESSAGE_BYTES} a message may have")
            source, body = self._opened(key, payload)
            if isinstance(parsed, SampleKey):
                if source is not None and self._authorised.get(key) is not source:
                    check_authority(source, key, parsed, None)
                    self._authorised[key] = source
                self._add_samples(key, parsed, payload, body, arrival_ns, source)
            else:
                self._add_document(key, parsed, payload, body, arrival_ns, source)
        except GyrofleetError as error:
            self.counts.rejected += 1
            self.counts.rejections.append(f"{key[:200]}: {str(error)[:500]}")
            self._keep_rejected(key, payload, arrival_ns)

    def _opened(self, key: str, payload: bytes) -> tuple[Principal | None, bytes]:
        """Who sent a message, None without security, and it without its proof; Forged if that is not valid."""
        if self._sources is None:
            message = split(payload)
            message.check()
            return None, message.body
        return self._sources.opened(key, payload)

    def _check_owner(self, run: str, source: Principal | None) -> None:
        """Raise OfAnotherStation if a station adds to a run that another one began."""
        if self._owners is not None and source is not None and source.role is Role.STATION:
            self._owners.check(run, source.name)

    def undo(self, undone: dict[StreamId, int]) -> None:
        """Streams fell back by so many numbers, which are sent again."""
        for stream, count in undone.items():
            self.moved.discard(stream)
            self._last_ns.pop(stream, None)
            if isinstance(_parse_key(stream.key), SampleKey):
                self.counts.samples -= count

    def _keep_rejected(self, key: str, payload: bytes, arrival_ns: int, most: int = MAX_REJECT_BYTES) -> bool:
        """Keep the beginning of a rejected message, up to a rate; whether it is kept."""
        now = time.monotonic()
        refilled = self._rejects_room + (now - self._rejected_at) * _REJECTS_BYTES_PER_S
        self._rejects_room, self._rejected_at = min(refilled, _REJECTS_BYTES), now
        kept = payload[:most]
        if len(kept) > self._rejects_room:
            self.counts.rejected_not_kept += 1
            return False
        self._rejects_room -= len(kept)
        # a foreign key must not name a channel of the log
        self._log.append_aside(LogRecord(key[:1000], REJECTED, arrival_ns, arrival_ns, kept))
        return True

    def _add_samples(
        self, key: str, parsed: SampleKey, payload: bytes, body: bytes, arrival_ns: int, source: Principal | None
    ) -> None:
        unit, signal, run, epoch, seq, next_seq, t0_ns, last_ns, _ = read_batch_head(payload)
        if unit != parsed.unit or signal != parsed.signal:
            raise WireError(f"it holds samples of {unit[:MAX_NAME_CHARS]}/{signal[:MAX_NAME_CHARS]}")
        is_known = self._runs.get(key) == run  # of that run of the key all is checked
        if run and not is_known:
            check_name("run", run)
            self._check_owner(run, source)
        stream = StreamId(key, epoch)
        place = LogPlace(stream, seq, next_seq, t0_ns, last_ns, run)
        if not self._append(place, LogRecord(key, SAMPLES, arrival_ns, t0_ns, payload), body):
            return
        if run and not is_known:
            if self._owners is not None:
                self._owners.add(run, parsed.place.station)
            self._runs[key] = run
        self.counts.samples += next_seq - seq
        self.counts.last_sample_ns = arrival_ns
        before_ns = self._last_ns.get(stream)
        self._last_ns[stream] = last_ns
        if before_ns is not None and t0_ns <= before_ns:
            self.counts.backwards += 1
            self.clock_steps.append(ClockStep(key, run, seq, before_ns - t0_ns))
        shown_ns = self._previewed.get(key)
        if shown_ns is None or abs(t0_ns - shown_ns) >= _PREVIEW_INTERVAL_NS:
            # signals that begin together take turns afterwards
            early_ns = zlib.crc32(key.encode()) % _PREVIEW_INTERVAL_NS if shown_ns is None else 0
            self._previewed[key] = t0_ns - early_ns
            self._log.append_aside(LogRecord(f"{key}/preview", PREVIEW, arrival_ns, t0_ns, encode_preview(body)))

    def _add_document(
        self, key: str, parsed: EventKey | EstimateKey, payload: bytes, body: bytes, arrival_ns: int,
        source: Principal | None,
    ) -> None:  # fmt: skip
        message = decode_received(payload)
        document = message.document
        if source is not None:
            check_authority(source, key, parsed, document)
        if document.run:
            self._check_owner(document.run, source)
        if (reason := forgery(self._store, document)) is not None:
            what = document.what if isinstance(document, StoreNoted) else ""
            raise WireError(f"{type(document).__name__} {what[:80]}".strip() + f": {reason}")
        if isinstance(document, ApprovedAct):
            self._log.sync()  # what it rests on may have come just before
        if (reason := _unknown_model(self._store, document)) is not None:
            raise WireError(f"{type(document).__name__}: {reason}")
        access = None if self._sources is None else self._sources.access
        if (reason := reason_against(self._store, access, document)) is not None:
            raise WireError(f"{type(document).__name__}: {reason}")
        stream = StreamId(key, message.epoch)
        place = LogPlace(
            stream, message.seq, message.seq + 1, document.t_ns, document.t_ns, document.run,
            is_end=isinstance(parsed, EventKey) and isinstance(document, RunEnded),
            is_start=isinstance(document, RunStarted),
        )  # fmt: skip
        if not self._append(place, LogRecord(key, EVENTS, arrival_ns, document.t_ns, payload), body):
            return
        if self._owners is not None and place.is_start:
            self._owners.add(document.run, parsed.place.station)
        if isinstance(document, ExclusionEntered):
            self.exclusions += 1
        self.checks += isinstance(document, CheckEntered)
        if place.is_end:
            self.ended_runs += 1
            self._ended[document.run] = None
            if len(self._ended) > _MOST_ENDED:
                del self._ended[next(iter(self._ended))]

    def _append(self, place: LogPlace, record: LogRecord, body: bytes) -> bool:
        """Append a message if it is the next of its stream; `body` is it without its proof, which differs each time."""
        stream, seq, next_seq = place.stream, place.seq, place.next_seq
        expected = self._log.marks.get(stream, 0)
        if next_seq > self.received.get(stream, 0):
            self.received[stream] = next_seq
        if seq == expected:
            self._log.append(place, record)
            self._recent.add(stream, seq, body)
            self.moved.add(stream)
            self.late += place.run in self._ended
            return True
        if next_seq <= expected:
            if self._recent.differs(stream, seq, body):
                self._keep_conflict(place, record)
            else:
                self.counts.duplicates += 1
                self.moved.add(stream)  # its source missed the acknowledgement
        elif seq < expected:
            raise WireError(f"numbers {seq} to {next_seq - 1} overlap what is recorded up to {expected - 1}")
        else:
            self.counts.out_of_order += 1
            now = time.monotonic()
            asked, at = self._asked.get(stream, (-1, 0.0))
            if asked != expected or now - at >= _REWIND_INTERVAL_S:
                self._asked[stream] = (expected, now)
                self.rewinds.append(stream)
        return False

    def _keep_conflict(self, place: LogPlace, record: LogRecord) -> None:
        """Keep a whole message whose numbers are recorded with other content."""
        self.counts.conflicts += 1
        numbers = f"numbers {place.seq} to {place.next_seq - 1}"
        self.counts.rejections.append(f"{record.topic[:200]}: {numbers} are recorded already, with other content")
        self.conflicts.append(NumberConflict(record.topic, place.stream.epoch, place.seq, place.next_seq))
        if self._keep_rejected(record.topic, record.data, record.arrival_ns, most=MAX_MESSAGE_BYTES):
            self.moved.add(place.stream)  # else its source keeps it
