"""Stores with tested units: runs that are written sample by sample, and records of steps as they are kept."""

import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from uuid import uuid4

import pyarrow as pa
import pytest

from analytics.evaluation.evaluation import define_views, evaluate
from analytics.loop.bilingual import chinese
from analytics.loop.blocks.block_reducer import BlockReducer, Reduction
from analytics.loop.blocks.notes.reduction_notes import Note
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.tracing.verdict.conclusion import conclude
from analytics.metric_registry.registry import metrics
from analytics.step_records.step_table import step_means
from storage.lake.builder import build_missing, builder_lock
from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.segments.records import EVENTS, SAMPLES, LogRecord
from storage.specifications.chain import hash_of
from storage.sql.catalog import Catalog
from storage.store import Store, WriterLock
from stream.batch import FloatArray, SampleBatch
from stream.events import (
    AnyDocument,
    PowerOn,
    RunStarted,
    SpecificationAction,
    SpecificationEntered,
    StepEnded,
    StepStarted,
    StepWords,
    UnitMounted,
    encode_event,
)
from stream.identity import Place, event_key, sample_key
from stream.wire.batches import encode_batch

PLACE = Place("plant", "station-1")
START_NS = 1_763_683_200 * 10**9  # 2025-11-21 00:00 UTC
SECOND_NS = 10**9


class TestedUnits:
    """A store that is filled with runs; the time of each unit's signals goes on from step to step."""

    __test__ = False

    def __init__(self, folder: Path) -> None:
        self.store = Store.create(folder)
        self._lock = WriterLock(self.store, "test")
        self._log = EventLog(self.store)
        self._documents = 0
        self._specifications: list[SpecificationEntered] = []

    def run(
        self,
        run: str,
        *,
        t_ns: int = START_NS,
        procedure: str | None = None,
        time_zone: str = "UTC",
        latitude_deg: float | None = 40.0,
        date_known: bool = True,
    ) -> None:
        """A run begins."""
        details = {"time_zone": time_zone}
        if latitude_deg is not None:
            details["latitude_deg"] = str(latitude_deg)
        self.document(RunStarted(run=run, t_ns=t_ns, procedure=procedure, details=details, date_known=date_known))

    def mount(self, run: str, unit: str, *, t_ns: int = START_NS, **words: Any) -> None:
        self.document(UnitMounted(run=run, t_ns=t_ns, unit=unit, **words))

    def power_on(self, run: str, unit: str, t_ns: int) -> str:
        """A unit is powered on; the epoch."""
        epoch = str(uuid4())
        self.document(PowerOn(run=run, t_ns=t_ns, unit=unit, epoch=epoch))
        return epoch

    def samples(
        self,
        run: str,
        unit: str,
        signal: str,
        values: FloatArray,
        *,
        t0_ns: int,
        dt_ns: int = 10**8,
        unit_of_measure: str = "deg/h",
    ) -> None:
        """Samples of a stretch; each call is an epoch of its own."""
        batch = SampleBatch(unit, signal, run, uuid4(), 0, t0_ns, dt_ns, unit_of_measure, values=values)
        key = sample_key(PLACE, unit, signal)
        self._append(LogRecord(key, SAMPLES, batch.last_ns + 10**6, t0_ns, encode_batch(batch)))

    def step(
        self,
        run: str,
        unit: str,
        values: FloatArray | Mapping[str, tuple[FloatArray, str]],
        *,
        t0_ns: int,
        dt_ns: int = 10**8,
        unit_of_measure: str = "deg/h",
        outcome: str = "completed",
        **words: Any,
    ) -> int:
        """A step of a unit with the samples of its signals (values and unit of measure; `rate` if one array is given).

        Returns
        -------
        int
            Its end, where the next one can begin, ns.
        """
        signals = values if isinstance(values, Mapping) else {"rate": (values, unit_of_measure)}
        longest = max(len(each) for each, _ in signals.values())
        end_ns = t0_ns + longest * dt_ns
        begun = StepStarted(run=run, t_ns=t0_ns, unit=unit, words=StepWords(**words))
        self.document(begun)
        for signal, (each, measure) in signals.items():
            interval_ns = longest * dt_ns // len(each)
            self.samples(run, unit, signal, each, t0_ns=t0_ns, dt_ns=interval_ns, unit_of_measure=measure)
        self.document(StepEnded(run=run, t_ns=end_ns - dt_ns, unit=unit, step_uid=begun.uid, outcome=outcome))
        return end_ns

    def document(self, document: AnyDocument) -> None:
        payload = encode_event(document, "e", self._documents)
        self._documents += 1
        self._append(LogRecord(event_key(PLACE), EVENTS, document.t_ns, document.t_ns, payload))

    def product(self, text: str) -> None:
        """Put a specification into the log, in place of the one before it; all runs are judged by it."""
        revision = str(len(self._specifications) + 1)
        if self._specifications:
            self._specify(SpecificationAction.WITHDRAWN, self._specifications[-1].revision)
        self._specify(SpecificationAction.ADDED, revision, re.sub("^revision *=.*", "", text, flags=re.MULTILINE))

    def _specify(self, action: SpecificationAction, revision: str, text: str = "") -> None:
        before = self._specifications[-1] if self._specifications else None
        document = SpecificationEntered(
            run="", t_ns=START_NS, action=action, name="specification", revision=revision, by="Li", rejudges=True,
            content=text and f'revision = "{revision}"\n{text}', previous="" if before is None else hash_of(before),
        )  # fmt: skip
        self._specifications.append(document)
        self.document(document)

    def catalog(self) -> Catalog:
        """What has been written so far."""
        self._log.seal()
        with builder_lock(self.store):
            list(build_missing(self.store, compacts=False))
        return Catalog(self.store)

    def metric(self, name: str) -> list[dict[str, Any]]:
        """Rows of one metric over what has been written, its parameters among the columns."""
        return self.metrics(name)[name]

    def metrics(self, *names: str) -> dict[str, list[dict[str, Any]]]:
        """The same of several metrics, whose common tables are made once."""
        with self.catalog() as catalog:
            return _evaluated(catalog, step_means(catalog), names)

    def release(self) -> None:
        self._log.abandon()
        self._lock.close()

    def _append(self, record: LogRecord) -> None:
        place = place_of(record)
        assert place is not None
        self._log.append(place, record)


def _evaluated(catalog: Catalog, steps: pa.Table, names: Sequence[str]) -> dict[str, list[dict[str, Any]]]:
    """Rows of metrics from records of steps, their parameters among the columns; the other metrics are left out."""
    catalog._unfilled.clear()  # else it would fill itself with all of them
    define_views(catalog, steps)
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    for row in evaluate(catalog, [metrics()[name] for name in names]).to_pylist():
        parameters = json.loads(row["parameters"] or "{}")
        unknown = set(parameters) - set(metrics()[row["metric"]].header.parameters)
        assert not unknown, f"parameters that are not in the header of {row['metric']}: {unknown}"
        found[row["metric"]].append(parameters | row)
    return found


@pytest.fixture
def tested(tmp_path: Path) -> Iterator[TestedUnits]:
    """A store to be filled with runs."""
    made = TestedUnits(tmp_path / "store")
    yield made
    made.release()


Recorded = Callable[[Sequence[Mapping[str, Any]], str], list[dict[str, Any]]]


@pytest.fixture
def recorded(tmp_path: Path) -> Recorded:
    """A metric's rows from records of steps that a test makes up: what is not said of them is as of a plain static
    step of unit U1 in run r1, its samples in deg/h."""

    def run(rows: Sequence[Mapping[str, Any]], metric: str) -> list[dict[str, Any]]:
        folder = tmp_path / "records"
        store = Store.open(folder) if folder.exists() else Store.create(folder)
        with Catalog(store) as catalog:
            schema = step_means(catalog).schema
            plain = {
                "run": "r1", "unit": "U1", "signal": "rate", "date_known": True, "time_zone": "UTC", "room": False,
                "latitude_deg": 40.0, "unit_of_measure": "deg/h", "n": 36_000, "duration_s": 3600.0, "freedom": 30.0,
                "standard_uncertainty": 0.01, "n_effective": 1000.0,
            }  # fmt: skip
            reported: list[dict[str, Any]] = [
                {"index": i + 1, "t_start_ns": START_NS + i * 7200 * SECOND_NS} | plain | dict(row)
                for i, row in enumerate(rows)
            ]
            for each in reported:
                each.setdefault("t_from_ns", each["t_start_ns"])
                each.setdefault("t_to_ns", each["t_from_ns"] + round(each["duration_s"] * 1e9))
            return _evaluated(catalog, pa.Table.from_pylist(reported, schema=schema), [metric])[metric]

    return run


def reduced(tested: TestedUnits, unit: str = "U1", signal: str = "rate", **options: Any) -> Reduction:
    """The runs of a unit as blocks, with what is said of them."""
    with tested.catalog() as catalog:
        return BlockReducer(catalog, signal, **options).reduce(unit)


@pytest.fixture(autouse=True)
def every_caveat_note_and_reason_has_chinese(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever caveat, note or reason comes up in any test has its Chinese form."""

    def check(texts: Iterable[str]) -> None:
        for text in texts:
            assert re.search("[\u4e00-\u9fff]", chinese(text)), f"no Chinese form of: {text}"

    original = Note.__init__

    def concluded(*arguments: Any, **options: Any) -> Diagnosis:
        found = conclude(*arguments, **options)
        check([*found.limits, *found.missing, *found.not_tested.values()])
        return found

    def note(self: Note, *arguments: Any, **options: Any) -> None:
        original(self, *arguments, **options)
        if sys._getframe(1).f_globals["__name__"].startswith("analytics."):
            check([self.text])

    monkeypatch.setattr("analytics.loop.tracing.diagnosis.conclude", concluded)
    monkeypatch.setattr(Note, "__init__", note)
