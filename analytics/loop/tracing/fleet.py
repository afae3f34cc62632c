"""The diagnosis of several units: effects common to all, too small for one unit, and the units that differ."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.notes.left_out import LeftOut
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, EffectKind
from analytics.loop.effects.registry import effects_for
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.case import Case, case_of
from analytics.loop.tracing.diagnosis import FIRST_TIER, Asked, diagnosed
from analytics.loop.tracing.held_out.held_out_set import HeldOutSet, judge, open_held_out_set
from analytics.loop.tracing.held_out.run_walk import against_walk
from analytics.loop.tracing.processors import Spread, by_processes, of_records
from analytics.loop.tracing.random_effect import RandomEffect, presence, random_effect
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, FoundEffect, ModelVerdict
from analytics.loop.tracing.result.holdout import Holdout
from analytics.loop.tracing.search.effect_search import Search, Selected, search
from analytics.loop.tracing.search.event_scans import amplitude_of
from analytics.loop.tracing.search.evidence import by_replicate
from analytics.loop.tracing.search.screening import candidates_for
from analytics.loop.tracing.verdict.conclusion import denied, verdict_of
from analytics.loop.tracing.verdict.effect_findings import findings
from analytics.loop.tracing.verdict.noise_agreement import NOISE_P_VALUE
from analytics.methods.distributions import chi_square_sf, normal_sf
from stream.batch import FloatArray

FALSE_DISCOVERIES = 0.05
_SEVERAL_BY_CHANCE = 0.05  # probability below which the units with more noise than declared are not by chance
TESTS_IN_A_SEARCH = 50  # approximate number of independent tests in the search of one unit


class UnitCoefficient(msgspec.Struct, frozen=True):
    """A common effect in one unit."""

    unit: str
    coefficient: float  # the first of this unit
    se: float  # its standard error
    p_value: float  # of the test that it equals that of the other units
    differs: bool  # Benjamini and Hochberg over all units
    presence: float = 0.5  # probability that this unit has it as the others do, not none; even odds beforehand


class FleetDiagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """The diagnosis of several units together."""

    verdict: ModelVerdict  # unreplicated or unexplained where only single units lack something
    effects: tuple[FoundEffect, ...] = ()  # that all units lack, confirmed by the held-out runs of all
    # refused by the held-out runs, and jumps, which are of one run of one unit
    unreplicated: tuple[FoundEffect, ...] = ()
    holdout: Holdout | None = None
    by_unit: dict[str, tuple[UnitCoefficient, ...]] = {}  # each common effect in each unit, by its name
    over_units: dict[str, RandomEffect] = {}  # mean and spread of each common effect over units, by its name
    units: dict[str, Diagnosis]  # the diagnosis of each unit alone
    own_findings: dict[str, tuple[str, ...]]  # of single units, at a false discovery rate of 5 %
    limits: tuple[Bilingual, ...] = ()  # caveats

    def document(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "verdict": self.verdict.value,
            "effects": [each.document() for each in self.effects],
            "unreplicated": [each.document() for each in self.unreplicated],
            "holdout": None if self.holdout is None else msgspec.to_builtins(self.holdout),
            "by_unit": msgspec.to_builtins(self.by_unit),
            "over_units": msgspec.to_builtins(self.over_units),
            "units": {unit: each.document() for unit, each in self.units.items()},
            "own_findings": {unit: list(names) for unit, names in self.own_findings.items()},
            "limits": [str(each) for each in self.limits],
        }


def diagnose_fleet(
    units: Mapping[str, Sequence[RunBlocks]],
    model: ErrorModel,
    *,
    effects: Mapping[str, Effect] | None = None,
    declared_noise: Mapping[str, ModelNoise] | None = None,
    holdout: Mapping[str, Sequence[str]] | None = None,
    left_out: Mapping[str, Sequence[LeftOut]] | None = None,
    turn_on_is_declared: Mapping[str, bool] | None = None,
    seed: int = 0,
    processes: int = 1,
    spread: Spread | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
) -> FleetDiagnosis:
    """Find effects that a declared error model lacks in all units together, and in each.

    Each unit has its own coefficients of the declared model; the effects to test are by default all whose channels are
    recorded in all units. The units alone are traced by several `processes`, or by `spread`. For `declared_noise`,
    `holdout`, `left_out` and `turn_on_is_declared`, by unit, see `diagnose`; all units together are searched as if the
    turn-on scatter were declared, since evidence from the biases of few runs is calibrated for single units only.
    """
    noises, held_out, losses, declared = declared_noise or {}, holdout or {}, left_out or {}, turn_on_is_declared or {}
    asked = [
        Asked(
            runs, model, effects=effects, declared_noise=noises.get(unit), holdout=held_out.get(unit),
            left_out=losses.get(unit, ()), seed=seed, turn_on_is_declared=declared.get(unit),
        )
        for unit, runs in units.items()
    ]  # fmt: skip
    alone: dict[str, Diagnosis] = {}
    answers = by_processes(diagnosed, asked, processes) if spread is None else spread(diagnosed, asked)
    for number, unit in enumerate(units, start=1):
        on_progress(f"tracing {unit} ({number} of {len(units)})")
        alone[unit] = next(answers)
    own_findings = significant_findings(alone)
    enough = [unit for unit in units if alone[unit].model is not None]
    lacking = [(unit, each) for unit in units for each in alone[unit].missing[:1]]
    limits = [Bilingual(f"unit {unit}: {each}", f"产品{unit}：{each.zh}") for unit, each in lacking]
    if (count := len(enough)) < 2:
        few = Bilingual(
            f"{count} units have enough data; 2 are needed to pool them", f"数据足够的产品有{count}个，合并分析需要2个"
        )
        verdict = ModelVerdict.NOT_ENOUGH_DATA
        return FleetDiagnosis(verdict=verdict, units=alone, own_findings=own_findings, limits=(*limits, few))

    def case(number: int) -> Case:
        unit = enough[number]
        return case_of(units[unit], model, noises.get(unit), held_out.get(unit))

    cases = of_records(case, len(enough))
    on_progress(f"searching for effects common to {len(cases)} units")
    records = [case.training for case in cases]
    available = effects_for([run for case in cases for run in case.stack.runs]) if effects is None else effects
    lost = {name: why for case in cases for name, why in case.report.lost_channels.items()}
    early = {name: each for name, each in available.items() if not each.is_late_in_one_run}
    candidates = candidates_for(records, early, model, FIRST_TIER, lost)
    found = search(candidates, np.random.default_rng(seed))
    answer = _held_out(cases, found)
    every = [
        msgspec.structs.replace(each, confirmed=None if answer is None else answer.confirms(each.name))
        for each in findings(candidates, found)
    ]
    kept = tuple(each for each in every if each.replicates and each.confirmed is not False)
    gone = tuple(each for each in every if not each.replicates or each.confirmed is False)
    walks = [each for each in kept if answer is not None and answer.may_be_walk(each.name)]
    certain = [each for each in kept if each not in walks]
    verdict = _beside_units(
        verdict_of(certain, (*gone, *walks), is_excess=False, within_run=False), alone, own_findings
    )
    by_unit = {
        each.name: _by_unit(found, each)
        for each in found.selected
        if each.is_common or each.fitted.effect.kind is EffectKind.LINE
    }
    over_units = {name: random_effect(*_values(rows)) for name, rows in by_unit.items()}
    return FleetDiagnosis(
        verdict=denied(verdict, [each for unit in enough for each in alone[unit].left_out]),
        effects=kept,
        unreplicated=gone,
        holdout=answer,
        by_unit=by_unit,
        over_units={name: each for name, each in over_units.items() if each is not None},
        units=alone,
        own_findings=own_findings,
        limits=tuple(limits),
    )


def _beside_units(
    verdict: ModelVerdict, alone: Mapping[str, Diagnosis], own_findings: Mapping[str, tuple[str, ...]]
) -> ModelVerdict:
    """The verdict; where nothing is missing in common, what the units by themselves leave of that."""
    if verdict is not ModelVerdict.NOTHING_MISSING:
        return verdict
    if own_findings:
        return ModelVerdict.UNREPLICATED
    noisy = sum(each.verdict is ModelVerdict.UNEXPLAINED for each in alone.values())
    by_chance = 1.0 - math.exp(-NOISE_P_VALUE * len(alone)) * math.fsum(
        (NOISE_P_VALUE * len(alone)) ** count / math.factorial(count) for count in range(noisy)
    )
    return ModelVerdict.UNEXPLAINED if noisy and by_chance < _SEVERAL_BY_CHANCE else verdict


def _held_out(cases: Sequence[Case], found: Search) -> Holdout | None:
    """The answer of the held-out runs of all units that have any."""
    if not found.selected:
        return None
    having = [number for number, case in enumerate(cases) if case.held_out]

    def box(place: int) -> HeldOutSet:
        case = cases[having[place]]
        return open_held_out_set(case.stack, case.held_out_blocks, case.training, found, having[place])

    boxes = of_records(box, len(having))
    names = [f"{case.training.unit} {name}" for case in cases for name in case.held_out]
    return against_walk(judge(boxes, found, names), boxes, found) if boxes else None


def _by_unit(found: Search, which: Selected) -> tuple[UnitCoefficient, ...]:
    """First coefficient of a common effect, or amplitude of a line, in each unit, compared with the others."""
    records = found.joint.records
    if which.is_common:
        column = found.common_columns(which).start
        whole = [np.zeros(len(record), dtype=np.int64) for record in records]
        pairs = by_replicate(found.joint, whole, column)
        information = np.array([float(each[0]) for each, _ in pairs])
        product = np.array([float(each[0]) for _, each in pairs])
    else:
        amplitudes = [amplitude_of(*found.own_fit(which, [number])) for number in range(len(records))]
        information = np.array([error**-2 for _, error in amplitudes])
        product = information * np.array([amplitude for amplitude, _ in amplitudes])
    excited = [number for number, each in enumerate(information) if each > 1e-6 * information.sum()]
    p_values = {number: _unlike_others(number, information, product) for number in excited}
    chosen = benjamini_hochberg(p_values)
    values, errors = product[excited] / information[excited], information[excited] ** -0.5
    return tuple(
        UnitCoefficient(
            records[number].unit, float(values[at]), float(errors[at]), p_values[number], number in chosen,
            presence(at, values, errors),
        )
        for at, number in enumerate(excited)
    )  # fmt: skip


def _values(rows: Sequence[UnitCoefficient]) -> tuple[FloatArray, FloatArray]:
    return np.array([each.coefficient for each in rows]), np.array([each.se for each in rows])


def _unlike_others(number: int, information: FloatArray, product: FloatArray) -> float:
    others = float(information.sum() - information[number])
    if others <= 0:
        return 1.0
    mean = float(product.sum() - product[number]) / others
    apart = product[number] / information[number] - mean
    return float(2 * normal_sf(abs(apart) / np.sqrt(1 / information[number] + 1 / others)))


def significant_findings(alone: Mapping[str, Diagnosis]) -> dict[str, tuple[str, ...]]:
    """Findings of single units that are significant among so many units."""
    p_values = dict.fromkeys(alone, 1.0)
    for unit, found in alone.items():
        if found.effects:
            largest = max(each.significance for each in found.effects)
            p_values[unit] = min(1.0, TESTS_IN_A_SEARCH * float(chi_square_sf(largest**2, 1)))
    return {unit: alone[unit].names for unit in benjamini_hochberg(p_values)}


def benjamini_hochberg(p_values: Mapping[Any, float], rate: float = FALSE_DISCOVERIES) -> list[Any]:
    """Keys whose p-values are significant at a false discovery rate.

    >>> benjamini_hochberg({"a": 0.001, "b": 0.02, "c": 0.9, "d": 0.8})
    ['a', 'b']
    """
    ordered = sorted(p_values, key=lambda key: p_values[key])
    passing = [n for n, key in enumerate(ordered, start=1) if p_values[key] <= rate * n / len(ordered)]
    return ordered[: max(passing, default=0)]
