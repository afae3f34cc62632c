"""The floor: runs at work, and each unit's step, last sample, estimates, decisions and verdict, from the log."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import lru_cache

from storage.log.follower import ContinuedBatch, FollowedMessage
from stream.errors import GyrofleetError
from stream.events import (
    AnyDocument,
    Check,
    EarlyDecision,
    EstimatePublished,
    Limit,
    LimitsApplied,
    PowerOff,
    PowerOn,
    RunEnded,
    RunResumed,
    RunStarted,
    StationStated,
    StepEnded,
    StepStarted,
    StepWords,
    UnitMounted,
    UnitReleased,
    Verdict,
    VerdictGiven,
)
from stream.identity import Place, SampleKey, parse_key
from stream.wire.batches import RawBatch
from stream.worker.limit_checks import estimator_key, judge

SILENT_AFTER_NS = 10 * 10**9
OfUnit = (
    UnitMounted | StepStarted | StepEnded | PowerOn | PowerOff | UnitReleased | EstimatePublished | EarlyDecision
    | VerdictGiven
)  # fmt: skip
OfRun = OfUnit | RunEnded | StationStated | LimitsApplied
_DECIDED = (Verdict.PASS, Verdict.FAIL)
parsed_key = lru_cache(100_000)(parse_key)


@dataclass(slots=True)
class RunNow:
    """A run on the floor; limits of the whole run are under the unit None."""

    run: str
    place: Place
    procedure: str | None = None
    operator: str | None = None
    lot: str | None = None
    started_ns: int | None = None
    date_known: bool = True
    arrival_ns: int = 0
    outcome: str = "open"
    resumptions: int = 0
    planned_s: float | None = None
    since_ns: int | None = None
    time_zone: str | None = None  # IANA name
    is_imported: bool = False  # from a file, perhaps long after it was measured
    temperature_command_deg_c: float | None = None  # of the step at work
    limits: dict[str | None, tuple[Limit, ...]] = field(default_factory=dict)
    tested: frozenset[str] = frozenset()  # empty where the run does not name its units


@dataclass(slots=True)
class UnitNow:
    """A unit on the floor; `number` is its own as long as the process lives, times are of its last sample."""

    number: int
    unit: str
    run: RunNow
    slot: str | None = None
    product: str | None = None
    step: str = ""
    arrival_ns: int = 0
    t_ns: int | None = None
    is_silent: bool = False
    is_off: bool = False
    released: UnitReleased | None = None
    verdict: str = ""
    checks: dict[Limit, Check] = field(default_factory=dict)
    decisions: dict[Limit, EarlyDecision] = field(default_factory=dict)
    estimates: dict[tuple[str, str], EstimatePublished] = field(default_factory=dict)
    temperatures: dict[str, RawBatch | ContinuedBatch] = field(default_factory=dict)  # the newest message by signal

    @property
    def is_instrument(self) -> bool:
        """Whether it is an instrument of the station, such as the chamber, and not a unit under test."""
        return bool(self.run.tested) and self.unit not in self.run.tested

    @property
    def last_ns(self) -> int:
        """When its last sample arrived; of a file with dates, when it was measured."""
        is_of_file = self.run.is_imported and self.run.date_known and self.t_ns is not None
        return self.t_ns or 0 if is_of_file else self.arrival_ns

    @property
    def limits(self) -> tuple[Limit, ...]:
        """Limits that it is judged by."""
        return self.run.limits.get(self.unit) or self.run.limits.get(None, ())

    @property
    def early(self) -> str:
        """Verdict of the early decisions: FAIL by one of them, PASS by all; empty if none is decided."""
        if not self.decisions:
            return ""
        outcomes = [each.outcome for each in self.decisions.values()]
        if Verdict.FAIL in outcomes:
            return Verdict.FAIL.value
        limits = self.limits
        is_passed = bool(limits) and all(
            limit in self.decisions and self.decisions[limit].outcome == Verdict.PASS for limit in limits
        )
        return Verdict.PASS.value if is_passed else ""

    @property
    def so_far(self) -> str:
        """Its verdict, else that of its release or of the early decisions."""
        return self.verdict or self.decided_early

    @property
    def decided_early(self) -> str:
        """Verdict of its release, else of the early decisions."""
        return self.early if self.released is None else self.released.verdict.value

    @property
    def is_at_work(self) -> bool:
        """Whether it delivers samples: its run goes on, and it has power and is not released."""
        return self.run.outcome == "open" and not self.is_off and self.arrival_ns > 0

    def temperature(self, signal: str) -> tuple[float, str] | None:
        """The newest value of a temperature signal and its unit of measure."""
        raw = self.temperatures.get(signal)
        if raw is None:
            return None
        batch = raw.decoded()
        return float(batch.value_array[-1]), batch.unit_of_measure

    @property
    def worst(self) -> Check | None:
        """The check that is nearest its limit, or farthest beyond it."""
        valued = [each for each in self.checks.values() if each.value is not None]
        return max(valued, key=lambda each: (each.value or 0.0) / each.limit.upper, default=None)

    @property
    def left_s(self) -> float | None:
        """Time of its source that the run still takes: until the planned end, or until all limits are decided."""
        run = self.run
        since_ns = run.started_ns if run.since_ns is None else run.since_ns
        if run.outcome != "open" or since_ns is None or self.t_ns is None:
            return None
        elapsed_s = (self.t_ns - since_ns) / 1e9
        if self.decided_early:
            return 0.0
        forecasts = [each.forecast_s for each in self.decisions.values() if each.outcome not in _DECIDED]
        ends = [each for each in (*forecasts, run.planned_s) if each is not None]
        return max(min(ends) - elapsed_s, 0.0) if ends else None


class Floor:
    """Units and runs as the messages of a log leave them; for one thread at a time.

    Each station has its open runs, else its last one; files that are older are left out. `changed` and `gone` are
    numbers of units since the last `forget_changes`, `entered` counts documents that change limits, checks or models.
    """

    def __init__(self) -> None:
        self.units: dict[str, UnitNow] = {}
        self.runs: dict[str, RunNow] = {}
        self.changed: set[str] = set()
        self.fresh: set[str] = set()  # changed in what seldom changes: run, slot, product
        self.gone: list[int] = []
        self.changed_runs: set[str] = set()
        self.entered: Counter[str] = Counter()
        self._over: set[str] = set()  # runs that have left the floor
        self._numbered = 0

    def take_message(self, message: FollowedMessage) -> AnyDocument | None:
        """Apply a message of the log; its document, if it is one. What cannot be read is left to `gyrofleet verify`."""
        place, content, arrival_ns = message.place, message.content, message.record.arrival_ns
        if place is None or isinstance(content, GyrofleetError):
            return None
        key = parsed_key(place.stream.key)
        if isinstance(content, RawBatch | ContinuedBatch):
            assert isinstance(key, SampleKey)
            self.sampled(key.place, key.unit, place.run, place.last_ns, arrival_ns)
            if key.signal.endswith("temperature") and key.unit in self.units:
                self.units[key.unit].temperatures[key.signal] = content
            return None
        self.take(key.place, content, arrival_ns)
        return content

    def take(self, place: Place, document: AnyDocument, arrival_ns: int) -> None:
        """Apply a document."""
        match document:
            case RunStarted() if self._is_older_file(place, document):
                self._over.add(document.run)
            case RunStarted():
                self._over.discard(document.run)
                self._start(place, document, arrival_ns)
            case RunResumed():
                self._over.discard(document.run)
                run = self._run(document.run, place, arrival_ns)
                run.resumptions, run.outcome = run.resumptions + 1, "open"
            case _ if document.run in self._over and isinstance(document, OfRun):
                pass  # final estimates and verdicts come after the end, perhaps when the next run has begun
            case RunEnded():
                self._run(document.run, place, arrival_ns).outcome = document.outcome
                for unit in self._of_run(document.run):
                    unit.is_silent = False
                    self.changed.add(unit.unit)
            case StationStated():
                run = self._run(document.run, place, arrival_ns)
                stated = document.details
                run.time_zone = stated.get("time_zone", run.time_zone)
                run.place = Place(stated.get("site", run.place.site), stated.get("station", run.place.station))
            case LimitsApplied():
                run = self._run(document.run, place, arrival_ns)
                run.limits[document.unit] = document.limits
                run.planned_s, run.since_ns = document.planned_s or run.planned_s, document.since_ns or run.since_ns
            case _ if isinstance(document, OfUnit):
                self._take_of_unit(self._unit(place, document.unit, document.run, arrival_ns), document)
            case _:
                self.entered[type(document).__name__] += 1

    def _is_older_file(self, place: Place, document: RunStarted) -> bool:
        """Whether a run comes from a file, and its station has a run that began later."""
        if not document.is_imported or not document.date_known or document.run in self.runs:
            return False
        others = [run.started_ns for run in self.runs.values() if run.place == place and run.date_known]
        return any(began_ns is not None and began_ns > document.t_ns for began_ns in others)

    def _take_of_unit(self, unit: UnitNow, document: OfUnit) -> None:
        match document:
            case UnitMounted():
                unit.slot, unit.product = document.slot, document.product
                self.fresh.add(unit.unit)
            case StepStarted():
                unit.step = step_text(document.words)
                unit.run.temperature_command_deg_c = document.words.temperature_command_deg_c
            case StepEnded():
                unit.step = ""
                unit.run.temperature_command_deg_c = None  # what the next step commands is known once it has settled
            case PowerOn():
                unit.is_off = unit.released is not None
            case PowerOff():
                unit.is_off = True
            case UnitReleased():
                unit.is_off, unit.released = True, document  # what is done delivers nothing, with power or without
            case EstimatePublished():
                self._estimate(unit, document)
            case EarlyDecision():
                unit.decisions[document.limit] = document
            case VerdictGiven():
                unit.verdict = document.verdict.value
                unit.checks = {check.limit: check for check in document.checks} or unit.checks

    def sampled(self, place: Place, unit: str, run: str, t_ns: int, arrival_ns: int) -> None:
        """Take note of a unit's last sample; that alone is no change."""
        if run in self._over:
            return
        found = self.units.get(unit)
        if found is None or found.run.run != run:
            found = self._unit(place, unit, run, arrival_ns)
        found.t_ns = t_ns if found.t_ns is None else max(found.t_ns, t_ns)
        found.arrival_ns = max(found.arrival_ns, arrival_ns)
        if found.is_silent:
            found.is_silent = False
            self.changed.add(unit)

    def listen(self, now_ns: int) -> None:
        """Find the units that have fallen silent."""
        for unit in self.units.values():
            is_silent = unit.is_at_work and unit.arrival_ns < now_ns - SILENT_AFTER_NS
            if is_silent and not unit.is_silent:
                unit.is_silent = True
                self.changed.add(unit.unit)

    def forget_changes(self) -> None:
        """Begin a new list of changes."""
        self.changed.clear()
        self.fresh.clear()
        self.changed_runs.clear()
        self.gone.clear()

    def _start(self, place: Place, document: RunStarted, arrival_ns: int) -> None:
        run = self._run(document.run, place, arrival_ns)
        run.procedure, run.operator, run.lot = document.procedure, document.operator, document.lot
        run.started_ns, run.date_known, run.outcome = document.t_ns, document.date_known, "open"
        run.time_zone = document.details.get("time_zone")
        run.is_imported = document.is_imported
        run.tested = frozenset(document.units)
        for unit in document.units:
            self._unit(place, unit, document.run, arrival_ns)

    def _run(self, name: str, place: Place, arrival_ns: int) -> RunNow:
        run = self.runs.get(name)
        if run is None:
            self._clear(place)
            run = self.runs[name] = RunNow(name, place)
        run.arrival_ns = max(run.arrival_ns, arrival_ns)
        self.changed_runs.add(name)
        return run

    def _clear(self, place: Place) -> None:
        """Take the ended runs of a station off the floor, as a new one begins there."""
        over = {run.run for run in self.runs.values() if run.place == place and run.outcome != "open"}
        for unit in [unit for unit in self.units.values() if unit.run.run in over]:
            del self.units[unit.unit]
            self.gone.append(unit.number)
            self.changed.discard(unit.unit)
            self.fresh.discard(unit.unit)
        self._over |= over
        for name in over:
            del self.runs[name]
            self.changed_runs.discard(name)

    def _unit(self, place: Place, name: str, run_name: str, arrival_ns: int) -> UnitNow:
        run = self._run(run_name, place, arrival_ns)
        unit = self.units.get(name)
        if unit is None or unit.run is not run:
            number = self._numbered if unit is None else unit.number
            self._numbered += unit is None
            unit = self.units[name] = UnitNow(number, name, run)
            self.fresh.add(name)
        self.changed.add(name)
        return unit

    def _of_run(self, name: str) -> Iterable[UnitNow]:
        return [unit for unit in self.units.values() if unit.run.run == name]

    def _estimate(self, unit: UnitNow, document: EstimatePublished) -> None:
        unit.estimates[document.signal, document.estimator] = document
        for limit in unit.limits:
            if limit.signal == document.signal and estimator_key(limit) == document.estimator:
                unit.checks[limit] = judge(limit, [document])


def step_text(words: StepWords) -> str:
    """A step in few words.

    >>> step_text(StepWords(step="rate", rate_command_deg_per_s=10.0, repeat=2))
    'rate 10 deg/s #2'
    """
    parts = [
        words.step or words.procedure or "",
        words.position or "",
        "" if words.rate_command_deg_per_s is None else f"{words.rate_command_deg_per_s:g} deg/s",
        "" if words.temperature_command_deg_c is None else f"{words.temperature_command_deg_c:g} degC",
        "" if words.repeat is None else f"#{words.repeat}",
    ]
    return " ".join(part for part in parts if part)
