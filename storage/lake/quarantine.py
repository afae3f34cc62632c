"""Messages that cannot be built into the lake, as of older versions: left out, counted, reported as events."""

from dataclasses import dataclass
from uuid import NAMESPACE_OID, uuid5

import msgspec

from storage.log.sequence import place_of
from storage.log.store_documents import LAKE
from storage.segments.records import LogRecord
from stream.errors import GyrofleetError
from stream.events import AnyDocument, StoreNoted
from stream.identity import Place

QUARANTINED = "message_quarantined"
_MOST_LISTED = 1000


@dataclass
class _Kind:
    """Quarantined messages of one key and reason."""

    key: str
    reason: str
    arrival_ns: int
    first_seq: int | None
    messages: int = 0
    samples: int = 0


class Quarantine:
    """The messages of one segment that cannot be built, and the samples in them as far as they can be read."""

    def __init__(self, store: str, segment: str) -> None:
        self._store, self._segment = store, segment
        self._kinds: dict[tuple[str, str], _Kind] = {}
        self.messages = self.samples = 0

    def add(self, record: LogRecord, error: Exception) -> None:
        """Leave out a message."""
        seq, samples = None, 0
        try:
            place = place_of(record)
            if place is not None:
                seq, samples = place.seq, place.samples
        except GyrofleetError:
            pass  # it cannot be read at all
        self.messages += 1
        self.samples += samples
        reason = f"{type(error).__name__}: {error}" if not isinstance(error, GyrofleetError) else str(error)
        name = (record.topic[:200], reason[:300])
        kind = self._kinds.get(name)
        if kind is None:
            if len(self._kinds) >= _MOST_LISTED:
                return
            kind = self._kinds[name] = _Kind(*name, record.arrival_ns, seq)
        kind.messages += 1
        kind.samples += samples

    def rows(self) -> list[dict[str, object]]:
        """Rows of the table of events, one for each key and reason; deterministic."""
        return [event_row(LAKE, self._document(kind), kind.arrival_ns) for kind in self._kinds.values()]

    def _document(self, kind: _Kind) -> StoreNoted:
        text = (
            f"segment {self._segment}: {kind.messages} messages with {kind.samples} samples of {kind.key} cannot be "
            f"brought to the lake: {kind.reason}; the log keeps them"
        )
        details = {
            "store": self._store, "segment": self._segment, "key": kind.key, "reason": kind.reason,
            "messages": kind.messages, "samples": kind.samples, "first_seq": kind.first_seq,
        }  # fmt: skip
        uid = uuid5(NAMESPACE_OID, f"{self._store}\x00{self._segment}\x00{kind.key}\x00{kind.reason}").hex
        return StoreNoted(run="", t_ns=kind.arrival_ns, uid=uid, what=QUARANTINED, text=text, details=details)


def event_row(place: Place, document: AnyDocument, arrival_ns: int) -> dict[str, object]:
    """Row of a document in the table of events."""
    row = {name: getattr(document, name, None) for name in ("run", "unit", "uid", "t_ns")}
    row |= {"site": place.site, "station": place.station, "kind": type(document).__name__, "arrival_ns": arrival_ns}
    return row | {"document": msgspec.json.encode(document).decode()}
