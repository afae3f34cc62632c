"""The limits that a run applies to its units: found in the store by each unit's product."""

import re
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from ingest.procedures.plan import PlannedStep
from ingest.run_record import document_uid
from ingest.station.units_file import UnitEntry
from storage.specifications.live_limits import UnitLimits, chosen_periods, format_limit, unit_limits
from storage.specifications.validity import Period
from storage.store import Store
from storage.store_marker import MARKER
from stream.errors import NotFound
from stream.events import AnyDocument, EarlyDecision, Limit, LimitsApplied, Verdict, VerdictGiven

_NAMED = 4
_SILENT_S = 180.0  # three times as long as an estimator waits by default between two estimates
# records at rest of these are no records of a bias (analytics/evaluation/views/05_procedures.sql)
_NO_BIAS = re.compile(
    r"(power_consumption|rates_(gjb2426a|jjf2014)|threshold(_indexing_head|_slow_turn)?|resolution|polarity"
    r"|visual_electrical_checks)$"
    r"|(scale_factor|misalignment|gyro_separation|accelerometer_separation|attitude_unit|bandwidth|output_delay"
    r"|startup_time|warmup_time|random_walk|system_level|bias_(temperature|acceleration|shock|vibration))"
)


class RunLimits(NamedTuple):
    """Limits on the units of a run."""

    units: Mapping[str, UnitLimits]  # limits by unit; units without a specification are left out
    is_live: bool  # whether the run has the one record at rest that live estimators can judge
    remarks: tuple[str, ...]  # what the operator should know, each as a sentence

    def at_start(self, run: str, t_ns: int) -> Iterator[LimitsApplied]:
        """Documents at the start of a run: the specifications of the units whose limits are all judged after it."""
        for unit, found in self.units.items():
            if not (self.is_live and found.live):
                uid = document_uid(f"gyrofleet:limits/{run}/{unit}/{t_ns}")
                yield LimitsApplied(run=run, t_ns=t_ns, uid=uid, unit=unit, revision=found.label, limits=())

    def at_record(self, run: str, t_ns: int, since_ns: int, record_s: float) -> Iterator[LimitsApplied]:
        """Documents at the start of the record that the live limits are on."""
        for unit, found in self.units.items() if self.is_live else ():
            if found.live:
                yield LimitsApplied(
                    run=run, t_ns=t_ns, uid=document_uid(f"gyrofleet:limits/{run}/{unit}/{t_ns}/record"), unit=unit,
                    revision=found.label, limits=found.live, planned_s=record_s, since_ns=since_ns,
                )  # fmt: skip


_NEVER_NS = 2**63 - 1


class LimitReport:
    """Reports early decisions and verdicts to the operator; `verdicts` has that of each unit once the run has ended.

    `judged` are the units whose limits an estimator in another process is to judge while they are recorded, `units` all
    limits by unit.
    """

    def __init__(
        self, report: Callable[[str], None], judged: Collection[str] = (), units: Mapping[str, UnitLimits] = {}
    ) -> None:
        self._report, self._judged, self._units = report, frozenset(judged), units
        self._estimate_s: float | None = None  # when an estimate came last, or the record began
        self._decided: set[tuple[str, Limit, str]] = set()
        self._looks: dict[str, dict[Limit, EarlyDecision]] = {}
        self._since_ns = _NEVER_NS  # what a resumed run replays is of records that are measured again
        self.verdicts: dict[str, str] = {}

    def so_far(self) -> dict[str, str]:
        """Verdict of each unit, of those that go on what is decided early: FAIL, or PASS where all limits are."""
        found = dict(self.verdicts)
        for unit, looks in self._looks.copy().items():
            outcomes = {each.outcome for each in looks.copy().values()}
            if unit not in found and ("FAIL" in outcomes or outcomes == {"PASS"}):
                found[unit] = "FAIL" if "FAIL" in outcomes else "PASS"
        return found

    def begin_record(self, since_ns: int) -> None:
        """A record begins: looks at one before it count no more."""
        self._since_ns, self._estimate_s = since_ns, time.monotonic()
        self._looks.clear()
        self._decided.clear()

    def estimate_arrived(self) -> None:
        """Take note of an estimate of a unit of the run; from the thread of the bus."""
        self._estimate_s = time.monotonic()

    @property
    def silence(self) -> str | None:
        """That nobody judges the limits of the record that is at work; None where an estimator does, or none need."""
        left = self._judged - self.verdicts.keys()
        if self._estimate_s is None or not left or time.monotonic() - self._estimate_s < _SILENT_S:
            return None
        return (
            f"no estimate of these units has come for {_SILENT_S / 60:.0f} min: the limits of {len(left)} of them are "
            "not judged while they are recorded; is `gyrofleet estimate` running where this run is sent to? "
            "`gyrofleet verdicts` judges them afterwards"
        )

    def early(self, unit: str) -> dict[Limit, str]:
        """Outcome of each limit of a unit that is decided early."""
        looks = self._looks.get(unit, {}).copy()
        return {
            limit: each.outcome
            for limit, each in looks.items()
            if each.outcome != "UNDECIDED" and each.looked_at_fraction < 1.0
        }

    def undecided(self) -> dict[str, int]:
        """How many limits of each unit are not decided yet."""
        looks = {unit: list(of.copy().values()) for unit, of in self._looks.copy().items() if unit not in self.verdicts}
        return {unit: sum(each.outcome == "UNDECIDED" for each in of) for unit, of in looks.items()}

    def forecast_s(self) -> float | None:
        """Seconds of the record at which the last undecided limit is expected to be decided; None if not forecast."""
        looks = [each for of in self._looks.copy().values() for each in of.copy().values()]
        left = [each.forecast_s for each in looks if each.outcome == "UNDECIDED"]
        known = [each for each in left if each is not None]
        return max(known) if known and len(known) == len(left) else None

    def see(self, document: AnyDocument) -> None:
        """Take a document of the estimators; from their thread."""
        if isinstance(document, EarlyDecision) and document.t_ns < self._since_ns:
            return
        if isinstance(document, EarlyDecision):
            self._looks.setdefault(document.unit, {})[document.limit] = document
        if isinstance(document, EarlyDecision) and document.outcome != "UNDECIDED":
            decided = (document.unit, document.limit, document.outcome)
            if decided not in self._decided and document.looked_at_fraction < 1.0:
                self._decided.add(decided)
                limit = format_limit(document.limit)
                self._report(f"unit {document.unit}: early {document.outcome}, {limit}: {document.reason}")
        elif isinstance(document, VerdictGiven):
            self.verdicts[document.unit] = document.verdict.value
            worst = [
                ": ".join(filter(None, (format_limit(each.limit), each.reason)))
                for each in document.checks
                if each.verdict is document.verdict
            ]
            why = f" ({'; '.join(worst)})" if document.verdict is not Verdict.PASS and worst else ""
            of_unit = self._units.get(document.unit)
            if of_unit is not None and of_unit.after and document.verdict is not Verdict.FAIL:
                why += f"; open until the run is judged: {', '.join(of_unit.after)}"
            self._report(f"unit {document.unit}: {document.verdict} by the live limits{why}")


NO_LIMITS = RunLimits({}, False, ())


def run_limits(
    folder: Path, wanted: str | None, entries: Sequence[UnitEntry], signals: Mapping[str, Sequence[str]],
    steps: Sequence[PlannedStep], procedure: str, t_ns: int,
) -> RunLimits:  # fmt: skip
    """Find the limits on the units of a run that starts at `t_ns` and is recorded into the store `folder`.

    `wanted` is the specification to apply, ``NAME`` or ``NAME@REVISION``; by default those that are valid. `signals`
    are the angular rates of each unit. Raises NotFound, with those that are there, if the wanted specification is not
    in the store; StoreError if the store is damaged.
    """
    periods, valid, remark = _periods(folder, wanted, t_ns)
    specifications = [each.specification for each in periods]
    found = {e.serial: unit_limits(specifications, e.product, signals.get(e.serial, ())) for e in entries}
    units = {unit: limits for unit, limits in found.items() if limits is not None}
    is_live = has_one_record_at_rest(steps, procedure)
    remarks = [remark] if remark else list(_without_limits(entries, units, wanted))
    if wanted and not {each.label for each in specifications} <= valid:
        others = ", ".join(sorted(valid)) or "none"
        remarks.append(f"{wanted} is applied; `gyrofleet verdicts` judges by the revisions valid now: {others}")
    return RunLimits(units, is_live, (*remarks, *_judged_after(units, is_live=is_live)))


def has_one_record_at_rest(steps: Sequence[PlannedStep], procedure: str) -> bool:
    """Whether a procedure records one step in which the units stand still: live estimators know no steps."""
    recorded = [step.words for step in steps if step.is_recorded]
    moving = ("rate_command_deg_per_s", "frequency_hz", "axis", "phase")
    is_moving = any(getattr(words, name) for words in recorded for name in moving)
    return len(recorded) == 1 and not is_moving and not _NO_BIAS.match(procedure)


def _periods(folder: Path, wanted: str | None, t_ns: int) -> tuple[list[Period], set[str], str]:
    """Specifications to apply, labels of those that are valid, and why there are none."""
    if not (folder / MARKER).exists():
        if wanted is not None:
            raise NotFound(f"--specification {wanted}: there is no store in {folder}, so there is no specification")
        return [], set(), f"no limits: there is no store in {folder} yet; `gyrofleet limits add FILE` adds one"
    store = Store.open(folder)
    try:
        valid = chosen_periods(store, t_ns)
    except NotFound as error:
        if wanted is not None:
            raise
        return [], set(), f"no limits: {error}"
    labels = {each.specification.label for each in valid}
    if wanted is not None:
        return chosen_periods(store, t_ns, wanted), labels, ""
    return valid, labels, "" if valid else f"no limits: {folder} has no specification that is valid now"


def _without_limits(entries: Sequence[UnitEntry], units: Mapping[str, UnitLimits], wanted: str | None) -> Iterator[str]:
    without: dict[str | None, list[str]] = {}
    for entry in entries:
        if entry.serial not in units:
            without.setdefault(entry.product, []).append(entry.serial)
    whose = f"specification {wanted} has no" if wanted else "no specification has"
    for product, serials in without.items():
        of = "every product, and the units file names none" if product is None else f"product {product}"
        yield f"{whose} limits for {of}: units {listed(serials)} are not judged"


def _judged_after(units: Mapping[str, UnitLimits], *, is_live: bool) -> Iterator[str]:
    """A sentence for all units of which the same limits are judged after the run."""
    after: dict[str, list[str]] = {}
    for unit, limits in units.items():
        live = () if is_live else dict.fromkeys(each.characteristic for each in limits.live)
        after.setdefault(", ".join((*limits.after, *live)), []).append(unit)
    for subjects, serials in after.items():
        if subjects:
            yield f"judged after the run (units {listed(serials)}): {subjects}"


def listed(serials: Sequence[str]) -> str:
    """The first of them by name, and how many more."""
    return ", ".join(serials[:_NAMED]) + (f" and {len(serials) - _NAMED} more" if len(serials) > _NAMED else "")
