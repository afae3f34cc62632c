"""From the store to blocks: units reduced for a question, each with its declared model and its noise."""

import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.block_reducer import BLOCK_S, BlockReducer
from analytics.loop.blocks.notes.left_out import GRAVE, LeftOut
from analytics.loop.blocks.notes.reduction_notes import Note, in_runs
from analytics.loop.blocks.reading.stored_signals import usual_block_s
from analytics.loop.blocks.record_checks import copied_elsewhere, copied_runs, copies_left_out
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.blocks.step_channels import position_numbers
from analytics.loop.effects.registry import effect
from analytics.loop.model.declared_noise import GivenNoise, declared_noise, with_turn_on
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from storage.sql.catalog import Catalog
from storage.sql.reading import excluded_runs, format_excluded
from stream.errors import BadInput, GyrofleetError, NotFound
from stream.estimators.base import NoEstimate

_LARGEST = 1e50
_STATIONS = """
select s.unit, s.run, any_value(r.station) from signals s join runs r using (run)
where s.signal = $signal and s.unit in (select unnest($units)) and r.station is not null group by s.unit, s.run
"""
GIVEN = Bilingual("as given", "用户给定")
OWN_FITS = Bilingual("the unit's own Allan fits", "产品自身的Allan拟合")


@dataclass(frozen=True)
class Question:
    """A question to a store about units."""

    model: str  # the declared error model as text
    signal: str | None = None  # by default the signal of the model
    block_s: float | None = None  # seconds; by default 30, or the interval of the samples where that is longer
    # by default of each unit's own Allan fits; turn-on scatter not given is estimated
    noise: GivenNoise | ModelNoise | None = None
    holdout: tuple[str, ...] | None = None  # runs to hold out; by default the last third
    runs: tuple[str, ...] | None = None  # by default all
    since_ns: int | None = None  # time of the first sample to use

    @property
    def signal_name(self) -> str:
        """The signal, as given or from the model; BadInput if neither names it, or they differ.

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
    """A unit's runs as blocks, with notes on the reduction, and its declared noise or that of its own Allan fits."""

    runs: tuple[RunBlocks, ...]
    notes: tuple[Note, ...]
    noise: ModelNoise | None
    noise_source: str  # where the noise is from, or why there is none
    left_out: tuple[LeftOut, ...] = ()  # of the record, with its share
    turn_on_is_declared: bool = False  # else it was estimated from these runs
    positions: Mapping[str, float] = field(default_factory=dict)  # number of each word in the channel ``position``
    stations: Mapping[str, str] = field(default_factory=dict)  # of each whole run


@dataclass(frozen=True)
class ReducedUnits:
    """Units with the declared model on the channels of each, and why others could not be read."""

    units: Mapping[str, ReducedUnit]
    models: Mapping[str, ErrorModel]
    failed: Mapping[str, str]


Progress = Callable[[str], None]  # called with a sentence on each stage


def silent(_: str) -> None:
    """Progress that nobody reads."""


class ReadUnits(NamedTuple):
    """Units that were read, the declared model on the channels of each, and the errors of others."""

    units: Mapping[str, ReducedUnit]
    models: Mapping[str, ErrorModel]
    errors: Mapping[str, GyrofleetError]


# as `read_units`, wherever it runs
Read = Callable[[Catalog, Sequence[str], Question, Mapping[str, float], Progress], ReadUnits]


def reduce_units(
    catalog: Catalog, units: Sequence[str], question: Question, *, read: Read | None = None,
    on_progress: Progress = silent,
) -> ReducedUnits:  # fmt: skip
    """Read units of a store as blocks, by default here; a single unit that cannot be read raises."""
    signal, block_s = question.signal_name, question.block_s
    if block_s is None:  # the same for all units
        block_s = usual_block_s(catalog, units, signal, question.runs, BLOCK_S)
    asked = replace(question, block_s=block_s)
    found = (read or read_units)(catalog, units, asked, position_numbers(catalog), on_progress)
    if len(units) == 1:
        for error in found.errors.values():
            raise error
    failed = {unit: str(error) for unit, error in found.errors.items()}
    if not found.units:
        raise NotFound(f"none of {len(units)} units can be diagnosed; {units[0]}: {failed[units[0]]}")
    units_apart, copies = _without_copies(found.units)
    return ReducedUnits(units_apart, found.models, failed | copies)


def _without_copies(units: Mapping[str, ReducedUnit]) -> tuple[dict[str, ReducedUnit], dict[str, str]]:
    """Units without runs that another unit before them has as well, and why units that have no other are left out."""
    copies = copied_runs(run for each in units.values() for run in each.runs)
    kept: dict[str, ReducedUnit] = {}
    failed: dict[str, str] = {}
    for unit, each in units.items():
        runs = tuple(run for run in each.runs if (unit, run.run) not in copies)
        own = {name: of for name, of in copies.items() if name[0] == unit}
        left_out = copies_left_out(own, len(each.runs)) if own else None
        if not runs and left_out is not None:
            failed[unit] = left_out.sentence
            continue
        notes = (*each.notes, *copied_elsewhere(copies, unit))
        losses = each.left_out if left_out is None else (*each.left_out, left_out)
        kept[unit] = replace(each, runs=runs, notes=notes, left_out=losses)
    return kept, failed


def read_units(
    catalog: Catalog, units: Sequence[str], question: Question, positions: Mapping[str, float], on_progress: Progress
) -> ReadUnits:
    """Read units as blocks of the question's length; `positions` are those of the whole store."""
    channels = re.findall(r"\bchannel:(\w+)", question.model)
    reducer = BlockReducer(
        catalog, question.signal_name, block_s=BLOCK_S if question.block_s is None else question.block_s,
        runs=question.runs, since_ns=question.since_ns, channels=channels, positions=positions,
    )  # fmt: skip
    reduced: dict[str, ReducedUnit] = {}
    models: dict[str, ErrorModel] = {}
    errors: dict[str, GyrofleetError] = {}
    each_unit = reducer.reduce_each(units)
    stations: defaultdict[str, dict[str, str]] = defaultdict(dict)
    for name, run, station in catalog.rows(_STATIONS, {"signal": question.signal_name, "units": list(units)}):
        stations[name][run] = station
    for number, unit in enumerate(units, start=1):
        on_progress(f"reading {unit} ({number} of {len(units)})")
        found = next(each_unit)
        try:
            if isinstance(found, GyrofleetError):
                raise found
            runs, left_out = _with_channels_of(question, found.runs)
            losses = (*_excluded(catalog, unit, question, runs), *_lost_runs(found.runs, runs), *found.left_out)
            models[unit] = model_on(question, runs)
            gone = {run for note in left_out for run in note.runs}
            notes = (*left_out, *(each for each in found.notes if not (each.runs and gone.issuperset(each.runs))))
            _check_values(runs)
            noise, source, is_declared = _noise(catalog, runs, models[unit], question)
            reduced[unit] = ReducedUnit(runs, notes, noise, source, losses, is_declared, positions, stations[unit])
        except GyrofleetError as error:
            errors[unit] = error
    return ReadUnits(reduced, models, errors)


def _check_values(runs: Sequence[RunBlocks]) -> None:
    """Refuse numbers whose squares overflow, which only a fill value or a damaged reading has."""
    for run in runs:
        means = {run.signal: run.value, **{name: channel.mean for name, channel in run.channels.items()}}
        for name, mean in means.items():
            known = mean[np.isfinite(mean)]
            if len(known) and float(np.abs(known).max()) > _LARGEST:
                raise BadInput(
                    f"unit {run.unit}, run {run.run}: {name} reaches {float(known[np.abs(known).argmax()]):.3g}, which "
                    "no sensor gives; leave such samples out and import the run again"
                )


def _with_channels_of(question: Question, runs: Sequence[RunBlocks]) -> tuple[tuple[RunBlocks, ...], tuple[Note, ...]]:
    """Runs that have the channels of the model, and a note on the others; all runs where none has them."""
    known = set[str]().union(*(run.channels for run in runs))
    needed = {channel for name in ErrorModel.parse(question.model, known).effects for channel in effect(name).needs}
    kept = tuple(run for run in runs if needed <= set(run.channels))
    others = [run.run for run in runs if not needed <= set(run.channels)]
    if not kept or not others:
        return tuple(runs), ()
    lacking = sorted(channel for channel in needed if any(channel not in run.channels for run in runs))
    where, names = in_runs(others, len(runs)), ", ".join(lacking)
    text = Bilingual(
        f"{where} {names} is missing, which the model needs: left out", f"{where.zh}缺少模型所需的{names}：已略去"
    )
    return kept, (Note("without_channel", text, lacking[0], tuple(others)),)


def _excluded(catalog: Catalog, unit: str, question: Question, kept: Sequence[RunBlocks]) -> tuple[LeftOut, ...]:
    """Runs that people have excluded from evaluation, which are read where the question names them."""
    excluded = {} if question.runs is not None else excluded_runs(catalog, unit)
    if not excluded:
        return ()
    listed = format_excluded(excluded)
    share = len(excluded) / (len(excluded) + len({run.run for run in kept}))
    why = Bilingual(f"they are excluded from evaluation: {listed}", f"已排除，不参与评定：{listed}")
    return (LeftOut(Bilingual("the runs", "试验"), share, why),)


def _lost_runs(every: Sequence[RunBlocks], kept: Sequence[RunBlocks]) -> tuple[LeftOut, ...]:
    """Runs that are left out since the model needs a channel that they lack, as a share of all blocks."""
    blocks = sum(map(len, every))
    gone = blocks - sum(map(len, kept))
    if not gone:
        return ()
    share, runs = gone / blocks, len(every) - len(kept)
    what = Bilingual(f"{blocks:,} blocks", f"{blocks:,}个数据块")
    why = Bilingual(
        f"{runs} of {len(every)} runs lack a channel that the model needs",
        f"{len(every)}次试验中有{runs}次缺少模型所需的通道",
    )
    return (LeftOut(what, share, why, is_grave=share >= GRAVE),)


def model_on(question: Question, runs: Sequence[RunBlocks]) -> ErrorModel:
    """Return the declared model on the channels that all runs have."""
    channels = set.intersection(*(set(run.channels) for run in runs))
    return ErrorModel.parse(question.model, channels).shaped(runs)


def _noise(
    catalog: Catalog, runs: Sequence[RunBlocks], model: ErrorModel, question: Question
) -> tuple[ModelNoise | None, str, bool]:
    """Declared noise, where it comes from, and whether its turn-on scatter is declared."""
    if isinstance(question.noise, ModelNoise):
        return question.noise, GIVEN, True
    if question.noise is not None:
        is_given = question.noise.turn_on is not None
        source = GIVEN if is_given else _with_estimated_turn_on(GIVEN)
        return with_turn_on(question.noise, runs, model), source, is_given
    found = declared_noise(catalog, runs, model)
    if isinstance(found, NoEstimate):
        return None, found.reason, False
    return found, OWN_FITS if len(runs) == 1 else _with_estimated_turn_on(OWN_FITS), False


def _with_estimated_turn_on(source: Bilingual) -> Bilingual:
    return Bilingual(f"{source}; turn-on scatter estimated from these runs", f"{source.zh}；逐次启动散布由这些试验估计")


def units_with(catalog: Catalog, signal: str) -> list[str]:
    """All units of a store that have a signal; NotFound if there is none."""
    sql = "select distinct unit from signals where signal = $signal order by unit"
    units = [str(unit) for (unit,) in catalog.rows(sql, {"signal": signal})]
    if not units:
        known = ", ".join(str(name) for (name,) in catalog.rows("select distinct signal from signals order by signal"))
        raise NotFound(f"no unit of the store has a signal {signal}; there are {known or 'none at all'}")
    return units
