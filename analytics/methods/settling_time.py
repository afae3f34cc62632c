"""How long after power-on the output stays within the product's error band: start-up and warm-up time."""

from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from analytics.methods.confidence_bounds import TWO_SIDED
from analytics.step_records.series_statistics import samples_statistics
from storage.sql.catalog import Catalog
from stream.batch import FloatArray, IntArray

# The output stays within its band if it does so at least for this part of the record, at its end.
LEAST_STAY = 0.1
# Where no zero was measured before, the last part of the record stands for it.
_TAIL = 0.25

_SAMPLES = """
select w.which, list(s.t_ns order by s.t_ns, s.seq) as t_ns, list(s.value order by s.t_ns, s.seq) as values
from given_rows w
join internal.samples_in($paths) s
  on s.run = w.run and s.unit = w.unit and s.signal = w.signal and s.t_ns between w.on_ns and w.t_to_ns
where s.run = $run
group by w.which
"""


class Settled(NamedTuple):
    """When an output has settled, s after power-on, with its bounds and standard uncertainty (NaN where unknown)."""

    value: float
    lo: float
    hi: float
    standard_uncertainty: float


def settling_times(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of a metric: each test, as of the SQL macro ``settling_tests``, and the largest of a unit's tests.

    The error is the output less the table's rate, the Earth's rate and the unit's last bias measured before; where that
    is unknown, less the mean over the last quarter of the record (`reference` in the parameters); if it still moves
    there, the time has no upper bound. The time is that of the first sample after the last one outside the band: it is
    known to a sample interval. The bounds include the reference's uncertainty: they are the times for a band that is
    wider and narrower by 1.96 times that.
    """
    tests = catalog.reader(sql).read_all().to_pylist()
    found = []
    for run, group in groupby(tests, key=lambda test: test["run"]):
        of_run = list(group)
        series = _series(catalog, run, of_run)
        found += [_row(each, series.get(at)) for at, each in enumerate(of_run)]
    yield from found
    for _, group in groupby(found, key=lambda row: (row["run"], row["unit"], row["signal"])):
        yield _largest(list(group))


def _series(catalog: Catalog, run: str, tests: list[dict[str, Any]]) -> dict[int, tuple[IntArray, FloatArray]]:
    """Times and values of the samples of each test, from power-on to its end."""
    names = ("run", "unit", "signal", "on_ns", "t_to_ns")
    rows = [{"which": which, **{name: test[name] for name in names}} for which, test in enumerate(tests)]
    samples = catalog.table(
        _SAMPLES, pa.Table.from_pylist(rows), {"run": run, "paths": catalog.checked_paths_of([run], _SAMPLES)}
    )
    return {
        row["which"]: (np.array(row["t_ns"], np.int64), np.array(row["values"], np.float64))
        for row in samples.to_pylist()
    }


def _row(test: Mapping[str, Any], series: tuple[IntArray, FloatArray] | None) -> dict[str, Any]:
    what = f"rate {test['rate_command']:g} deg/s" if test["is_rate"] else f"position {test['position'] or 'unknown'}"
    known, band = test["expected"] is not None, test["band"]
    row = {name: test[name] for name in ("unit", "signal", "run", "n")} | {"steps": [test["index"]]}
    row["parameters"] = {
        "test": what, "band_deg_per_h": band,
        "reference": f"bias of run {test['zero_run']}" if known else "end of the record",
        "counted_from": "power-on" if test["is_powered"] else "step start",
    }  # fmt: skip
    if (reason := _lack(test, has_samples=series is not None)) is not None:
        return row | {"reason": reason}
    assert series is not None
    t_ns, output = series[0], series[1] * test["deg_per_h"]
    mean, mean_u, noise = _end_of(t_ns, output)
    expected, u = (test["expected"], test["expected_u"]) if known else (mean, mean_u)
    settled = settling(np.abs(output - expected), (t_ns - test["on_ns"]) / 1e9, band, u, noise)
    if isinstance(settled, Settled) and not known and _still_moves(output, band):
        # what it tends to is not known, and how long that takes
        settled = settled._replace(hi=np.nan, standard_uncertainty=np.nan)
    return row | (settled._asdict() if isinstance(settled, Settled) else {"reason": f"{what}: {settled}"})


def _still_moves(output: FloatArray, band: float) -> bool:
    """Whether the output still moves at the end of a record, so that another one as long would take it far on.

    >>> noise = np.random.default_rng(1).standard_normal(4000)
    >>> _still_moves(noise, 100.0), _still_moves(noise + 500 * np.exp(-np.arange(4000) / 4000), 100.0)
    (False, True)
    """
    size = int(len(output) * _TAIL) // 2
    if size < 8:
        return False
    early, late = output[-2 * size : -size], output[-size:]
    change = float(late.mean() - early.mean())
    scatter = float(np.sqrt((early.var(ddof=1) + late.var(ddof=1)) / size))
    return abs(change) > 4 * scatter and abs(change) * len(output) / size > 0.1 * band


def _lack(test: Mapping[str, Any], *, has_samples: bool) -> str | None:
    if test["product"] is None:
        return "the product of the unit is unknown, and with it the error band: name it where the unit is mounted"
    if test["band"] is None:
        return f"product {test['product']}: no specification in the store has its startup_band_deg_per_h"
    if test["is_dropped"]:
        return "raw samples of the run were dropped to make room, and the time is computed from them"
    if not has_samples:
        return "no sample between power-on and the end of the step"
    return test["no_scale"] if test["deg_per_h"] is None else None


def _end_of(t_ns: IntArray, output: FloatArray) -> tuple[float, float, float]:
    """Mean over the end of a record, its standard uncertainty, and the largest departure of a sample from it."""
    start = int(len(t_ns) * (1 - _TAIL))
    t_ns, output = t_ns[start:], output[start:]
    if len(t_ns) < 2:
        return float(output.mean()), 0.0, 0.0
    found = samples_statistics(t_ns, output, (int(t_ns[0]), int(t_ns[-1])))
    return found.mean, found.standard_uncertainty, float(np.max(np.abs(output - found.mean)))


def settling(error: FloatArray, time_s: FloatArray, band: float, u: float, noise: float) -> Settled | str:
    """First time from which an error stays within a band, or why there is none.

    `error`: magnitudes in the unit of the `band`, `time_s` after power-on. `u`: standard uncertainty of the reference
    of the error. `noise`: largest departure of a sample by noise.

    >>> settling(np.array([9.0, 5.0, 2.0, 0.5, 0.4, 0.5]), np.arange(6.0), 1.0, 0.0, 0.1).value
    3.0
    >>> settling(np.array([9.0, 5.0, 2.0]), np.arange(3.0), 1.0, 0.0, 0.1)
    'the output is outside +-1 deg/h to the end of the record, at 2 s by 2 deg/h'
    """
    after = _after(error, band)
    kept = len(error) - after
    if kept < max(1, LEAST_STAY * len(error)):
        last = after - 1
        stay = "to the end of the record" if kept == 0 else f"until {LEAST_STAY:.0%} of the record were left"
        return f"the output is outside +-{band:g} deg/h {stay}, at {time_s[last]:g} s by {error[last]:.3g} deg/h"
    gap_s = float(time_s[after] - (time_s[after - 1] if after else 0.0))
    wide, narrow = _after(error, band + TWO_SIDED * u + noise), _after(error, band - TWO_SIDED * u)
    lo = float(time_s[wide - 1]) if wide else 0.0
    hi = float(time_s[narrow]) if narrow < len(error) else np.nan
    spread = (hi - float(time_s[wide])) / (2 * TWO_SIDED)
    return Settled(float(time_s[after]), lo, hi, float(np.hypot(gap_s / np.sqrt(12), spread)))


def _after(error: FloatArray, band: float) -> int:
    """First of the samples at the end that are all within the band."""
    outside = np.flatnonzero(error > band)
    return int(outside[-1]) + 1 if outside.size else 0


def _largest(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The largest over the tests of a unit in a run."""
    row = {name: rows[0][name] for name in ("unit", "signal", "run")} | {
        "n": sum(row["n"] for row in rows),
        "steps": [step for row in rows for step in row["steps"]],
        "parameters": {"test": "largest", "tests": len(rows)},
    }
    if (reason := next((row["reason"] for row in rows if row.get("reason") is not None), None)) is not None:
        return row | {"reason": reason}
    largest = max(rows, key=lambda row: row["value"])
    bounds = {name: float(np.max([row[name] for row in rows])) for name in ("lo", "hi")}
    return row | bounds | {name: largest[name] for name in ("value", "standard_uncertainty")}
