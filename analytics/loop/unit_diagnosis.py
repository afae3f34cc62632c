"""From units of a store to diagnoses, one after the other or pooled."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.fleet import FleetDiagnosis, diagnose_fleet, significant_findings
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.unit_reduction import Question, ReducedUnit, ReducedUnits, model_on, reduce_units
from storage.sql.catalog import Catalog
from stream.errors import BadInput, GyrofleetError, NotFound


@dataclass(frozen=True)
class UnitDiagnosis:
    """The diagnosis of a unit, and what it rests on."""

    data: ReducedUnit
    diagnosis: Diagnosis

    @property
    def unit(self) -> str:
        """Which unit."""
        return self.data.runs[0].unit

    def document(self) -> dict[str, object]:
        """Return it as it stands in JSON."""
        notes = [{"what": note.what, "text": note.text, "channel": note.channel} for note in self.data.notes]
        return {**self.diagnosis.document(), "noise_source": self.data.noise_source, "reduction": notes}


@dataclass(frozen=True)
class UnitsDiagnosis:
    """The diagnoses of several units.

    Parameters
    ----------
    units: Each unit alone.
    failed: Units that could not be diagnosed, and why.
    own_findings: Findings that stand among so many units (Benjamini and Hochberg).
    fleet: All units pooled, where that was asked.
    """

    units: Mapping[str, UnitDiagnosis]
    failed: Mapping[str, str]
    own_findings: Mapping[str, tuple[str, ...]]
    fleet: FleetDiagnosis | None = None

    def document(self) -> dict[str, object]:
        """Return it as it stands in JSON."""
        whole = {} if self.fleet is None else self.fleet.document()
        return whole | {
            "units": {unit: each.document() for unit, each in self.units.items()},
            "own_findings": {unit: list(names) for unit, names in self.own_findings.items()},
            "failed": dict(self.failed),
        }


def diagnose_units(
    catalog: Catalog,
    units: Sequence[str],
    question: Question,
    *,
    is_pooled: bool = False,
    told: Callable[[str], None] = lambda _: None,
) -> UnitsDiagnosis:
    """Reduce and trace units of a store; see `reduce_units` and `trace_units`."""
    return trace_units(reduce_units(catalog, units, question, told=told), question, is_pooled=is_pooled, told=told)


def trace_units(
    read: ReducedUnits, question: Question, *, is_pooled: bool = False, told: Callable[[str], None] = lambda _: None
) -> UnitsDiagnosis:
    """Trace units that were read.

    Parameters
    ----------
    read: The units.
    question: What is asked of them.
    is_pooled: Whether to search for what they have in common as well.
    told: Called with a sentence on each stage.

    Raises
    ------
    GyrofleetError: If there is one unit only and it cannot be diagnosed, or none of several can.
    """
    failed = dict(read.failed)
    is_one = len(read.units) + len(failed) == 1
    held_out, all_held = _held_out_of_each(question.holdout, read.units, is_one=is_one)
    failed |= dict.fromkeys(all_held, "all its runs are to be held out: leave some that the model is fitted to")
    units = {unit: data for unit, data in read.units.items() if unit not in all_held or is_one}
    if is_pooled and units:
        return _pooled(units, question, failed, held_out, told)
    done: dict[str, UnitDiagnosis] = {}
    for number, (unit, data) in enumerate(units.items(), start=1):
        told(f"tracing {unit} ({number} of {len(units)})")
        try:
            found_in = diagnose(
                data.runs,
                read.models[unit],
                declared_noise=data.noise,
                holdout=held_out.get(unit),
                left_out=data.left_out,
                turn_on_is_declared=data.turn_on_is_declared,
            )
        except GyrofleetError as error:
            if is_one:
                raise
            failed[unit] = str(error)
            continue
        done[unit] = UnitDiagnosis(data, found_in)
    if not done:
        count = len(read.units) + len(read.failed)
        why = "; ".join(f"{unit}: {why}" for unit, why in failed.items())
        raise NotFound(f"none of {count} units can be diagnosed; {why}")
    return UnitsDiagnosis(done, failed, significant_findings({unit: each.diagnosis for unit, each in done.items()}))


def _pooled(
    units: Mapping[str, ReducedUnit],
    question: Question,
    failed: Mapping[str, str],
    held_out: Mapping[str, Sequence[str]],
    told: Callable[[str], None],
) -> UnitsDiagnosis:
    runs = {unit: data.runs for unit, data in units.items()}
    fleet = diagnose_fleet(
        runs,
        model_on(question, [run for each in runs.values() for run in each]),
        declared_noise={unit: data.noise for unit, data in units.items() if data.noise is not None},
        holdout=held_out,
        left_out={unit: data.left_out for unit, data in units.items()},
        on_progress=told,
    )
    done = {unit: UnitDiagnosis(data, fleet.units[unit]) for unit, data in units.items()}
    return UnitsDiagnosis(done, failed, fleet.own_findings, fleet)


def _held_out_of_each(
    asked: Sequence[str] | None, units: Mapping[str, ReducedUnit], *, is_one: bool
) -> tuple[dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Runs to hold out of each unit, and units all of whose runs they are; of several units not all need have a run.

    Raises
    ------
    BadInput: If no unit has one of the runs.
    """
    if asked is None:
        return {}, ()
    names = {name for data in units.values() for run in data.runs for name in _names_of(run)}
    if not is_one and (strangers := sorted(set(asked) - names)):
        raise BadInput(f"run to hold out is not there in any unit: {', '.join(strangers)}")
    held: dict[str, tuple[str, ...]] = {}
    for unit, data in units.items():
        own = [name for name in asked if is_one or any(name in _names_of(run) for run in data.runs)]
        held[unit] = held_out_runs(own, data.runs) or ()
    return held, tuple(unit for unit, own in held.items() if own and len(own) == len(units[unit].runs))


def _names_of(run: RunBlocks) -> tuple[str, str]:
    """The name of a run, and of the whole run where it is one of its power-ons."""
    return run.run, run.run.rpartition("#")[0] or run.run


def held_out_runs(asked: Sequence[str] | None, runs: Sequence[RunBlocks]) -> tuple[str, ...] | None:
    """Runs that are held out; the name of a run stands for all its power-ons, ``RUN#1``, ``RUN#2``, ...

    Raises
    ------
    BadInput: If a run is not among them.
    """
    if asked is None:
        return None
    names = [run.run for run in runs]
    bases = {name: name.rpartition("#")[0] or name for name in names}
    if strangers := sorted(set(asked) - set(names) - set(bases.values())):
        raise BadInput(
            f"unit {runs[0].unit}: run to hold out is not there: {', '.join(strangers)}; the runs are "
            f"{', '.join(names)}"
        )
    return tuple(name for name in names if name in asked or bases[name] in asked)
