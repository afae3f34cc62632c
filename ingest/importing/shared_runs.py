"""Runs that a file would share with tests of other units or other days, which the store has under the same name."""

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple
from zoneinfo import ZoneInfo

from ingest.tables.sample_file import SignalSummary, TableSummary
from storage.recording.knowledge import KnownSignal
from stream.errors import BadInput

_APART_NS = 86_400 * 10**9  # between samples that no test joins
_BETWEEN_NS = 6 * 3600 * 10**9  # between samples of a unit that are hardly of one test
_LISTED = 3

Span = tuple[int, int]


class OtherTests(NamedTuple):
    """What a run has beside the file: spans of other units, and of the same units on other days, nanoseconds."""

    spans: Mapping[str, Span]
    are_apart: bool  # all that is stored of the run, by more than a day
    is_dated: bool

    def text(self, zone: str | None) -> str:
        """The units, with the days in a time zone."""
        names = [f"unit {unit}{self._days(span, zone)}" for unit, span in sorted(self.spans.items())]
        more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
        return ", ".join(names[:_LISTED]) + more

    def _days(self, span: Span, zone: str | None) -> str:
        if not self.is_dated:
            return ""
        place = ZoneInfo(zone) if zone else UTC
        first, last = (datetime.fromtimestamp(each // 10**9, place).date() for each in span)
        return f" of {first}" if first == last else f" of {first} to {last}"


def other_tests(stored: Iterable[KnownSignal], own: Iterable[SignalSummary], *, is_dated: bool) -> OtherTests:
    """What is stored of a run, beside the samples that a file has of it."""
    mine = _spans((each.unit, each.sampling.t_first_ns, each.sampling.t_last_ns) for each in own)
    spans = _spans((each.unit, each.t_first_ns, each.t_last_ns) for each in stored)
    file_span = min(first for first, _ in mine.values()), max(last for _, last in mine.values())
    far = {unit for unit, span in spans.items() if is_dated and are_apart(span, file_span)}
    again = {
        unit for unit, span in mine.items() if is_dated and unit in spans and gap_ns(span, spans[unit]) > _BETWEEN_NS
    }
    others = {unit: span for unit, span in spans.items() if unit not in mine or unit in far | again}
    return OtherTests(others, bool(spans) and len(far) == len(spans), is_dated)


def are_apart(one: Span, other: Span) -> bool:
    """Whether more than a day lies between two spans."""
    return gap_ns(one, other) > _APART_NS


def gap_ns(one: Span, other: Span) -> int:
    """Time between two spans, below 0 where they overlap."""
    return max(one[0] - other[1], other[0] - one[1])


def refuse_shared(path: Path, run: str, others: str) -> BadInput:
    """The error for a run that is named after the file, and is of another day."""
    return BadInput(
        f"{path}: run {run}, named after the file, has {others}, more than a day apart: one run is one test. Import "
        f"the file as a run of its own with --run NAME, or say that it belongs to that one with --run {run}"
    )


def warning_of_shared(run: str, others: OtherTests, summary: TableSummary, zone: str | None) -> str | None:
    """A warning that a run named after the file has other units as well; None where it has none."""
    if not summary.is_run_by_name or not others.spans:
        return None
    return (
        f"warning: run {run}, named after the file, has {others.text(zone)} already: both are one run now, with one "
        "station, whose corrections change the values of both, and one of a repeatability; a test of its own has its "
        "own --run NAME"
    )


def warning_of_excluded(run: str, excluded: Mapping[str, str]) -> str:
    """A warning that units of a file are excluded from evaluation in its run, and why."""
    listed = [f"unit {unit} ({why})" for unit, why in excluded.items()]
    named = ", ".join(listed[:_LISTED]) + (f" and {len(listed) - _LISTED} more" if len(listed) > _LISTED else "")
    return (
        f"warning: run {run} is excluded from evaluation for {named}: what the file adds does not count either; "
        f"`gyrofleet runs include {run}` takes it in again"
    )


def _spans(parts: Iterable[tuple[str, int, int]]) -> dict[str, Span]:
    found: dict[str, Span] = {}
    for unit, first_ns, last_ns in parts:
        begin, end = found.get(unit, (first_ns, last_ns))
        found[unit] = min(begin, first_ns), max(end, last_ns)
    return found
