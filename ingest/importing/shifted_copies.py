"""Samples of a file that the store has at other times of the same run, as of an import with another start or zone."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from ingest.tables.sample_file import SampleFile, SignalChunk
from storage.recording.knowledge import Knowledge, KnownSignal
from stream.batch import CountArray, FloatArray, IntArray

_COMPARED = 10_000  # values of a signal
_FEWEST, _FEWEST_CHANGES = 30, 20  # of values in a row: fewer may be alike by chance
_MOST_SEARCHED = 1_000_000  # stored samples
_MOST_PLACES = 1000
_MOST_FOUND = 2  # places: values that stand at more are periodic

_Name = tuple[str, str, str]


class Shift(NamedTuple):
    """So many values in a row of a file are stored, `earlier_ns` before their times in the file."""

    signal: str
    values: int
    earlier_ns: int

    def __str__(self) -> str:
        size_s = abs(self.earlier_ns) / 1e9
        size = f"{size_s / 3600:g} h" if size_s % 900 == 0 else f"{size_s:.9g} s"
        side = "earlier" if self.earlier_ns > 0 else "later"
        return f"the same {self.values:,} values of {self.signal} {size} {side}"


def shift_of(knowledge: Knowledge, stored: KnownSignal, chunk: SignalChunk) -> Shift | None:
    """Where the values of a chunk are stored at other times, the first of them; None if nowhere, or all over."""
    values, times_ns = chunk.data[:_COMPARED], chunk.times_ns[:_COMPARED]
    if len(values) < _FEWEST or np.count_nonzero(values[1:] != values[:-1]) < _FEWEST_CHANGES:
        return None
    share = min(1.0, _MOST_SEARCHED / stored.samples)
    until_ns = stored.t_first_ns + int(share * (stored.t_last_ns - stored.t_first_ns))
    at_ns, held = knowledge.samples(stored.unit, stored.signal, stored.run, stored.t_first_ns, until_ns)
    distinct, first, counts = np.unique(values, return_index=True, return_counts=True)
    rarest = int(np.argmin(counts))
    places = np.flatnonzero(held == distinct[rarest])[:_MOST_PLACES] - first[rarest]
    found = [
        Shift(stored.signal, matched, earlier_ns)
        for place in places.tolist()
        for matched, earlier_ns in [_match(values, times_ns, held, at_ns, place)]
        if matched and earlier_ns
    ]
    return found[0] if 1 <= len(found) <= _MOST_FOUND else None


def shift_of_all(knowledge: Knowledge, wanted: Mapping[_Name, KnownSignal], file: SampleFile) -> Shift | None:
    """The shift that all signals have, by the first values of each; None if one has none."""
    found: dict[_Name, Shift] = {}
    seen: set[_Name] = set()
    for chunk in _wanted(file.chunks(), set(wanted)):
        name = (chunk.unit, chunk.run, chunk.signal)
        if name in seen:
            continue
        seen.add(name)
        shift = shift_of(knowledge, wanted[name], chunk)
        if shift is None:
            return None
        found[name] = shift
        if len(found) == len(wanted):
            break
    shifts = list(found.values())
    return shifts[0] if shifts and len({each.earlier_ns for each in shifts}) == 1 else None


def _wanted(chunks: Iterable[SignalChunk], names: set[_Name]) -> Iterable[SignalChunk]:
    return (each for each in chunks if (each.unit, each.run, each.signal) in names)


def _match(
    values: FloatArray | CountArray, times_ns: IntArray, held: FloatArray, at_ns: IntArray, place: int
) -> tuple[int, int]:
    """How many values in a row are stored from a place on, and how much earlier; 0 unless all in both are alike."""
    begin, end = max(0, -place), min(len(values), len(held) - place)
    if end - begin < max(_FEWEST, min(len(values), len(held)) // 2):
        return 0, 0
    if not np.array_equal(values[begin:end], held[place + begin : place + end]):
        return 0, 0
    earlier_ns = times_ns[begin:end] - at_ns[place + begin : place + end]
    is_shifted = int(np.ptp(earlier_ns)) * (end - begin) < int(times_ns[end - 1] - times_ns[begin])
    return (end - begin, int(np.median(earlier_ns))) if is_shifted else (0, 0)
