"""Steps of a file beside those that a store has of the same unit and run: each sample counts in one step."""

from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple
from uuid import NAMESPACE_URL, uuid5

import msgspec

from ingest.tables.sample_file import TableSummary
from ingest.tables.steps import FileStep, word_texts
from storage.recording.knowledge import KnownRuns
from stream.decoding import decode_json
from stream.errors import BadInput
from stream.events import StepEnded, StepStarted, StepWords

_ADJOINING = 1.5  # sample intervals between two steps of the same words that are one
_NAMESPACE = uuid5(NAMESPACE_URL, "gyrofleet/import")
_Document = StepStarted | StepEnded


class _Span(NamedTuple):
    uid: str
    words: StepWords
    first_ns: int
    last_ns: int


class StoredSteps:
    """Which documents bring the steps of a file into the store.

    A step that overlaps stored ones of the same words, or adjoins them, is one step with them. Raises BadInput if one
    lies over a stored one with other words. `moment` writes a time.
    """

    def __init__(self, known: KnownRuns, path: Path, summary: TableSummary, moment: Callable[[int], str]) -> None:
        self._path, self._summary, self._moment = path, summary, moment
        self._known_uids = frozenset(known.uids)
        self._documents: dict[str, tuple[_Document | None, _Document | None]] = {}  # by step: at its start and its end
        steps: defaultdict[tuple[str, str], list[FileStep]] = defaultdict(list)
        for step in summary.steps:
            steps[step.started.unit, step.started.run].append(step)
        stored: defaultdict[tuple[str, str], list[_Span]] = defaultdict(list)
        for each in known.steps if steps else ():
            span = _Span(each.uid, decode_json(each.words, StepWords), each.t_start_ns, each.t_end_ns)
            stored[each.unit, each.run].append(span)
        self._refused: list[tuple[FileStep, _Span]] = []
        for owner, own in steps.items():
            self._compare(own, sorted(stored[owner], key=lambda span: span.first_ns))
        if self._refused:
            raise self._error(*self._refused[0])

    @property
    def added(self) -> int:
        """How many steps the store gets, or gets more of."""
        return sum(any(each) for each in self._documents.values())

    def at_start(self, started: StepStarted) -> _Document | None:
        """The document for the start of a step of the file; None if the store needs none."""
        return self._documents[started.uid][0]

    def at_end(self, ended: StepEnded) -> _Document | None:
        """The document for the end of a step of the file; None if the store needs none."""
        return self._documents[ended.step_uid][1]

    def _compare(self, steps: Sequence[FileStep], stored: Sequence[_Span]) -> None:
        coming, near = deque(stored), list[_Span]()
        for step in steps:
            own = _Span(step.started.uid, step.started.words, step.started.t_ns, step.ended.t_ns)
            gap_ns = self._gap_ns(step.started)
            while coming and coming[0].first_ns <= own.last_ns + gap_ns:
                near.append(coming.popleft())
            near = [each for each in near if each.last_ns >= own.first_ns - gap_ns]
            self._check(step, own, near)
            alike = [each for each in near if each.words == own.words]
            whole, started, ended = self._joined(step, own, alike)
            near = [whole, *(each for each in near if each not in alike)] if alike else near
            self._documents[own.uid] = started, ended

    def _gap_ns(self, started: StepStarted) -> int:
        """Up to how far apart two steps are one."""
        own = (each for each in self._summary.signals if (each.unit, each.run) == (started.unit, started.run))
        return int(_ADJOINING * min((each.sampling.dt_ns for each in own), default=0))

    def _joined(
        self, step: FileStep, own: _Span, alike: Sequence[_Span]
    ) -> tuple[_Span, _Document | None, _Document | None]:
        """The step with the stored ones of the same words, and the documents that make it so."""
        first_ns = min([own.first_ns, *(each.first_ns for each in alike)])
        last_ns = max([own.last_ns, *(each.last_ns for each in alike)])
        at_first = [each.uid for each in alike if each.first_ns == first_ns]
        uid = own.uid if own.uid in at_first or not at_first else at_first[0]
        replaced = tuple(sorted({each.uid for each in alike} - {uid}))
        whole = _Span(uid, own.words, first_ns, last_ns)
        started = None if at_first else step.started
        is_new_end = uid == own.uid and step.ended.uid not in self._known_uids
        if not is_new_end and not replaced and any(each.uid == uid and each.last_ns == last_ns for each in alike):
            return whole, started, None
        end_uid = step.ended.uid
        if not is_new_end:
            end_uid = uuid5(_NAMESPACE, "\0".join(["later end", uid, str(last_ns), *replaced])).hex
        ended = msgspec.structs.replace(step.ended, t_ns=last_ns, step_uid=uid, uid=end_uid, replaces=replaced)
        return whole, started, ended

    def _check(self, step: FileStep, own: _Span, near: Sequence[_Span]) -> None:
        if any(each.uid == own.uid and each.last_ns >= own.last_ns for each in near):
            return  # all of it is stored
        others = [
            each for each in near
            if each.words != own.words and each.first_ns <= own.last_ns and own.first_ns <= each.last_ns
        ]  # fmt: skip
        self._refused += [(step, each) for each in others[:1]]

    def _error(self, step: FileStep, other: _Span) -> BadInput:
        here, there = word_texts(step.started.words), word_texts(other.words)
        differs = [name for name in {**here, **there} if here.get(name) != there.get(name)]
        unit, run = step.started.unit, step.started.run
        first_ns, last_ns = max(step.started.t_ns, other.first_ns), min(step.ended.t_ns, other.last_ns)
        stored, given = (_listed(words, differs) for words in (there, here))
        which = f" in its step {here['step']}" if "step" in here and "step" not in differs else ""
        more = f" (and so on, in {len(self._refused)} of its {len(self._summary.steps)} steps)"
        return BadInput(
            f"{self._path}: unit {unit}, run {run} has a step there already, with {stored}; what is recorded stays: "
            f"from {self._moment(first_ns)} to {self._moment(last_ns)} the file has {given}{which}"
            f"{more if len(self._refused) > 1 else ''}, and each sample would count in both steps. "
            f"{self._ways_out(run, differs)}"
        )

    def _ways_out(self, run: str, differs: Sequence[str]) -> str:
        options = {} if self._summary.words is None else word_texts(self._summary.words)
        given = [name for name in differs if name in options]
        leave = f"Leave out {' and '.join(f'--{name}' for name in given)}; if the file is right," if given else (
            "If the file is right,"
        )  # fmt: skip
        return (
            f"{leave} leave the stored run out of what is computed (`gyrofleet runs exclude {run} --reason ...`) and "
            "import the file under another --run"
        )


def _listed(words: dict[str, str], names: Sequence[str]) -> str:
    return ", ".join(f"{name} {words.get(name, '(not given)')}" for name in names)
