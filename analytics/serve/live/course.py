"""Documents of runs that only the log has so far: what was commanded, noted, limited, and how they began and ended."""

import threading
import time
from collections import defaultdict
from collections.abc import Collection
from typing import NamedTuple

from stream.events import (
    AnyDocument,
    LimitsApplied,
    NoteAdded,
    RunCommandAnswered,
    RunCommandGiven,
    RunEnded,
    RunResumed,
    RunStarted,
    StepEnded,
    StepStarted,
)
from stream.identity import Place

OfCourse = (
    RunStarted | RunResumed | RunEnded | StepStarted | StepEnded | LimitsApplied | NoteAdded | RunCommandGiven
    | RunCommandAnswered
)  # fmt: skip
# a request may still look at the version of the lake before
_KEPT_S = 15.0
_OWN, _OWN_S = "", 30.0
_HERE = Place("local", "entered")


class Received(NamedTuple):
    """A document, and when and where it came to the log."""

    arrival_ns: int
    place: Place
    document: OfCourse


class LiveCourse:
    """Keeps documents of runs until the lake has them; for several threads."""

    def __init__(self) -> None:
        self._received: dict[str, list[tuple[str, Received]]] = defaultdict(list)
        self._in_lake: dict[str, float] = {}  # segments, and since when
        self._lock = threading.Lock()

    def take(self, segment: str, place: Place, document: AnyDocument, arrival_ns: int) -> None:
        """Keep a document, if it is one of a run's course."""
        if isinstance(document, OfCourse) and document.run:
            with self._lock:
                self._received[document.run].append((segment, Received(arrival_ns, place, document)))

    def add_own(self, document: OfCourse) -> None:
        """Keep a document that this server knows of for as long as the log may take to have it."""
        with self._lock:
            now_ns = time.time_ns()
            self._received[document.run].append((_OWN, Received(now_ns, _HERE, document)))

    def received(self, run: str, in_lake: Collection[str]) -> list[Received]:
        """Documents of a run that segments in the lake do not have, in their order."""
        with self._lock:
            return [each for segment, each in self._received.get(run, ()) if segment not in in_lake]

    def forget(self, in_lake: Collection[str]) -> None:
        """Leave out what has been in the lake for some seconds."""
        now_s = time.monotonic()
        with self._lock:
            segments = {segment for received in self._received.values() for segment, _ in received}
            self._in_lake = {each: self._in_lake.get(each, now_s) for each in segments if each in in_lake}
            gone = {each for each, since_s in self._in_lake.items() if now_s - since_s > _KEPT_S}
            oldest_ns = time.time_ns() - round(_OWN_S * 1e9)
            for run in list(self._received):
                kept = [
                    (segment, each)
                    for segment, each in self._received[run]
                    if (each.arrival_ns > oldest_ns if segment == _OWN else segment not in gone)
                ]
                if kept:
                    self._received[run] = kept
                else:
                    del self._received[run]
