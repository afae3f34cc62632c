"""Misalignment of a gyro, separated from the errors of fixture and table."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from analytics.methods.separation import GyroReading, Separation, gyro_separation, separation_rows
from storage.sql.catalog import Catalog

HEADER = """\
-- id:        gyro_separation
-- en:        Misalignment of a gyro by error separation
-- zh:        陀螺仪失准角误差分离
-- unit:      arcsec
-- better:    lower
-- grain:     unit, signal, run, angle
-- parameters: angle, scale_factor, steps_at_each, rms
-- source:    HIT 2012 (2)-(9)
-- needs:     procedure gyro_separation: five positions of gyro and fixture, whole turns of the table in both directions
-- limits:    given
-- equation:  V = V0 - k y0 w cos(b) + k x0 w sin(b) - k y1 w + k z2 w sin(a) - k y2 w cos(a), gamma = hypot(y2, z2)
"""
# alpha, beta in degrees
_POSITIONS = {
    "alpha0_beta0": (0.0, 0.0),
    "alpha0_beta180": (0.0, 180.0),
    "alpha180_beta180": (180.0, 180.0),
    "alpha90_beta180": (90.0, 180.0),
    "alpha0_beta90": (0.0, 90.0),
}
_STEPS = """
select run, unit, signal, "procedure", "index", position, mean, input_rate, deg_per_h,
  coalesce(scale_source, 'unknown') as scale_source, unit_of_measure,
  regexp_extract(position, '^alpha(-?[0-9.]+)_beta', 1)::double as alpha,
  regexp_extract(position, '_beta(-?[0-9.]+)$', 1)::double as beta
from rate_steps
where regexp_full_match(position, 'alpha-?[0-9.]+_beta-?[0-9.]+') and n > 0 and input_rate <> 0
order by run, unit, signal, "procedure", "index"
"""


def compute(catalog: Catalog) -> Iterator[dict[str, Any]]:
    """Rows of the metric: y0 and x0 of the table, y1 of the fixture, y2, z2 and gamma of the gyro."""
    yield from separation_rows(catalog, _STEPS, _POSITIONS, _lack, _separated)


def _lack(rows: Sequence[Mapping[str, Any]]) -> str | None:
    if rows[0]["deg_per_h"] is None:
        how = "measure it or give the nominal one of the product"
        return f"no scale factor for an output in {rows[0]['unit_of_measure']}: {how}"
    for position in _POSITIONS:
        if len({row["input_rate"] > 0 for row in rows if row["position"] == position}) < 2:
            return f"position {position} was turned one way only, the method turns it forwards and backwards"
    return None


def _separated(rows: Sequence[Mapping[str, Any]]) -> Separation:
    readings = [GyroReading(row["alpha"], row["beta"], row["input_rate"], row["mean"]) for row in rows]
    return gyro_separation(readings, 3600.0 / rows[0]["deg_per_h"])
