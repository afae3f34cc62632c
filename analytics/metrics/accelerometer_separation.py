"""Misalignment of an accelerometer, separated from the error of its mounting."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from analytics.methods.separation import AccelerometerReading, Separation, accelerometer_separation, separation_rows
from storage.sql.catalog import Catalog
from stream.errors import BadInput, UnknownUnit
from stream.quantities import conversion

HEADER = """\
-- id:        accelerometer_separation
-- en:        Misalignment of an accelerometer by error separation
-- zh:        加速度计失准角误差分离
-- unit:      arcsec
-- better:    lower
-- grain:     unit, signal, run, angle
-- parameters: angle, scale_factor, steps_at_each, rms
-- source:    HIT 2012 (10)-(13)
-- needs:     procedure accelerometer_separation: four angles about the input axis
-- limits:    given
-- equation:  y2 = (V(180) - V(0))/2k, z2 = (V(90) - V(270))/2k, gamma = hypot(y2, z2)
-- k of an output in V is the nominal scale_factor of the product, which for a unit without a gyro is taken per g.
"""
_POSITIONS = {"beta0": 0.0, "beta90": 90.0, "beta180": 180.0, "beta270": 270.0}
_STEPS = """
with gyro as (select distinct run, unit from internal.gyro_steps)
select s.run, s.unit, s.signal, s."procedure", s."index", s.position, s.mean, s.unit_of_measure, s.gravity_m_per_s2,
  regexp_extract(s.position, '^beta(-?[0-9.]+)$', 1)::double as beta,
  case when g.unit is null then p.scale_factor end as per_g,
  case when g.unit is null and p.scale_factor is not null then 'nominal of product ' || s.product
    else 'output is an acceleration' end as scale_source
from step_means s
left join gyro g on g.run = s.run and g.unit = s.unit
left join internal.product_scales p on p.unit = s.unit and p.run = s.run and p.unit_of_measure = s.unit_of_measure
where regexp_full_match(s.position, 'beta-?[0-9.]+') and s.n > 0
  and regexp_matches(s.signal, '^acc(el(eration|erometer)?)?(_|$)')
order by s.run, s.unit, s.signal, s."procedure", s."index"
"""


def compute(catalog: Catalog) -> Iterator[dict[str, Any]]:
    """Rows of the metric: y2, z2 and gamma."""
    yield from separation_rows(catalog, _STEPS, _POSITIONS, lambda _: None, _separated)


def _separated(rows: Sequence[Mapping[str, Any]]) -> Separation:
    return accelerometer_separation([AccelerometerReading(row["beta"], row["mean"]) for row in rows], _per_g(rows[0]))


def _per_g(row: Mapping[str, Any]) -> float:
    """Scale factor, output per local g; where the local g is unknown, per standard g."""
    measure, gravity = row["unit_of_measure"], row["gravity_m_per_s2"]
    try:
        per_standard_g = 1 / conversion(measure, "g_0")[0]
        return per_standard_g if gravity is None else per_standard_g * gravity * conversion("m/s^2", "g_0")[0]
    except UnknownUnit as error:
        if row["per_g"]:
            return float(row["per_g"])
        how = "give the nominal one of the product, per g, or import the output in g_0"
        raise BadInput(f"no scale factor for an output in {measure}: {how}") from error
