"""Diagnosed units of simulated campaigns, for tests of reports."""

from functools import cache
from typing import Any

import msgspec

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.notes.reduction_notes import Note
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.residuals import Residuals, residuals_of
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.fleet import significant_findings
from analytics.loop.tracing.result.diagnosis_result import EffectCoefficient, FoundEffect
from analytics.loop.unit_diagnosis import UnitDiagnosis, UnitsDiagnosis
from analytics.loop.unit_reduction import GIVEN, ReducedUnit
from tests.bench.loop_campaign import DECLARED_MODEL, Campaign, Planted

SHUPE = 40.0  # deg/h per degC/s
SQUARE = 2e-3  # deg/h/degC^2
NOISE = ModelNoise(N=0.005, B=0.02, K=0.01, turn_on=0.3)
REMARK, LIMIT = Bilingual("a <remark>", "a <remark> 备注"), Bilingual("a limit", "a limit 局限")


@cache
def diagnosed(name: str = "temperature_rate", size: float = SHUPE) -> UnitDiagnosis:
    """Nine runs of two hours with one effect that was not declared."""
    campaign = Campaign(3, runs=9, types=("temperature", "rate", "static"), duration_s=7200.0, step_s=5.0)
    runs = tuple(campaign.runs([Planted(name, [size])] if size else [], channels=("input_rate", "temperature")))
    found = diagnose(runs, ErrorModel.parse(DECLARED_MODEL), declared_noise=NOISE)
    notes = (
        Note("counts", REMARK, "temperature"),
        Note("output", Bilingual("a limit", "a limit 局限"), None, (), is_limit=True),
    )
    return UnitDiagnosis(ReducedUnit(runs, notes, NOISE, GIVEN), found)


def left(found: UnitDiagnosis) -> Residuals:
    residuals = residuals_of(found.data.runs, found.diagnosis)
    assert residuals is not None
    return residuals


def as_units(*found: UnitDiagnosis) -> UnitsDiagnosis:
    units = {each.unit: each for each in found}
    return UnitsDiagnosis(units, {}, significant_findings({unit: each.diagnosis for unit, each in units.items()}))


def a_finding(**more: Any) -> FoundEffect:
    coefficient = EffectCoefficient("", 14.5, 13.2, 15.8, "deg/h/(degC/s)")
    head = FoundEffect("temperature_rate", {}, (coefficient,), 13.4, 170.0, {"temperature": "cause"})
    return msgspec.structs.replace(head, **more)
