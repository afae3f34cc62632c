"""The same trace over several units: a common effect too small for one of them, and which units differ."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from scipy import stats

from analytics.loop.blocks.left_out import LeftOut
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Kind
from analytics.loop.effects.registry import effects_for
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.tracing.candidates import candidates_for
from analytics.loop.tracing.diagnosis import FIRST_TIER, Case, case_of, diagnose, verdict_of
from analytics.loop.tracing.evidence import by_replicate
from analytics.loop.tracing.findings import findings
from analytics.loop.tracing.held_out_set import judge, open_held_out_set
from analytics.loop.tracing.line_scan import amplitude_of
from analytics.loop.tracing.partial_channels import denied
from analytics.loop.tracing.record import Record
from analytics.loop.tracing.result import Diagnosis, FoundEffect, Holdout, Verdict
from analytics.loop.tracing.selection import Search, Selected, own_fit, search
from stream.batch import FloatArray

FALSE_DISCOVERIES = 0.05
TESTS_IN_A_SEARCH = 50
"""A search for what is missing in one unit is itself about so many independent tests."""


class UnitCoefficient(msgspec.Struct, frozen=True):
    """A common effect in one unit.

    Parameters
    ----------
    unit: The unit.
    coefficient, se: Its own first coefficient and the standard error.
    p_value: Of the test that it is that of the other units.
    differs: Whether it is not, by Benjamini and Hochberg over all units.
    """

    unit: str
    coefficient: float
    se: float
    p_value: float
    differs: bool


class FleetDiagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of a trace over several units.

    Parameters
    ----------
    verdict: Of what all units have in common.
    effects: What all units lack, confirmed by the held-out runs of all.
    unreplicated: What the held-out runs refused, and jumps, which are of one run of one unit.
    holdout: What they say.
    by_unit: Each common effect in each unit, by the name of the effect.
    units: The trace of each unit alone.
    own_findings: Units in which a trace of that unit alone finds something that stands among so many units (Benjamini
        and Hochberg), and what.
    limits: What the reader has to know.
    """

    verdict: Verdict
    effects: tuple[FoundEffect, ...]
    unreplicated: tuple[FoundEffect, ...]
    holdout: Holdout | None
    by_unit: dict[str, tuple[UnitCoefficient, ...]]
    units: dict[str, Diagnosis]
    own_findings: dict[str, tuple[str, ...]]
    limits: tuple[str, ...] = ()

    def document(self) -> dict[str, Any]:
        """Return it as it stands in JSON."""
        return {
            "verdict": self.verdict.value,
            "effects": [each.document() for each in self.effects],
            "unreplicated": [each.document() for each in self.unreplicated],
            "holdout": None if self.holdout is None else msgspec.to_builtins(self.holdout),
            "by_unit": msgspec.to_builtins(self.by_unit),
            "units": {unit: each.document() for unit, each in self.units.items()},
            "own_findings": {unit: list(names) for unit, names in self.own_findings.items()},
            "limits": list(self.limits),
        }

    def to_json(self) -> str:
        """Return it as JSON."""
        return msgspec.json.encode(self.document()).decode()


def diagnose_fleet(
    units: Mapping[str, Sequence[RunBlocks]],
    model: ErrorModel,
    *,
    effects: Mapping[str, Effect] | None = None,
    declared_noise: Mapping[str, NoiseCoefficients] | None = None,
    holdout: Mapping[str, Sequence[str]] | None = None,
    left_out: Mapping[str, Sequence[LeftOut]] | None = None,
    seed: int = 0,
    told: Callable[[str], None] = lambda _: None,
) -> FleetDiagnosis:
    """Find what a declared error model lacks in all units together, and in each.

    Parameters
    ----------
    units: Runs of the same signal, by unit.
    model: The declared model; each unit has coefficients of its own.
    effects: What to look for; by default all effects that find their channels in all units.
    declared_noise: Noise of the units.
    holdout: Runs of each unit that are held out; by default, and of a unit that is not named, the last third.
    left_out: What the reduction left out of each unit's record.
    seed: Of the draws that give the number of independent tests.
    told: Called with a sentence on each stage.
    """
    noises, held_out, losses = declared_noise or {}, holdout or {}, left_out or {}
    alone: dict[str, Diagnosis] = {}
    for number, (unit, runs) in enumerate(units.items(), start=1):
        told(f"tracing {unit} ({number} of {len(units)})")
        alone[unit] = diagnose(
            runs,
            model,
            effects=effects,
            declared_noise=noises.get(unit),
            holdout=held_out.get(unit),
            left_out=losses.get(unit, ()),
            seed=seed,
        )
    enough = [unit for unit in units if alone[unit].model is not None]
    cases = [case_of(units[unit], model, noises.get(unit), held_out.get(unit)) for unit in enough]
    limits = [f"unit {unit}: {each}" for unit in units for each in alone[unit].missing[:1]]
    if len(cases) < 2:
        return FleetDiagnosis(
            verdict=Verdict.NOT_ENOUGH_DATA,
            effects=(),
            unreplicated=(),
            holdout=None,
            by_unit={},
            units=alone,
            own_findings=standing(alone),
            limits=(*limits, f"{len(cases)} units with enough data, 2 are needed to pool"),
        )
    told(f"searching for what {len(cases)} units have in common")
    records = [case.training for case in cases]
    available = effects_for([run for case in cases for run in case.stack.runs]) if effects is None else effects
    lost = {name: why for case in cases for name, why in case.report.lost_channels.items()}
    candidates = candidates_for(records, available, model, FIRST_TIER, lost)
    found = search(records, candidates, np.random.default_rng(seed))
    held = _asked(cases, records, found)
    every = [
        msgspec.structs.replace(each, confirmed=None if held is None else held.confirms(each.name))
        for each in findings(records, candidates, found)
    ]
    kept = tuple(each for each in every if each.replicates and each.confirmed is not False)
    gone = tuple(each for each in every if not each.replicates or each.confirmed is False)
    verdict = verdict_of(kept, gone, is_excess=False, within_run=False)
    return FleetDiagnosis(
        verdict=denied(verdict, [each for unit in enough for each in alone[unit].left_out]),
        effects=kept,
        unreplicated=gone,
        holdout=held,
        by_unit={
            each.fitted_candidate.name: _by_unit(records, found, each)
            for each in found.selected
            if each.is_common or each.fitted_candidate.kind is Kind.LINE
        },
        units=alone,
        own_findings=standing(alone),
        limits=tuple(limits),
    )


def _asked(cases: Sequence[Case], records: Sequence[Record], found: Search) -> Holdout | None:
    """What the held-out runs of all units say; units without held-out runs say nothing."""
    if not found.selected:
        return None
    boxes = [
        open_held_out_set(case.stack, case.stack.of_replicates(case.held_out), record, found, number)
        for number, (case, record) in enumerate(zip(cases, records, strict=True))
        if case.held_out
    ]
    names = [f"{record.unit} {name}" for case, record in zip(cases, records, strict=True) for name in case.held_out]
    return judge(boxes, records, found, names) if boxes else None


def _by_unit(records: Sequence[Record], found: Search, which: Selected) -> tuple[UnitCoefficient, ...]:
    """First coefficient of a common effect, or amplitude of a line, in each unit; whether it is that of the others."""
    if which.is_common:
        column = found.common_columns(which).start
        whole = [np.zeros(len(record), dtype=np.int64) for record in records]
        pairs = by_replicate(found.joint, whole, column)
        information = np.array([float(each[0]) for each, _ in pairs])
        product = np.array([float(each[0]) for _, each in pairs])
    else:
        amplitudes = [amplitude_of(*own_fit(found, which, [number])) for number in range(len(records))]
        information = np.array([error**-2 for _, error in amplitudes])
        product = information * np.array([amplitude for amplitude, _ in amplitudes])
    told = [number for number, each in enumerate(information) if each > 1e-6 * information.sum()]
    own = {number: product[number] / information[number] for number in told}
    p_values = {number: _unlike_others(number, information, product) for number in told}
    chosen = benjamini_hochberg(p_values)
    return tuple(
        UnitCoefficient(
            records[number].unit,
            float(own[number]),
            float(information[number] ** -0.5),
            p_values[number],
            number in chosen,
        )
        for number in told
    )


def _unlike_others(number: int, information: FloatArray, product: FloatArray) -> float:
    others = float(information.sum() - information[number])
    if others <= 0:
        return 1.0
    mean = float(product.sum() - product[number]) / others
    apart = product[number] / information[number] - mean
    return float(2 * stats.norm.sf(abs(apart) / np.sqrt(1 / information[number] + 1 / others)))


def standing(alone: Mapping[str, Diagnosis]) -> dict[str, tuple[str, ...]]:
    """Findings of single units that stand among so many units.

    Examples
    --------
    >>> standing({})
    {}
    """
    p_values = dict.fromkeys(alone, 1.0)
    for unit, found in alone.items():
        if found.effects:
            largest = max(each.significance for each in found.effects)
            p_values[unit] = min(1.0, TESTS_IN_A_SEARCH * float(stats.chi2.sf(largest**2, 1)))
    return {unit: alone[unit].names for unit in benjamini_hochberg(p_values)}


def benjamini_hochberg(p_values: Mapping[Any, float], rate: float = FALSE_DISCOVERIES) -> list[Any]:
    """Keys whose p-values stand at a rate of false discoveries.

    Examples
    --------
    >>> benjamini_hochberg({"a": 0.001, "b": 0.02, "c": 0.9, "d": 0.8})
    ['a', 'b']
    """
    ordered = sorted(p_values, key=lambda key: p_values[key])
    passing = [n for n, key in enumerate(ordered, start=1) if p_values[key] <= rate * n / len(ordered)]
    return ordered[: max(passing, default=0)]
