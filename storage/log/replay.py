"""A stored run from the log, to be sent again, and the comparison of its new estimates with the stored ones."""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import msgspec

from storage.log.files import sealed_segments
from storage.log.sequence import place_of
from storage.log.tail import records_of
from storage.manifests.log import read_log_manifest
from storage.segments.records import LogRecord
from storage.store import Store
from stream.errors import NotFound
from stream.estimators.bias_stability import BiasStability
from stream.events import AnyDocument, EarlyDecision, EstimatePublished, NoiseFitted, SpectralLinesFound, decode_event
from stream.identity import EstimateKey, SampleKey, parse_key

_LISTED = 100

Estimated = EstimatePublished | NoiseFitted | SpectralLinesFound | EarlyDecision


class StoredMessage(NamedTuple):
    """A message of a run in the log; `last_ns` is the source time of its last sample, None for a document."""

    key: str
    payload: bytes
    samples: int
    last_ns: int | None


class StoredEstimate(NamedTuple):
    """Name of an estimator's document, and a hash of its content."""

    name: str
    digest: bytes


class StoredRun:
    """A run in the log of a store; NotFound if the log holds nothing of it.

    `estimates` are those published, by the identity of the document, at the intervals `every_ns`, of the `signals` and
    with bias stabilities of the averaging times `averages_s`.
    """

    def __init__(self, store: Store, run: str) -> None:
        self._store, self.run = store, run
        entries = read_log_manifest(store).entries
        self._without = {name for name, entry in entries.items() if run not in entry.runs}
        self.estimates: dict[str, StoredEstimate] = {}
        self.every_ns: set[int] = set()
        self.averages_s: set[float] = set()
        self.signals: set[str] = set()
        self.is_ended = False
        is_there = False
        for record in self._records():
            place = place_of(record)
            if place is None or place.run != run:
                continue
            is_there = True
            self.is_ended = self.is_ended or place.is_end
            if isinstance(parse_key(record.topic), EstimateKey):
                self._keep(decode_event(record.data).document)
        if not is_there:
            raise NotFound(f"{store.folder} holds no run {run!r}; ask `gyrofleet sql` for the runs that it holds")

    def messages(self, progress: Callable[[float], None] | None = None) -> Iterator[StoredMessage]:
        """Messages of its sources in the recorded order, without estimates."""
        for record in self._records(progress):
            place = place_of(record)
            if place is None or place.run != self.run:
                continue
            key = parse_key(record.topic)
            if not isinstance(key, EstimateKey):
                last_ns = place.last_ns if isinstance(key, SampleKey) else None
                yield StoredMessage(record.topic, record.data, place.samples, last_ns)

    def _records(self, progress: Callable[[float], None] | None = None) -> Iterator[LogRecord]:
        total = len(sealed_segments(self._store))
        seen = 0

        def is_needed(segment: str) -> bool:
            nonlocal seen
            seen += 1
            if progress is not None:
                progress(min(1.0, seen / (total + 1)))
            return segment not in self._without

        return records_of(self._store, is_needed, lambda _key: True)

    def _keep(self, document: AnyDocument) -> None:
        if not isinstance(document, Estimated):
            return
        self.estimates.setdefault(document.uid, StoredEstimate(name_of(document), _digest(document)))
        self.signals.add(document.signal)
        if isinstance(document, EstimatePublished):
            if document.every_ns:
                self.every_ns.add(document.every_ns)
            if document.estimator.startswith("bias_stability_"):
                self.averages_s.update(_average_of(document))


@dataclass
class Comparison:
    """New documents compared with the stored ones: how many are stored, were made, and agree to the last bit.

    `different`, `missing` and `extra` are names of those that differ, were not made, and are not stored; the first
    hundred each.
    """

    stored: int
    made: int = 0
    equal: int = 0
    different: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    extra: list[str] = field(default_factory=list)

    @property
    def is_equal(self) -> bool:
        """Whether all agree."""
        return self.equal == self.stored == self.made


class Comparing:
    """Publisher that compares each document of a worker with the stored one of the same identity."""

    outstanding = 0

    def __init__(self, stored: dict[str, StoredEstimate]) -> None:
        self._open = dict(stored)
        self.found = Comparison(len(stored))

    def send_event(self, _key: str, document: AnyDocument) -> None:
        """Compare a document; a verdict follows from estimates that are compared."""
        if not isinstance(document, Estimated):
            return
        self.found.made += 1
        stored = self._open.pop(document.uid, None)
        if stored is not None and stored.digest == _digest(document):
            self.found.equal += 1
            return
        names = self.found.extra if stored is None else self.found.different
        if len(names) < _LISTED:
            names.append(name_of(document))

    def drain(self) -> None:
        """Do nothing: no message is ever outstanding."""

    def result(self) -> Comparison:
        """The comparison, once all documents have been made."""
        self.found.missing = [stored.name for stored in self._open.values()][:_LISTED]
        return self.found


def name_of(document: Estimated) -> str:
    """Name of an estimator's document for people.

    >>> name_of(NoiseFitted(run="r1", t_ns=5, unit="FOG-1", signal="rate"))
    'FOG-1 rate NoiseFitted at 5 ns'
    """
    if isinstance(document, EstimatePublished):
        what, final = document.estimator, ", final" if document.final else ""
    else:
        what, final = type(document).__name__, ""
    return f"{document.unit} {document.signal} {what} at {document.t_ns} ns{final}"


def _average_of(document: EstimatePublished) -> list[float]:
    """Averaging time of a bias stability over the whole record, from its points, else from its name."""
    name = document.estimator.removeprefix("bias_stability_")
    if name == "raw" or "_over_" in name:
        return []
    if document.points:
        return [document.points[0].tau_s]
    average_s = float(name.removesuffix("s"))
    return [average_s] if BiasStability(average_s).key == document.estimator else []


def _digest(document: AnyDocument) -> bytes:
    return hashlib.blake2b(msgspec.json.encode(document), digest_size=16).digest()
