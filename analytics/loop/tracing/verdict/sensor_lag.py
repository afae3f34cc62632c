"""The lag of a thermometer as an alternative to what it imitates."""

from collections.abc import Sequence

import msgspec

from analytics.loop.effects.registry import effect
from analytics.loop.effects.temperature import MOST_SENSOR_LAG_S, SENSOR_LAG
from analytics.loop.tracing.result.diagnosis_result import ConfoundedEffect, FoundEffect
from analytics.loop.tracing.search.effect_search import Search
from analytics.loop.tracing.search.screening import effect_columns
from analytics.loop.tracing.verdict.effect_findings import unfitted
from analytics.loop.tracing.whitening.joint_fit import fit_jointly

TIME_OFFSET, TEMPERATURE_RATE, THERMAL_LAG = "temperature_time_offset", "temperature_rate", "thermal_lag"
_LEAD = 12.0  # lead of the thermal lag in chi-square from which the data separate the two


def with_sensor_lag(effects: Sequence[FoundEffect], kept: Search) -> tuple[FoundEffect, ...]:
    """The findings, with the lag of the temperature sensor as an alternative where it does the same.

    The lag of a thermometer shifts what a coefficient of the temperature predicts as a late clock does: it is one where
    a time offset of plausible size is. It leaves the second derivative of the temperature beside an effect of its rate,
    which a thermal lag resembles.
    """
    rival = _beside_rate(kept)
    return tuple(
        _with(each, rival)
        if each.name == THERMAL_LAG
        else _with(each, next(filter(None, map(_late, each.confounded)), None))
        for each in effects
    )


def _with(found: FoundEffect, rival: ConfoundedEffect | None) -> FoundEffect:
    if rival is None:
        return found
    return msgspec.structs.replace(found, confounded=(*found.confounded, rival))


def _late(other: ConfoundedEffect) -> ConfoundedEffect | None:
    """A lag in place of a time offset; None of another alternative, or of one beyond the lag of a thermometer."""
    if other.name != TIME_OFFSET or other.implied is None or other.implied > MOST_SENSOR_LAG_S:
        return None
    rival = unfitted(effect(SENSOR_LAG), recorded=True, evidence_behind=other.evidence_behind)
    return msgspec.structs.replace(rival, implied=other.implied, most=MOST_SENSOR_LAG_S, implied_unit="s")


def _beside_rate(kept: Search) -> ConfoundedEffect | None:
    """A lag of the sensor in place of a thermal lag beside an effect of the rate of temperature; None if it is none."""
    names = [each.name for each in kept.common]
    if not {TEMPERATURE_RATE, THERMAL_LAG} <= set(names):
        return None
    rest = kept.without([THERMAL_LAG])
    lag = next(each for each in kept.common if each.name == THERMAL_LAG)
    at = next(each for each in rest.common if each.name == TEMPERATURE_RATE)
    records, base = rest.joint.records, rest.joint.hypothesis
    own = [effect_columns(record.stack, effect(SENSOR_LAG), {}) for record in records]
    as_thermal, as_sensor = (
        fit_jointly(records, base.with_common(columns), rest.joint.noises) for columns in (lag.fitted.columns, own)
    )
    behind = 2.0 * (as_thermal.log_likelihood - as_sensor.log_likelihood)
    of_rate, of_slope = (float(as_sensor.common.coefficients[each]) for each in (rest.common_columns(at).start, -1))
    if behind > _LEAD or not of_slope * of_rate > 0:
        return None
    rival = unfitted(effect(SENSOR_LAG), recorded=True, evidence_behind=behind)
    return msgspec.structs.replace(rival, implied=of_slope / of_rate, most=MOST_SENSOR_LAG_S, implied_unit="s")
