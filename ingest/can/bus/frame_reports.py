"""Reports of what the counters of frames show while a bus is received: lost, repeated and late frames, restarts."""

import time
from collections.abc import Callable, Iterable

from ingest.can.summary import COUNTED, MessageCount
from ingest.source_fault import Fault

_REPORT_EVERY_S, _LOOK_EVERY_S = 10.0, 1.0
_MOST = 8  # messages that one report names
_REPORTED = ("lost", "repeated", "restarts", "strays", "checksum_failures", "late")


class FrameReports:
    """Reports new losses of each message: at once, and then at most every 10 s.

    >>> counts = [MessageCount("IMU", "FOG-1", 0x101, frames=900, lost=3)]
    >>> reports = FrameReports(lambda: counts, print)
    >>> reports.update()
    unit FOG-1, message IMU: 3 frames lost, 900 received so far
    >>> counts[0].lost = 5
    >>> reports.update()
    >>> reports.update(at_once=True)
    unit FOG-1, message IMU: 2 frames lost, 900 received so far
    """

    def __init__(
        self, counts: Callable[[], Iterable[MessageCount]], report: Callable[[str], None], mapping: str = "its mapping"
    ) -> None:
        self._counts, self._report, self._mapping = counts, report, mapping
        self._reported: dict[tuple[str, str, int], tuple[int, ...]] = {}
        self._reported_s = self._looked_s = float("-inf")
        self.faults: dict[tuple[str, Fault], str] = {}  # of units, as of the last look

    def update(self, *, at_once: bool = False) -> None:
        """Report what is new since the last report, if that is long enough ago."""
        now_s = time.monotonic()
        if not at_once and now_s - self._looked_s < _LOOK_EVERY_S:
            return
        self._looked_s = now_s
        counts = list(self._counts())
        self.faults = {
            (each.unit, Fault.INTERVAL): each.seen.warning(f"unit {each.unit}, message {each.message}", self._mapping)
            for each in counts
            if each.seen is not None and each.seen.is_wrong
        }
        if not at_once and now_s - self._reported_s < _REPORT_EVERY_S:
            return
        sentences = []
        for count in counts:
            key = count.unit, count.message, count.arbitration_id
            now = tuple(getattr(count, name) for name in _REPORTED)
            before = self._reported.get(key, (0,) * len(now))
            if now == before:
                continue
            self._reported[key] = now
            what = ", ".join(
                f"{more} {COUNTED[name] if name != 'lost' else 'frames lost'}"
                for name, more in ((name, new - old) for name, new, old in zip(_REPORTED, now, before, strict=True))
                if more
            )
            sentences.append(f"unit {count.unit}, message {count.message}: {what}, {count.frames} received so far")
        if sentences:
            self._reported_s = now_s
            for sentence in sentences[:_MOST]:
                self._report(sentence)
            if len(sentences) > _MOST:
                self._report(f"{len(sentences) - _MOST} more messages have lost frames or restarted counters")
