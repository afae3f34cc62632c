"""Unfinished runs of a log, and where each run begins in every stream."""

from storage.log.sequence import LogPlace
from storage.manifests.log import read_log_manifest
from storage.segments.records import LogRecord
from storage.store import Store
from stream.delivery.publisher import StreamId
from stream.events import SpectralLinesFound, decode_event
from stream.identity import EstimateKey, SampleKey, parse_key


def first_to_read(store: Store, sealed: list[str]) -> int:
    """Index of the first sealed segment that may hold an unfinished run; the number of segments if none may.

    The last estimates of a run may be in the segment after its end; anything later resumes the run.
    """
    entries = read_log_manifest(store).entries
    first: dict[str, int] = {}
    ended: dict[str, int] = {}
    unlisted = len(sealed)
    for number, name in enumerate(sealed):
        entry = entries.get(name)
        if entry is None:
            unlisted = min(unlisted, number)
            continue
        for run in entry.runs:
            first.setdefault(run, number)
            if number > ended.get(run, number) + 1:
                del ended[run]
        ended.update((run, number) for run in entry.ended)
    return min([unlisted, *(number for run, number in first.items() if run not in ended)])


class RunScan:
    """Reads a log in its order and keeps where runs begin and whether they have ended.

    `open_runs` have samples or documents other than estimates after their last end.
    """

    def __init__(self) -> None:
        self.runs: set[str] = set()
        self.open_runs: set[str] = set()
        self._first: dict[tuple[StreamId, str], int] = {}
        self._next: dict[StreamId, int] = {}
        self._signals: set[tuple[str, str, str]] = set()
        self._estimated: set[tuple[str, str, str]] = set()
        self._finished: set[tuple[str, str, str]] = set()

    def follow(self, record: LogRecord, place: LogPlace | None) -> None:
        """Take the next message."""
        if place is None:
            return
        stream, run = place.stream, place.run
        self._next[stream] = max(place.next_seq, self._next.get(stream, 0))
        if not run:
            return
        self.runs.add(run)
        self._first.setdefault((stream, run), place.seq)
        key = parse_key(stream.key)
        if isinstance(key, EstimateKey):
            name = (run, key.unit, key.signal)
            self._estimated.add(name)
            if isinstance(decode_event(record.data).document, SpectralLinesFound):
                self._finished.add(name)
            return
        if isinstance(key, SampleKey):
            self._signals.add((run, key.unit, key.signal))
        if place.is_end:
            self.open_runs.discard(run)
        else:
            self.open_runs.add(run)

    @property
    def unfinished_runs(self) -> set[str]:
        """Estimated runs of which a signal lacks its final document."""
        estimated = {run for run, _, _ in self._estimated}
        return {name[0] for name in self._signals - self._finished if name[0] in estimated}

    def positions(self, runs: set[str]) -> dict[StreamId, int]:
        """Position of the first message of any of `runs` in each stream, else the end of the stream."""
        found = dict(self._next)
        for (stream, run), first in self._first.items():
            if run in runs:
                found[stream] = min(found[stream], first)
        return found
