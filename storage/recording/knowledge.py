"""What a store knows of runs that are to be extended, from its lake or from a remote recorder."""

import json
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from storage.manifests.lake import read_manifest
from storage.store import Store
from stream.batch import FloatArray, IntArray
from stream.decoding import decode_json
from stream.events import UnitMounted
from stream.identity import UNSTATED

if TYPE_CHECKING:
    from storage.sql.catalog import Catalog

_RUNS_AT_ONCE = 200


class KnownSignal(NamedTuple):
    """One signal of one run in the lake."""

    unit: str
    run: str
    signal: str
    unit_of_measure: str
    t_first_ns: int
    t_last_ns: int
    samples: int


class KnownStep(NamedTuple):
    """One step of a unit in a run, its words as JSON; `t_end_ns` is its start while it is open."""

    unit: str
    run: str
    uid: str
    words: str
    t_start_ns: int
    t_end_ns: int


class KnownRuns(NamedTuple):
    """What is known of some runs.

    `dated` says of each stored run whether its date is known; `open` are runs without an end, `uids` documents of the
    starts of runs and steps, `mounted` documents of mounted units, as JSON, and `stated` statements about the station
    of each run, at its start and later; `excluded` is run, unit, and why it is excluded from evaluation.
    """

    dated: dict[str, bool]
    open: list[str]
    uids: list[str]
    mounted: list[str]
    stated: dict[str, dict[str, str]]
    steps: list[KnownStep]
    excluded: tuple[tuple[str, str, str], ...] = ()


class Knowledge(Protocol):
    """Answers about runs."""

    def signals(self, runs: list[str]) -> list[KnownSignal]:
        """The signals of these runs."""

    def runs(self, runs: list[str]) -> KnownRuns:
        """What is known of these runs."""

    def samples(self, unit: str, signal: str, run: str, first_ns: int, last_ns: int) -> tuple[IntArray, FloatArray]:
        """Times (ns, ascending) and values between two times, inclusive."""


class CatalogKnowledge:
    """Answers from a local lake."""

    def __init__(self, catalog: "Catalog") -> None:
        self._catalog = catalog

    def signals(self, runs: list[str]) -> list[KnownSignal]:
        """As of `Knowledge`."""
        sql = "select unit, run, signal, unit_of_measure, t_first_ns, t_last_ns, samples from signals where"
        return [KnownSignal(*row) for row in self._of_runs(runs, sql)]

    def runs(self, runs: list[str]) -> KnownRuns:
        """As of `Knowledge`."""
        of_runs = partial(self._of_runs, runs)
        found = of_runs("select run, date_known, outcome = 'open' from runs where")
        known = of_runs("select uid from events where (kind like 'Step%' or kind = 'RunStarted') and")
        mounted = of_runs("select document from events join units using (run, unit, uid) where")
        stated = of_runs(
            "select run, kind, site, station, document->>'$.details' from internal.lake_documents "
            "where kind in ('RunStarted', 'StationStated') and",
            "order by run, case kind when 'RunStarted' then -arrival_ns else arrival_ns end",
        )
        steps = of_runs(
            "select unit, run, uid, words::varchar, t_start_ns, coalesce(t_end_ns, t_start_ns) "
            "from internal.lake_steps where"
        )
        excluded = of_runs("select run, unit, reason from exclusions where", "order by run, unit")
        details: dict[str, dict[str, str]] = {}
        for run, kind, site, station, text in stated:
            began = zip(("site", "station"), (site, station), UNSTATED, strict=True)
            began_at = {name: given for name, given, default in began if kind == "RunStarted" and given != default}
            details.setdefault(str(run), {}).update(began_at | json.loads(text or "{}"))
        return KnownRuns(
            dated={str(run): bool(is_dated) for run, is_dated, _ in found},
            open=[str(run) for run, _, is_open in found if is_open], uids=[str(uid) for (uid,) in known],
            mounted=[str(document) for (document,) in mounted], stated=details,
            steps=[KnownStep(*row) for row in steps],
            excluded=tuple((str(run), str(unit), str(reason)) for run, unit, reason in excluded),
        )  # fmt: skip

    def samples(self, unit: str, signal: str, run: str, first_ns: int, last_ns: int) -> tuple[IntArray, FloatArray]:
        """As of `Knowledge`."""
        from storage.sql.reading import stored_between

        return stored_between(self._catalog, unit, signal, run, first_ns, last_ns)

    def _of_runs(self, runs: list[str], sql: str, order: str = "") -> list[tuple[Any, ...]]:
        return self._catalog.rows(f"{sql} run in (select unnest($runs)) {order}", {"runs": runs})


class NothingKnown:
    """Answers from a store without anything in its lake."""

    def signals(self, runs: list[str]) -> list[KnownSignal]:
        """As of `Knowledge`."""
        del runs
        return []

    def runs(self, runs: list[str]) -> KnownRuns:
        """As of `Knowledge`."""
        del runs
        return KnownRuns(dated={}, open=[], uids=[], mounted=[], stated={}, steps=[])

    def samples(self, unit: str, signal: str, run: str, first_ns: int, last_ns: int) -> tuple[IntArray, FloatArray]:
        """As of `Knowledge`."""
        del unit, signal, run, first_ns, last_ns
        return np.empty(0, np.int64), np.empty(0)


@contextmanager
def lake_knowledge(store: Store) -> Iterator[Knowledge]:
    """What the lake of a store knows now; without parts it is not opened, which takes as long as a small import."""
    if not read_manifest(store).parts:
        yield NothingKnown()
        return
    from storage.sql.catalog import Catalog

    with Catalog(store) as catalog:
        yield CatalogKnowledge(catalog)


class AskedAhead:
    """The same answers with one question about many runs, where each takes tens of milliseconds.

    `coming` are the runs that will be asked about; nothing may change them in the store meanwhile. `uids` of an answer
    may have those of other runs as well.
    """

    def __init__(self, knowledge: Knowledge, coming: Iterable[str]) -> None:
        self._knowledge = knowledge
        self._coming = deque(coming)
        self._signals: dict[str, list[KnownSignal]] = {}
        self._runs: dict[str, KnownRuns] = {}

    def signals(self, runs: list[str]) -> list[KnownSignal]:
        """As of `Knowledge`."""
        self._ask(runs)
        return [signal for run in runs for signal in self._signals[run]]

    def runs(self, runs: list[str]) -> KnownRuns:
        """As of `Knowledge`."""
        self._ask(runs)
        found = [self._runs[run] for run in runs]
        return KnownRuns(
            dated={run: dated for each in found for run, dated in each.dated.items()},
            open=[run for each in found for run in each.open],
            uids=list(dict.fromkeys(uid for each in found for uid in each.uids)),
            mounted=[text for each in found for text in each.mounted],
            stated={run: details for each in found for run, details in each.stated.items()},
            steps=[step for each in found for step in each.steps],
            excluded=tuple(each for of_run in found for each in of_run.excluded),
        )

    def samples(self, unit: str, signal: str, run: str, first_ns: int, last_ns: int) -> tuple[IntArray, FloatArray]:
        """As of `Knowledge`, asked each time."""
        return self._knowledge.samples(unit, signal, run, first_ns, last_ns)

    def _ask(self, runs: list[str]) -> None:
        asked = {run: None for run in runs if run not in self._runs}
        if not asked:
            return
        while self._coming and len(asked) < _RUNS_AT_ONCE:
            if (run := self._coming.popleft()) not in self._runs:
                asked[run] = None
        found = self._knowledge.runs(list(asked))
        mounted: defaultdict[str, list[str]] = defaultdict(list)
        for text in found.mounted:
            mounted[decode_json(text, UnitMounted).run].append(text)
        steps: defaultdict[str, list[KnownStep]] = defaultdict(list)
        for step in found.steps:
            steps[step.run].append(step)
        signals: defaultdict[str, list[KnownSignal]] = defaultdict(list)
        for signal in self._knowledge.signals(list(asked)):
            signals[signal.run].append(signal)
        is_open = set(found.open)
        for run in asked:
            self._signals[run] = signals[run]
            self._runs[run] = KnownRuns(
                dated={run: found.dated[run]} if run in found.dated else {}, open=[run] if run in is_open else [],
                uids=found.uids, mounted=mounted[run],
                stated={run: found.stated[run]} if run in found.stated else {}, steps=steps[run],
                excluded=tuple(each for each in found.excluded if each[0] == run),
            )  # fmt: skip


def packed(times_ns: IntArray, values: FloatArray) -> list[bytes]:
    """Wire form of times and values."""
    return [times_ns.astype("<i8").tobytes(), np.asarray(values).astype("<f8").tobytes()]


def unpacked(times: bytes, values: bytes) -> tuple[IntArray, FloatArray]:
    """Times and values from their wire form.

    >>> times, values = unpacked(*packed(np.array([1, 2]), np.array([0.5, 1.5])))
    >>> times.tolist(), values.tolist()
    ([1, 2], [0.5, 1.5])
    """
    return np.frombuffer(times, "<i8").astype(np.int64), np.frombuffer(values, "<f8").astype(np.float64)
