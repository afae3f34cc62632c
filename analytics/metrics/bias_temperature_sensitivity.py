"""Bias temperature sensitivity: the steepest change of the bias from room temperature to any other."""

from collections.abc import Iterator
from typing import Any

from analytics.methods.largest_magnitude import largest_magnitudes
from storage.sql.catalog import Catalog

HEADER = """\
-- id:        bias_temperature_sensitivity
-- en:        Bias temperature sensitivity
-- zh:        零偏温度灵敏度
-- unit:      deg/h/degC
-- better:    lower
-- grain:     unit, signal, run
-- parameters: room_temperature_deg_c, temperature_source, points
-- parameters: position, repeat, scale_factor, temperature_deg_c_of_largest
-- source:    GJB 2426A-2004 5.12.4 (22); JJF 2014-2022 7.2.16 (31)
-- needs:     procedure bias_temperature_sensitivity: static steps at several temperatures, one of them room temperature
-- limits:    given
-- equation:  Bt = max_i abs((B0_i - B0_room)/(T_i - T_room))
"""

_SQL = """
select unit, signal, run, "procedure", position, again, all_n as n, [run] as runs, all_steps as steps, lack as reason,
  slope as difference, u, freedom, round(temperature, 2) as temperature_deg_c,
  {
    room_temperature_deg_c: round(room_temperature, 2), temperature_source: temperature_source, points: points,
    position: position, repeat: again, scale_factor: scale_source
  } as parameters
from internal.bias_temperature_points
order by run, unit, signal, "procedure", position, again, "index"
"""


def compute(catalog: Catalog) -> Iterator[dict[str, Any]]:
    """Rows of the metric.

    A maximum has no symmetric error: the limits are those of `largest_magnitudes`, over all points together. Standard
    uncertainty and freedom are those of the steepest point. The thermometer's own error is not in it.
    """
    rows = catalog.reader(_SQL).read_all().to_pylist()
    keys = ["run", "unit", "signal", "procedure", "position", "again"]
    yield from largest_magnitudes(rows, keys, of="temperature_deg_c")
