"""The steps of a run as an attitude unit gives them: what its three axes turned, and their rates on one grid."""

from collections.abc import Iterator
from itertools import groupby
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from analytics.step_records.integrated_output import is_integrated, unwrapped
from analytics.system_level.imu_signals import on_grid, without_gaps
from storage.sql.catalog import Catalog
from stream.batch import FloatArray, IntArray
from stream.errors import BadInput

_STEPS = """
select s."index", s.step, s.position, coalesce(axis_word_of(s.axis), axis_in(s.position)) as turned,
  coalesce(side_in(s.position), 1) as side, s.rate_command, s.input_rate, s.latitude_deg, s.signal, s.unit_of_measure,
  s.t_from_ns, s.t_to_ns, s.n, s.duration_s, s.mean, s.standard_uncertainty, s.rate_factor, s.deg_per_h,
  named_axis_of(s.signal) as own
from rate_steps s
where s.run = $run and s.unit = $unit and s.n > 1 and s.frequency is null and named_axis_of(s.signal) is not null
  and not ends_with(s.signal, '_compensated')
order by s."index"
"""
_SAMPLES = """
select signal, t_ns, value from internal.samples_in($paths)
where run = $run and unit = $unit and list_contains($signals, signal) and t_ns between $first and $last
order by signal, t_ns, seq
"""
_MOST_LOST = 0.02


class AxisStep(NamedTuple):
    """What one axis gives in a step."""

    signal: str
    unit_of_measure: str
    per_deg_per_s: float  # deg/s of its own output, by its unit of measure; NaN where that is no rate
    calibrated_deg_per_s: float  # the same divided by the scale factor that was measured
    mean: float
    u: float


class AttitudeStep(NamedTuple):
    """A step of a run."""

    number: int
    step: str
    position: str | None
    turned: str | None  # axis about which the table turns the unit
    side: int  # 1 where this axis points up, -1 down
    rate_deg_per_s: float  # of the table
    latitude_deg: float | None
    t_from_ns: int
    t_to_ns: int
    duration_s: float
    axes: dict[str, AxisStep]

    def turned_deg(self, axis: str, lasts_s: float) -> float:
        """The angle N that an axis gives in a time, by its scale factor, deg."""
        own = self.axes[axis]
        return own.mean * own.calibrated_deg_per_s * lasts_s


class Rates(NamedTuple):
    """Rates of three axes on one grid, by their scale factors, deg/s, shape (3, n)."""

    t_ns: IntArray
    dt_s: float
    deg_per_s: FloatArray


def attitude_steps(catalog: Catalog, run: str, unit: str, axes: tuple[str, str, str]) -> list[AttitudeStep]:
    """Steps of a run in which all three axes were recorded; raises BadInput where there is none."""
    found = []
    table = catalog.reader(_STEPS, {"run": run, "unit": unit}).read_all().to_pylist()
    for index, group in groupby(table, itemgetter("index")):
        rows = {row["own"]: row for row in group if row["own"] in axes and row["deg_per_h"] is not None}
        if set(rows) == set(axes):
            found.append(_step(index, rows, axes))
    if not found:
        raise BadInput(
            f"run {run}, unit {unit}: no completed step holds the outputs of {', '.join(axes)}, named as rate_x"
        )
    return found


def _step(index: int, rows: dict[str, dict[str, Any]], axes: tuple[str, str, str]) -> AttitudeStep:
    about = rows[axes[0]]
    rate = about["input_rate"] if about["input_rate"] is not None else about["rate_command"]
    return AttitudeStep(
        number=index, step=about["step"] or "", position=about["position"], turned=about["turned"], side=about["side"],
        rate_deg_per_s=float(rate or 0.0), latitude_deg=about["latitude_deg"],
        t_from_ns=max(row["t_from_ns"] for row in rows.values()), t_to_ns=min(row["t_to_ns"] for row in rows.values()),
        duration_s=about["duration_s"],
        axes={axis: _axis(rows[axis]) for axis in axes},
    )  # fmt: skip


def _axis(row: dict[str, Any]) -> AxisStep:
    factor = np.nan if row["rate_factor"] is None else row["rate_factor"] / 3600.0
    u = np.nan if row["standard_uncertainty"] is None else row["standard_uncertainty"]
    return AxisStep(
        row["signal"], row["unit_of_measure"], float(factor), row["deg_per_h"] / 3600.0, row["mean"], float(u)
    )


def rates_of(catalog: Catalog, run: str, unit: str, step: AttitudeStep) -> Rates:
    """The samples of a step; raises BadInput where they are no longer in the store, or too many are missing."""
    signals = [own.signal for own in step.axes.values()]
    asked = {"run": run, "unit": unit, "signals": signals, "first": step.t_from_ns, "last": step.t_to_ns}
    table = catalog.reader(_SAMPLES, {"paths": catalog.checked_paths_of([run], _SAMPLES), **asked}).read_all()
    names, t_ns = np.asarray(table["signal"].to_numpy(zero_copy_only=False)), table["t_ns"].to_numpy()
    values = np.asarray(table["value"].to_numpy(), np.float64)
    series = list(_of_axes(step, names, t_ns, values))
    times = series[0][0]
    dt_ns = int(np.median(np.diff(times)))
    n = min(round((own[-1] - own[0]) / dt_ns) + 1 for own, _ in series)
    grids = np.stack([on_grid(own, rates, dt_ns, n) for own, rates in series])
    lost = int((~np.isfinite(grids)).any(axis=0).sum())
    if lost > _MOST_LOST * n:
        raise BadInput(f"{lost} of {n} samples are missing, at most {_MOST_LOST:.0%} may be")
    filled = np.stack([without_gaps(grid) for grid in grids])
    return Rates(times[0] + np.arange(n, dtype=np.int64) * dt_ns, dt_ns * 1e-9, filled)


def _of_axes(
    step: AttitudeStep, names: FloatArray, t_ns: IntArray, values: FloatArray
) -> Iterator[tuple[IntArray, FloatArray]]:
    """Times and rates of each axis; the rate of an angle is its difference over the interval before the sample."""
    for own in step.axes.values():
        mine = names == own.signal
        if mine.sum() < 3:
            raise BadInput(f"{mine.sum()} samples of {own.signal} are in the store as they came")
        times, output = t_ns[mine], values[mine]
        if is_integrated(own.signal):
            output = np.diff(unwrapped(output, own.unit_of_measure)) / (np.diff(times) * 1e-9)
            times = times[1:]
        yield times, output * own.calibrated_deg_per_s
