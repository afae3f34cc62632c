"""Raw rows that were dropped from the lake or restored, by the documents in the log."""

from typing import NamedTuple

from storage.log.store_documents import is_own
from stream.events import RAW_ROWS_DROPPED, RAW_ROWS_RESTORED, StoreNoted
from stream.wire.event_validation import invalid_reason


class Drops(NamedTuple):
    """Segments whose raw rows are dropped, by which document, and restored ones, by which documents no longer."""

    dropped: dict[str, str]
    restored: dict[str, tuple[str, ...]]

    def take(self, document: StoreNoted, store: str) -> None:
        """Apply a document, if it is the store's own and about raw rows."""
        if not is_own(document, store) or invalid_reason(document) is not None:
            return
        if document.what == RAW_ROWS_DROPPED:
            self.dropped.update(dict.fromkeys(document.details["segments"], document.uid))
        elif document.what == RAW_ROWS_RESTORED:
            ended = tuple(document.details["documents"])
            for segment in document.details["segments"]:
                self.restored[segment] = (*self.restored.get(segment, ()), *ended)

    def join(self, other: "Drops") -> "Drops":
        """The union; restored segments are not dropped, and `self` takes precedence over `other`."""
        restored = {
            segment: tuple(dict.fromkeys((*other.restored.get(segment, ()), *self.restored.get(segment, ()))))
            for segment in other.restored.keys() | self.restored.keys()
        }
        dropped = {
            segment: document
            for drops in (other.dropped, self.dropped)
            for segment, document in drops.items()
            if document not in restored.get(segment, ())
        }
        return Drops(dropped, restored)
