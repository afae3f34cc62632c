"""Power consumption of a unit from each of its supplies."""

from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import Any

import numpy as np
import pyarrow as pa

from analytics.step_records.series_statistics import samples_statistics
from storage.sql.catalog import Catalog
from stream.batch import FloatArray, IntArray

_READINGS = """
select w.which, s.signal, list(s.t_ns order by s.t_ns) as t_ns, list(s.value order by s.t_ns) as values
from internal.power_windows w
join internal.samples_in($paths) s
  on s.run = w.run and s.unit = w.supply and s.t_ns between w.t_from_ns and w.t_to_ns
where s.run = $run and s.signal in ('supply_voltage', 'supply_current')
group by w.which, s.signal
"""

_Readings = Mapping[str, tuple[IntArray, FloatArray]]


def compute(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric; an instrument reads voltage and current in turn, see `watts`."""
    steps = catalog.reader(sql).read_all().to_pylist()
    for run, group in groupby(steps, key=lambda step: step["run"]):
        of_run = list(group)
        columns = ("run", "supply", "t_from_ns", "t_to_ns")
        windows = [{"which": at, **{name: step[name] for name in columns}} for at, step in enumerate(of_run)]
        catalog.put("power_windows", pa.Table.from_pylist(windows))
        readings: dict[int, dict[str, tuple[IntArray, FloatArray]]] = {}
        given = {"run": run, "paths": catalog.checked_paths_of([run], _READINGS)}
        for row in catalog.reader(_READINGS, given).read_all().to_pylist():
            series = np.array(row["t_ns"], np.int64), np.array(row["values"], np.float64)
            readings.setdefault(row["which"], {})[row["signal"]] = series
        for at, step in enumerate(of_run):
            yield _row(step, readings.get(at, {}))


def _row(step: Mapping[str, Any], readings: _Readings) -> dict[str, Any]:
    row = {**step, "signal": "supply_power", "n": 0, "steps": [step["index"]]}
    row["parameters"] = {"supply": step["supply"], "step": step["step"]}
    if (reason := _lack(step, readings)) is not None:
        return row | {"reason": reason}
    power, t_ns = watts(*readings["supply_voltage"], *readings["supply_current"])
    if not len(power):
        return row | {"reason": f"supply {step['supply']}: no current was read within an interval of a voltage"}
    found = samples_statistics(t_ns, power, (step["t_from_ns"], step["t_to_ns"]))
    u = None if np.isnan(found.standard_uncertainty) else found.standard_uncertainty
    return row | {"n": found.n, "value": found.mean, "standard_uncertainty": u, "freedom": found.freedom}


def _lack(step: Mapping[str, Any], readings: _Readings) -> str | None:
    if step["supply"] is None:
        named = f"the supply {step['named']} of its mounting" if step["named"] else "any supply"
        return f"the run has no supply_voltage and supply_current of the unit or of {named}"
    if not step["is_own"]:
        return (
            f"supply {step['supply']} fed {step['units']} units at once: mount one, or say whose it is by the word "
            "power where the units are mounted"
        )
    if not (step["has_voltage"] and step["has_current"]):
        return f"supply {step['supply']}: supply_voltage in V and supply_current in A are needed, both"
    if len(readings) < 2:
        return f"supply {step['supply']}: no reading of voltage and current in the step"
    return None


def watts(volt_ns: IntArray, volts: FloatArray, amp_ns: IntArray, amps: FloatArray) -> tuple[FloatArray, IntArray]:
    """Each voltage times the current read nearest to it, at most an interval of the currents away; with the times.

    >>> power, t_ns = watts(np.array([0, 10, 90]), np.array([5.0, 6.0, 5.0]), np.array([1, 11, 21]),
    ...                     np.array([0.1, 0.2, 0.3]))
    >>> power.round(3).tolist(), t_ns.tolist()
    ([0.5, 1.2], [0, 10])
    """
    last = len(amp_ns) - 1
    after = np.minimum(np.clip(np.searchsorted(amp_ns, volt_ns), 1, max(last, 1)), last)
    before = np.maximum(after - 1, 0)
    is_before = volt_ns - amp_ns[before] <= amp_ns[after] - volt_ns
    nearest = np.where(is_before, before, after)
    most_ns = float(np.median(np.diff(amp_ns))) if last else float(np.iinfo(np.int64).max)
    near = np.abs(amp_ns[nearest] - volt_ns) <= most_ns
    return volts[near] * amps[nearest[near]], volt_ns[near]
