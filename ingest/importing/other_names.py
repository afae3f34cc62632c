"""Signals of a file whose samples the store has under another name of the same unit and run."""

from collections.abc import Sequence

import numpy as np

from ingest.tables.sample_file import SampleFile, SignalChunk, SignalSummary
from storage.recording.knowledge import Knowledge, KnownSignal

_FEWEST = 10  # samples: fewer may be alike by chance
_Name = tuple[str, str, str]


def other_names(
    knowledge: Knowledge, stored: Sequence[KnownSignal], summaries: Sequence[SignalSummary], file: SampleFile
) -> list[str]:
    """Warnings on signals that the store has not under their name, but under another that the file has not.

    As of a column that an earlier import had named otherwise. All stored samples must be in the file, at the same times
    with the same values; where all of them are alike, the names must be, but for capital letters and marks.
    """
    own = {(each.unit, each.run, each.signal) for each in summaries}
    known = {(each.unit, each.run, each.signal) for each in stored}
    pairs = {
        (_name(new), old.signal): _Compared(old)
        for new in summaries
        if _name(new) not in known
        for old in stored
        if _name(old) not in own and _may_be(new, old)
    }
    if not pairs:
        return []
    for chunk in file.chunks():
        for (name, _), compared in pairs.items():
            if name == (chunk.unit, chunk.run, chunk.signal):
                compared.follow(knowledge, chunk)
    return [
        f"warning: unit {unit}, run {run}: the store has the samples of {signal} as {other} already, perhaps as an "
        "earlier import named the column so: they are in it under both names now"
        for ((unit, run, signal), other), compared in pairs.items()
        if compared.is_same(signal)
    ]


class _Compared:
    """A stored signal, and whether all of it is in the chunks so far."""

    def __init__(self, stored: KnownSignal) -> None:
        self._stored = stored
        self._found, self._differs, self._moves = 0, False, False
        self._first: float | None = None

    def follow(self, knowledge: Knowledge, chunk: SignalChunk) -> None:
        if self._differs:
            return
        stored, times_ns = self._stored, chunk.times_ns
        at_ns, values = knowledge.samples(stored.unit, stored.signal, stored.run, int(times_ns[0]), int(times_ns[-1]))
        if not len(at_ns):
            return
        at = np.minimum(np.searchsorted(times_ns, at_ns), len(times_ns) - 1)
        self._differs = bool((times_ns[at] != at_ns).any() or (chunk.data[at] != values).any())
        self._found += len(at_ns)
        self._first = float(values[0]) if self._first is None else self._first
        self._moves = self._moves or bool((values != self._first).any())

    def is_same(self, signal: str) -> bool:
        """Whether all stored samples were found, and are of the `signal` of the file."""
        is_whole = not self._differs and self._found >= max(_FEWEST, self._stored.samples)
        return is_whole and (self._moves or _letters(signal) == _letters(self._stored.signal))


def _name(signal: SignalSummary | KnownSignal) -> _Name:
    return signal.unit, signal.run, signal.signal


def _may_be(new: SignalSummary, old: KnownSignal) -> bool:
    sampling = new.sampling
    return (
        (new.unit, new.run, new.unit_of_measure) == (old.unit, old.run, old.unit_of_measure)
        and sampling.t_first_ns == old.t_first_ns
        and old.t_last_ns <= sampling.t_last_ns
        and old.samples <= sampling.samples
    )


def _letters(name: str) -> str:
    return "".join(each for each in name.casefold() if each.isalnum())
