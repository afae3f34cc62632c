"""The store noted something: a clock that was set, a segment that was damaged, recording that was paused."""

from collections.abc import Iterator

from analytics.alerts.finding import AlertView, Condition, Finding
from analytics.event_words import notes_of_store, store_note
from analytics.loop.bilingual import Bilingual
from stream.errors import BadInput
from stream.events import StoreNoted
from stream.mistakes import near_name


class StoreNotedCondition(Condition, frozen=True, kw_only=True, tag="store_noted"):
    """The store notes one of `what`, the words of `StoreNoted` in the view `events`."""

    what: tuple[str, ...] = (
        "source_clock_back", "arrival_clock_step", "segment_recovered", "recording_paused", "disk_low", "disk_error",
        "number_conflict",
    )  # fmt: skip

    def check(self) -> None:
        """As of `Condition`."""
        known = notes_of_store()
        if wrong := [each for each in self.what if each not in known]:
            there = near_name(wrong[0], known) or f"; there are {', '.join(known)}"
            raise BadInput(f"the store notes no {wrong[0]!r}{there}")

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """Notes since the last look."""
        for document in view.documents:
            if isinstance(document, StoreNoted) and document.what in self.what:
                text = store_note(document.what, document.text)
                yield Finding(document.uid, document.what, text, is_event=True)


class DamagedSegmentCondition(Condition, frozen=True, kw_only=True, tag="damaged_segment"):
    """Bytes of a segment of the log cannot be read."""

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """Segments that are damaged."""
        for segment, size in view.damaged_bytes.items():
            text = Bilingual(
                f"{size:,} bytes of segment {segment} of the log are damaged; `gyrofleet verify` has the details",
                f"日志段{segment}有{size:,}字节损坏；详见`gyrofleet verify`",
            )
            yield Finding(segment, segment, text, is_event=True)
