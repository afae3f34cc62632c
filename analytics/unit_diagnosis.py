"""From the store to diagnoses: what was asked, each unit reduced and traced, one after the other or pooled."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from analytics.block_checks import Note, in_runs
from analytics.block_reduction import BLOCK_S, BlockReducer
from analytics.declared_noise import declared_noise
from analytics.effects.registry import effect
from analytics.error_model import ErrorModel
from analytics.run_blocks import RunBlocks
from analytics.tracing.diagnosis import diagnose
from analytics.tracing.fleet import FleetDiagnosis, diagnose_fleet, standing
from analytics.tracing.result import Diagnosis, NoiseCoefficients
from storage.catalog import Catalog
from stream.errors import BadInput, GyrofleetError, NotFound
from stream.estimators.base import NoEstimate

_LARGEST = 1e50


@dataclass(frozen=True)
class Question:
    """What is asked of units.

    Parameters
    ----------
    model : str
        The declared error model as text.
    signal : str, optional
        Which signal; the one that the model names if left out.
    block_s : float
        Length of a block, seconds.
    noise : NoiseCoefficients, optional
        Declared; by default that of each unit's own Allan fits.
    holdout : tuple of str, optional
        Runs to hold out; the last third if left out.
    runs : tuple of str, optional
        Only these runs.
    since_ns : int, optional
        Only samples from then on.
    """

    model: str
    signal: str | None = None
    block_s: float = BLOCK_S
    noise: NoiseCoefficients | None = None
    holdout: tuple[str, ...] | None = None
    runs: tuple[str, ...] | None = None
    since_ns: int | None = None

    @property
    def signal_name(self) -> str:
        """The signal, as it was named or as the model names it.

        Raises
        ------
        BadInput
            If neither names it, or they differ.

        Examples
        --------
        >>> Question("rate = bias + temperature").signal_name
        'rate'
        """
        left, equals, _ = self.model.partition("=")
        named = left.strip() if equals and "(" not in left else None
        if self.signal is None and named is None:
            raise BadInput(f"error model '{self.model}': which signal is it of? give --signal, or write 'rate = ...'")
        if self.signal is not None and named is not None and named != self.signal:
            raise BadInput(f"error model '{self.model}' is of signal {named}, not of {self.signal}: name one")
        return self.signal or named or ""


@dataclass(frozen=True)
class ReducedUnit:
    """A unit's runs as blocks, with what is to be said of them.

    Parameters
    ----------
    runs : tuple of RunBlocks
        The runs.
    notes : tuple of Note
        What was left out, converted, supposed or looks wrong.
    noise : NoiseCoefficients, optional
        Declared, or by the unit's own Allan fits.
    noise_source : str
        Where that comes from, or why there is none.
    """

    runs: tuple[RunBlocks, ...]
    notes: tuple[Note, ...]
    noise: NoiseCoefficients | None
    noise_source: str


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
    units : mapping of str to UnitDiagnosis
        Each unit alone.
    failed : mapping of str to str
        Units that could not be diagnosed, and why.
    own_findings : mapping of str to tuple of str
        Findings that stand among so many units (Benjamini and Hochberg).
    fleet : FleetDiagnosis, optional
        All units pooled, where that was asked.
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


@dataclass(frozen=True)
class ReducedUnits:
    """Units that were read, and what each is asked.

    Parameters
    ----------
    units : mapping of str to ReducedUnit
        Those that could be read.
    models : mapping of str to ErrorModel
        The declared model, on the channels of each.
    failed : mapping of str to str
        The others, and why.
    """

    units: Mapping[str, ReducedUnit]
    models: Mapping[str, ErrorModel]
    failed: Mapping[str, str]


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


def reduce_units(
    catalog: Catalog, units: Sequence[str], question: Question, *, told: Callable[[str], None] = lambda _: None
) -> ReducedUnits:
    """Read units of a store as blocks.

    Parameters
    ----------
    catalog : Catalog
        The store.
    units : sequence of str
        Which units.
    question : Question
        What is asked of them.
    told : callable, optional
        Is told what is being done.

    Raises
    ------
    GyrofleetError
        If there is one unit only and it cannot be read, or none of several can.
    """
    reducer = BlockReducer(
        catalog, question.signal_name, block_s=question.block_s, runs=question.runs, since_ns=question.since_ns
    )
    reduced: dict[str, ReducedUnit] = {}
    models: dict[str, ErrorModel] = {}
    failed: dict[str, str] = {}
    for unit in units:
        told(f"reading {unit}")
        try:
            found = reducer.reduce(unit)
            runs, left_out = _with_channels_of(question, found.runs)
            models[unit] = _model(question, runs)
            gone = {run for note in left_out for run in note.runs}
            notes = (*left_out, *(each for each in found.notes if not (each.runs and gone.issuperset(each.runs))))
            _check_values(runs)
            reduced[unit] = ReducedUnit(runs, notes, *_noise(catalog, runs, models[unit], question))
        except GyrofleetError as error:
            if len(units) == 1:
                raise
            failed[unit] = str(error)
    if not reduced:
        raise NotFound(f"none of {len(units)} units can be diagnosed; {units[0]}: {failed[units[0]]}")
    return ReducedUnits(reduced, models, failed)


def trace_units(
    read: ReducedUnits,
    question: Question,
    *,
    is_pooled: bool = False,
    told: Callable[[str], None] = lambda _: None,
) -> UnitsDiagnosis:
    """Trace units that were read.

    Parameters
    ----------
    read : ReducedUnits
        The units.
    question : Question
        What is asked of them.
    is_pooled : bool
        Whether to search for what they have in common as well.
    told : callable, optional
        Is told what is being done.

    Raises
    ------
    GyrofleetError
        If there is one unit only and it cannot be diagnosed, or none of several can.
    """
    if is_pooled:
        return _pooled(read.units, question, read.failed, told)
    failed = dict(read.failed)
    is_one = len(read.units) + len(failed) == 1
    done: dict[str, UnitDiagnosis] = {}
    for unit, data in read.units.items():
        told(f"tracing {unit}")
        try:
            held_out = held_out_runs(question.holdout, data.runs)
            found_in = diagnose(data.runs, read.models[unit], declared_noise=data.noise, holdout=held_out)
        except GyrofleetError as error:
            if is_one:
                raise
            failed[unit] = str(error)
            continue
        done[unit] = UnitDiagnosis(data, found_in)
    if not done:
        count = len(read.units) + len(read.failed)
        unit, why = next(iter(failed.items()))
        raise NotFound(f"none of {count} units can be diagnosed; {unit}: {why}")
    return UnitsDiagnosis(done, failed, standing({unit: each.diagnosis for unit, each in done.items()}))


def _check_values(runs: Sequence[RunBlocks]) -> None:
    """Refuse numbers whose squares are none, which only a fill value or a damaged reading has."""
    for run in runs:
        means = {run.signal: run.value, **{name: channel.mean for name, channel in run.channels.items()}}
        for name, mean in means.items():
            known = mean[np.isfinite(mean)]
            if len(known) and float(np.abs(known).max()) > _LARGEST:
                raise BadInput(
                    f"unit {run.unit}, run {run.run}: {name} reaches {float(known[np.abs(known).argmax()]):.3g}, which "
                    "no sensor gives; leave such samples out and import the run anew"
                )


def _pooled(
    reduced: Mapping[str, ReducedUnit], question: Question, failed: Mapping[str, str], told: Callable[[str], None]
) -> UnitsDiagnosis:
    told(f"tracing {len(reduced)} units together")
    runs = {unit: data.runs for unit, data in reduced.items()}
    fleet = diagnose_fleet(
        runs,
        _model(question, [run for each in runs.values() for run in each]),
        declared_noise={unit: data.noise for unit, data in reduced.items() if data.noise is not None},
        holdout=_held_out_of_each(question.holdout, runs),
    )
    done = {unit: UnitDiagnosis(data, fleet.units[unit]) for unit, data in reduced.items()}
    return UnitsDiagnosis(done, failed, fleet.own_findings, fleet)


def _with_channels_of(question: Question, runs: Sequence[RunBlocks]) -> tuple[tuple[RunBlocks, ...], tuple[Note, ...]]:
    """Runs that have the channels that the model needs, and a note on the others; all where none has them."""
    known = set[str]().union(*(run.channels for run in runs))
    needed = {channel for name in ErrorModel.parse(question.model, known).effects for channel in effect(name).needs}
    kept = tuple(run for run in runs if needed <= set(run.channels))
    others = [run.run for run in runs if not needed <= set(run.channels)]
    if not kept or not others:
        return tuple(runs), ()
    lacking = sorted(channel for channel in needed if any(channel not in run.channels for run in runs))
    text = f"{in_runs(others, len(runs))} {', '.join(lacking)} is missing, which the model needs: left out"
    return kept, (Note("without_channel", text, lacking[0], tuple(others)),)


def _model(question: Question, runs: Sequence[RunBlocks]) -> ErrorModel:
    channels = set.intersection(*(set(run.channels) for run in runs))
    return ErrorModel.parse(question.model, channels).shaped(runs)


def _noise(
    catalog: Catalog, runs: Sequence[RunBlocks], model: ErrorModel, question: Question
) -> tuple[NoiseCoefficients | None, str]:
    if question.noise is not None:
        return question.noise, "as given"
    found = declared_noise(catalog, runs, model)
    if isinstance(found, NoEstimate):
        return None, found.reason
    return found, "the unit's own Allan fits"


def _held_out_of_each(
    asked: Sequence[str] | None, runs: Mapping[str, Sequence[RunBlocks]]
) -> dict[str, tuple[str, ...]]:
    """Runs to hold out of each unit; a run need not be one of every unit, but of some.

    Raises
    ------
    BadInput
        If no unit has one of the runs.
    """
    if asked is None:
        return {}
    names = {name for each in runs.values() for run in each for name in _names_of(run)}
    if strangers := sorted(set(asked) - names):
        raise BadInput(f"run to hold out is not there in any unit: {', '.join(strangers)}")
    return {
        unit: held_out_runs([name for name in asked if any(name in _names_of(run) for run in of_unit)], of_unit) or ()
        for unit, of_unit in runs.items()
    }


def _names_of(run: RunBlocks) -> tuple[str, str]:
    """The name of a run, and of the whole run where it is one of its power-ons."""
    return run.run, run.run.rpartition("#")[0] or run.run


def held_out_runs(asked: Sequence[str] | None, runs: Sequence[RunBlocks]) -> tuple[str, ...] | None:
    """Runs that are held out; the name of a run stands for all its power-ons, ``RUN#1``, ``RUN#2``, ...

    Raises
    ------
    BadInput
        If a run is not among them.
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


def units_with(catalog: Catalog, signal: str) -> list[str]:
    """All units of a store that have a signal.

    Raises
    ------
    NotFound
        If there is none.
    """
    sql = "select distinct unit from signals where signal = $signal order by unit"
    units = [str(unit) for (unit,) in catalog.rows(sql, {"signal": signal})]
    if not units:
        known = ", ".join(str(name) for (name,) in catalog.rows("select distinct signal from signals order by signal"))
        raise NotFound(f"no unit of the store has a signal {signal}; there are {known or 'none at all'}")
    return units
