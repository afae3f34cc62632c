"""The recorder's documents about itself in the log: recoveries, clock steps, conflicts and pauses."""

import math
import time
from collections.abc import Callable
from typing import Any
from uuid import uuid4

from storage.log.event_log import EventLog
from storage.log.store_documents import append_document, store_document
from storage.recording.intake import Intake
from storage.store import Store
from stream.identity import Place, event_key
from stream.wire.acknowledgement import StreamId

_CONFLICTS_EVERY_S = 1.0
_CLOCK_STEP_NS = 100_000_000
_KEY = event_key(Place("store", "recorder"))


class Reports:
    """Appends documents of the store to its log; called by the writer thread of a recorder."""

    def __init__(self, store: Store, log: EventLog, intake: Intake, warn: Callable[[str], None]) -> None:
        self._store, self._log, self._intake = store, log, intake
        self._warn = warn
        self._stream = StreamId(_KEY, uuid4().hex)
        self._recoveries = 0
        self._warnings = len(log.warnings)
        self._conflicts_at = -math.inf
        self._wall_ahead_ns: int | None = None

    def append(self, what: str, text: str, details: dict[str, Any]) -> None:
        """Append a document."""
        append_document(self._log, self._stream, store_document(self._store.identity, what, text, details))

    def log_changes(self) -> None:
        """Document segments that were recovered since the last call, and pass on new warnings of the log."""
        for warning in self._log.warnings[self._warnings :]:
            self._warn(warning)
        self._warnings = len(self._log.warnings)
        while self._recoveries < len(self._log.recovered):
            recovery = self._log.recovered[self._recoveries]
            self._recoveries += 1
            kept = None if recovery.kept_aside is None else recovery.kept_aside.name
            details = {"segment": recovery.segment, "lost": [vars(each) for each in recovery.lost], "kept_aside": kept}
            self.append("segment_recovered", f"{recovery}; it was left open", details)

    def clock_steps(self) -> None:
        """Document steps of the sources' clocks and of the recorder's own."""
        steps, self._intake.clock_steps = self._intake.clock_steps, []
        for step in steps[:100]:
            text = f"{step.key}: the source's clock went back by {step.back_ns / 1e9:.9g} s at sample {step.seq}"
            self.append("source_clock_back", text, {"run": step.run, "seq": step.seq, "back_ns": step.back_ns})
        before_ns, self._wall_ahead_ns = self._wall_ahead_ns, time.time_ns() - time.monotonic_ns()
        step_ns = 0 if before_ns is None else self._wall_ahead_ns - before_ns
        if abs(step_ns) > _CLOCK_STEP_NS:
            text = f"the recorder's clock, which gives arrival times, was set by {step_ns / 1e9:+.3f} s"
            self._warn(text)
            self.append("arrival_clock_step", text, {"step_ns": step_ns})

    def conflicts(self, now: float) -> None:
        """Document numbers that were received with two contents; at most once a second."""
        if not self._intake.conflicts or now < self._conflicts_at + _CONFLICTS_EVERY_S:
            return
        self._conflicts_at = now
        found, self._intake.conflicts = self._intake.conflicts, []
        first, more = found[0], f" and {len(found) - 1} more messages" if len(found) > 1 else ""
        text = (
            f"{first.key}: numbers {first.seq} to {first.next_seq - 1} of epoch {first.epoch} came with other content "
            f"than is recorded{more}; they are kept beside it in the log: two sources send under one name, or one "
            f"restarted its numbers"
        )
        self._warn(text)
        self.append("number_conflict", text, {"conflicts": [vars(each) for each in found[:100]], "count": len(found)})
