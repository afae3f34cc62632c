"""From units of a store to diagnoses, one after the other or pooled."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.util import find_spec

import msgspec

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.channel_coherence import ChannelCoherence, channel_coherence, copies_of_signal
from analytics.loop.effects.registry import effect
from analytics.loop.explainable import Explainable, explainable
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.next_test.recommendation import NextTest, fleet_next_test, next_test
from analytics.loop.next_test.station_bounds import StationBounds
from analytics.loop.provenance import Provenance, provenance
from analytics.loop.recovery import Recovery, recovered
from analytics.loop.regressor_diagnostics import RegressorDiagnostics, regressor_diagnostics
from analytics.loop.residuals import Residuals, residuals_of
from analytics.loop.station_levels import with_station_levels
from analytics.loop.station_rival import StationRival, fleet_with_station, is_of_days, station_rival, with_station
from analytics.loop.tracing.diagnosis import Asked, diagnosed, diagnosed_or_why_not
from analytics.loop.tracing.fleet import FleetDiagnosis, diagnose_fleet, significant_findings
from analytics.loop.tracing.processors import Spread, by_processes, of_records, single_blas
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from analytics.loop.unit_reduction import Progress, Question, ReducedUnit, ReducedUnits, model_on, reduce_units, silent
from analytics.loop.unread_outputs import with_unread_outputs
from storage.sql.catalog import Catalog
from stream.errors import BadInput, NotFound


@dataclass(frozen=True)
class UnitDiagnosis:
    """The diagnosis of a unit with its data."""

    data: ReducedUnit
    diagnosis: Diagnosis
    next_test: NextTest | None = None  # of what the diagnosis leaves open, if it was asked for
    is_planned: bool = False  # whether it was asked for
    recovery: Mapping[str, Recovery] | None = None  # of the effects found; None if it was not asked for
    left: Explainable | None = None  # what a black box explains of the error; None if it was not tried

    @property
    def unit(self) -> str:
        """Name of the unit."""
        return self.data.runs[0].unit

    @cached_property
    def residuals(self) -> Residuals | None:
        """Residuals of the model found; None if there was not enough data for a diagnosis."""
        return residuals_of(self.data.runs, self.diagnosis)

    @cached_property
    def regressors(self) -> RegressorDiagnostics | None:
        """Collinearity and leverage of the columns of the model found."""
        if self.residuals is None or self.diagnosis.model is None:
            return None
        return regressor_diagnostics(self.residuals, self.diagnosis.model)

    @cached_property
    def coherence(self) -> tuple[ChannelCoherence, ...]:
        """Coherence of the remaining residual with the channels."""
        return () if self.residuals is None else channel_coherence(self.residuals)

    @cached_property
    def provenance(self) -> Provenance:
        """Who asked, when, of which data."""
        return provenance(self.data.runs)

    def document(self) -> dict[str, object]:
        """Content of the JSON document."""
        notes = [{"what": note.what, "text": str(note.text), "channel": note.channel} for note in self.data.notes]
        document = {
            **self.diagnosis.document(),
            "explainable": None if self.left is None else self.left.document(),
            "recovery": msgspec.to_builtins(self.recovery),
            "regressors": msgspec.to_builtins(self.regressors),
            "coherence": msgspec.to_builtins(self.coherence),
            "provenance": msgspec.to_builtins(self.provenance),
            "noise_source": str(self.data.noise_source),
            "reduction": notes,
        }
        if self.is_planned:
            document["next_test"] = None if self.next_test is None else self.next_test.document()
        return document


@dataclass(frozen=True)
class UnitsDiagnosis:
    """The diagnoses of several units."""

    units: Mapping[str, UnitDiagnosis]
    failed: Mapping[str, str]  # why units could not be diagnosed
    own_findings: Mapping[str, tuple[str, ...]]  # significant among so many units (Benjamini and Hochberg)
    fleet: FleetDiagnosis | None = None  # all units pooled, if requested
    next_test: NextTest | None = None  # of what the pooled search leaves open, if it was asked for

    def document(self) -> dict[str, object]:
        """Content of the JSON document."""
        whole = {} if self.fleet is None else self.fleet.document()
        if self.next_test is not None:
            whole["next_test"] = self.next_test.document()
        return whole | {
            "units": {unit: each.document() for unit, each in self.units.items()},
            "own_findings": {unit: list(names) for unit, names in self.own_findings.items()},
            "failed": dict(self.failed),
        }


def with_next_tests(
    found: UnitsDiagnosis,
    models: Mapping[str, ErrorModel],
    bounds: Mapping[str, float],
    on_progress: Progress = silent,
    station: Mapping[str, float] | None = None,
) -> UnitsDiagnosis:
    """The diagnoses with the next test of each unit, and of the fleet; see `next_test`.

    Parameters
    ----------
    bounds: Fields of `StationBounds`.
    station: The same of the station file.
    """
    units = {}
    for unit, each in found.units.items():
        on_progress(f"planning the next test of {unit}")
        runs = each.data.runs
        planned = next_test(
            each.diagnosis, runs, models[unit], declared_noise=each.data.noise, positions=each.data.positions,
            bounds=StationBounds.of_runs(runs, station, **dict(bounds)), on_progress=on_progress,
        )  # fmt: skip
        units[unit] = replace(each, next_test=planned, is_planned=True)
    if found.fleet is None:
        return replace(found, units=units)
    on_progress("planning the next test of the fleet")
    first = next(iter(found.units.values())).data
    of_all = fleet_next_test(
        found.fleet, {unit: each.data.runs for unit, each in found.units.items()}, next(iter(models.values())),
        declared_noise={unit: each.data.noise for unit, each in found.units.items() if each.data.noise is not None},
        bounds=StationBounds.of_runs(first.runs, station, **dict(bounds)), positions=first.positions,
        on_progress=on_progress,
    )  # fmt: skip
    return replace(found, units=units, next_test=of_all)


def with_recovery(
    found: UnitsDiagnosis, models: Mapping[str, ErrorModel], tries: int, on_progress: Progress = silent
) -> UnitsDiagnosis:
    """The diagnoses with how often effects of the sizes found are found again, see `recovered`."""
    units = {}
    for unit, each in found.units.items():
        recovery = None
        if each.residuals is not None and each.diagnosis.names:
            recovery = recovered(
                each.diagnosis,
                each.residuals,
                models[unit],
                tries,
                declared_noise=each.data.noise,
                on_progress=on_progress,
            )
        units[unit] = replace(each, recovery=recovery)
    return replace(found, units=units)


def with_explainable(found: UnitsDiagnosis, on_progress: Progress = silent, *, is_asked: bool = True) -> UnitsDiagnosis:
    """The diagnoses with what a black box explains of the error; where it explains some, something is missing.

    If it is not asked for, it is tried on a single unit without a lasting effect, if scikit-learn is installed.
    """
    if not is_asked and (len(found.units) > 1 or find_spec("sklearn") is None):
        return found
    units = {}
    for unit, each in found.units.items():
        units[unit] = each
        if not is_asked and each.diagnosis.effects:
            continue
        on_progress(f"trying a black box on {unit} ({len(units)} of {len(found.units)})")
        left = None if each.residuals is None else explainable(each.residuals)
        if left is None:
            continue
        diagnosis = each.diagnosis
        if left.is_significant and diagnosis.verdict in (ModelVerdict.NOTHING_MISSING, ModelVerdict.UNREPLICATED):
            diagnosis = msgspec.structs.replace(diagnosis, verdict=ModelVerdict.UNEXPLAINED, unexplained=left.sentence)
        units[unit] = replace(each, diagnosis=diagnosis, left=left)
    return replace(found, units=units)


def diagnose_units(
    catalog: Catalog,
    units: Sequence[str],
    question: Question,
    *,
    is_pooled: bool = False,
    on_progress: Progress = silent,
) -> UnitsDiagnosis:
    """Reduce and trace units of a store; see `reduce_units` and `trace_units`."""
    read = reduce_units(catalog, units, question, on_progress=on_progress)
    return trace_units(read, question, is_pooled=is_pooled, on_progress=on_progress)


def trace_units(
    read: ReducedUnits,
    question: Question,
    *,
    is_pooled: bool = False,
    processes: int = 1,
    spread: Spread | None = None,
    on_progress: Progress = silent,
) -> UnitsDiagnosis:
    """Trace units, if `is_pooled` for common effects as well; a single unit that cannot be diagnosed raises.

    Many units are traced by several `processes`, or by what `spread` runs, with the same results. Where the stations
    that measured them explain a drift over days as well, they are named as an alternative; where the biases of a unit
    without a finding differ by station, that is named.
    """
    found = _traced(read, question, is_pooled, processes, spread, on_progress)
    rival = _station_rival(found, question)
    fleet = None if found.fleet is None else fleet_with_station(found.fleet, rival)
    units = {
        unit: replace(
            each,
            diagnosis=with_unread_outputs(
                with_station_levels(
                    with_station(each.diagnosis, rival, unit), each.data.runs, each.data.stations, read.models[unit]
                ),
                each.data.notes,
            ),
        )
        for unit, each in found.units.items()
    }
    return replace(found, units=units, fleet=fleet)


def _station_rival(found: UnitsDiagnosis, question: Question) -> StationRival | None:
    """What stations explain of the units' runs, if a drift over days was found in any."""
    effects = [each for unit in found.units.values() for each in unit.diagnosis.effects]
    if found.fleet is not None:
        effects += found.fleet.effects
    if not any(is_of_days(each) for each in effects):
        return None
    runs = {unit: each.data.runs for unit, each in found.units.items()}
    model = model_on(question, [run for each in runs.values() for run in each])
    return station_rival(runs, {unit: each.data.stations for unit, each in found.units.items()}, model)


def _traced(
    read: ReducedUnits, question: Question, is_pooled: bool, processes: int, spread: Spread | None,
    on_progress: Progress,
) -> UnitsDiagnosis:  # fmt: skip
    failed = dict(read.failed)
    is_one = len(read.units) + len(failed) == 1
    held_out, all_held = _held_out_of_each(question.holdout, read.units, is_one=is_one)
    failed |= dict.fromkeys(all_held, "all its runs are to be held out: leave some that the model is fitted to")
    units = {unit: data for unit, data in read.units.items() if unit not in all_held or is_one}
    if is_pooled and units:
        with single_blas():
            return _pooled(units, question, failed, held_out, processes, spread, on_progress)
    asked = [
        Asked(
            data.runs, read.models[unit], declared_noise=data.noise, holdout=held_out.get(unit),
            left_out=data.left_out, turn_on_is_declared=data.turn_on_is_declared,
        )
        for unit, data in units.items()
    ]  # fmt: skip
    done: dict[str, UnitDiagnosis] = {}
    work = diagnosed if is_one else diagnosed_or_why_not
    answers = by_processes(work, asked, processes) if spread is None else spread(work, asked)
    for number, ((unit, data), question_of) in enumerate(zip(units.items(), asked, strict=True), start=1):
        on_progress(f"tracing {unit} ({number} of {len(units)})")
        answer = next(answers)
        if isinstance(answer, str):
            failed[unit] = answer
            continue
        found = UnitDiagnosis(data, answer)
        if copies := _copied_channels(found):
            runs = tuple(_without(run, copies) for run in data.runs)
            answer = diagnosed(replace(question_of, runs=runs))
            found = _with_copies_named(UnitDiagnosis(replace(data, runs=runs), answer), copies, are_left_out=True)
        done[unit] = found
    if not done:
        count = len(read.units) + len(read.failed)
        why = "; ".join(f"{unit}: {why}" for unit, why in failed.items())
        raise NotFound(f"none of {count} units can be diagnosed; {why}")
    return UnitsDiagnosis(done, failed, significant_findings({unit: each.diagnosis for unit, each in done.items()}))


def _copied_channels(found: UnitDiagnosis) -> tuple[str, ...]:
    """Channels of the effects found that are copies of the signal."""
    named = (*found.diagnosis.effects, *found.diagnosis.unreplicated)
    channels = sorted({channel for each in named for channel in effect(each.name).needs})
    return () if found.residuals is None or not channels else copies_of_signal(found.residuals, channels)


def _without(run: RunBlocks, channels: Sequence[str]) -> RunBlocks:
    return replace(run, channels={name: each for name, each in run.channels.items() if name not in channels})


def _with_copies_named(found: UnitDiagnosis, copies: Sequence[str], *, are_left_out: bool) -> UnitDiagnosis:
    """The diagnosis, with a caveat on each channel that is a copy of the signal."""
    if not copies:
        return found
    so = Bilingual("it is left out", "已予剔除") if are_left_out else Bilingual(
        "what is named from it is no effect", "由其得出的效应不成立"
    )  # fmt: skip
    caveats = tuple(
        Bilingual(
            f"channel {name} follows the signal at every frequency without a lag, its noise included: it is a copy (a "
            f"leak) of the signal rather than a cause; {so}",
            f"通道{name}在所有频率上无滞后地跟随信号（包括其噪声）：它是信号的复制（串扰）而非成因；{so.zh}",
        )
        for name in copies
    )
    diagnosis = msgspec.structs.replace(found.diagnosis, limits=(*caveats, *found.diagnosis.limits))
    return replace(found, diagnosis=diagnosis)


def _pooled(
    units: Mapping[str, ReducedUnit],
    question: Question,
    failed: Mapping[str, str],
    held_out: Mapping[str, Sequence[str]],
    processes: int,
    spread: Spread | None,
    on_progress: Progress,
) -> UnitsDiagnosis:
    runs = {unit: data.runs for unit, data in units.items()}
    fleet = diagnose_fleet(
        runs,
        model_on(question, [run for each in runs.values() for run in each]),
        declared_noise={unit: data.noise for unit, data in units.items() if data.noise is not None},
        holdout=held_out,
        left_out={unit: data.left_out for unit, data in units.items()},
        turn_on_is_declared={unit: data.turn_on_is_declared for unit, data in units.items()},
        processes=processes,
        spread=spread,
        on_progress=on_progress,
    )
    each = [UnitDiagnosis(data, fleet.units[unit]) for unit, data in units.items()]
    copies = of_records(lambda number: _copied_channels(each[number]), len(each))
    done = {
        unit: _with_copies_named(found, names, are_left_out=False)
        for unit, found, names in zip(units, each, copies, strict=True)
    }
    return UnitsDiagnosis(done, failed, fleet.own_findings, fleet)


def _held_out_of_each(
    asked: Sequence[str] | None, units: Mapping[str, ReducedUnit], *, is_one: bool
) -> tuple[dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Runs to hold out of each unit, and units of which these are all runs; each run must be in some unit."""
    if asked is None:
        return {}, ()
    names = {name for data in units.values() for run in data.runs for name in (run.run, run.whole_run)}
    if not is_one and (strangers := sorted(set(asked) - names)):
        raise BadInput(f"run to hold out is not there in any unit: {', '.join(strangers)}")
    held: dict[str, tuple[str, ...]] = {}
    for unit, data in units.items():
        own = [name for name in asked if is_one or any(name in (run.run, run.whole_run) for run in data.runs)]
        held[unit] = held_out_runs(own, data.runs) or ()
    return held, tuple(unit for unit, own in held.items() if own and len(own) == len(units[unit].runs))


def held_out_runs(asked: Sequence[str] | None, runs: Sequence[RunBlocks]) -> tuple[str, ...] | None:
    """Runs that are held out; the name of a run means all its power-ons, ``RUN#1``, ``RUN#2``, ..."""
    if asked is None:
        return None
    names = [run.run for run in runs]
    if strangers := sorted(set(asked).difference(names, (run.whole_run for run in runs))):
        there = ", ".join(names)
        raise BadInput(
            f"unit {runs[0].unit}: run to hold out is not there: {', '.join(strangers)}; the runs are {there}"
        )
    return tuple(run.run for run in runs if run.run in asked or run.whole_run in asked)
