"""Rows of the metrics of CN 102680005, from the steps of its procedure in a store."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from analytics.system_level.calibration import Result, Way, noise_of, results
from analytics.system_level.imu_signals import ImuChannels, imu_channels, imu_series
from analytics.system_level.procedure_positions import ASSUMED_U_HEADING_RAD, start_of, stated_u_heading_rad
from analytics.system_level.rotation_record import AXES, Rotation, evaluated
from storage.sql.catalog import Catalog
from stream.errors import BadInput

_NO_LATITUDE = (
    "no latitude of the station, so the Earth's rate cannot be removed: give it in the station's file, or import the "
    "file again with --latitude"
)
_STANDARDS = """
select document->'$.details'->>'$.standards' from internal.lake_documents
where run = $run and kind = 'RunStarted' limit 1
"""
_STANDARD_GRAVITY = 9.80665
_DEG_PER_SQRT_H = math.degrees(60.0)  # of rad/s per root hertz


class Quantity(NamedTuple):
    """One of the errors: its letter in the equations, the factor to the unit of its metric, and whose it is."""

    letter: str
    factor: float
    is_of_accelerometer: bool = False


ASYMMETRY = Quantity("A", 1e6)
SYMMETRIC = Quantity("S", 1e6)
ACCELEROMETER_BIAS = Quantity("B", 1e6 / _STANDARD_GRAVITY, is_of_accelerometer=True)
GYRO_BIAS = Quantity("b", math.degrees(3600.0))


class _Record(NamedTuple):
    """One rotation of the procedure: its steps, and what came of it."""

    name: str
    axis: int | None
    steps: tuple[int, ...]
    rotation: Rotation | None
    reason: str | None


class _AxisResults(NamedTuple):
    """The results of one gyro of one unit in one run."""

    axis: int
    channels: ImuChannels | None
    records: Sequence[_Record]  # with a rotation
    steps: tuple[int, ...]  # all steps of its rotations
    left_out: Sequence[str]
    results: Sequence[Result]


_Known = dict[tuple[Any, ...], list[_AxisResults]]
_KNOWN: "WeakKeyDictionary[Catalog, _Known]" = WeakKeyDictionary()  # several metrics need the same


def asymmetry_rows(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of `system_level_scale_factor_asymmetry`."""
    return _rows(catalog, sql, ASYMMETRY)


def symmetric_rows(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of `system_level_scale_factor_error`."""
    return _rows(catalog, sql, SYMMETRIC)


def accelerometer_bias_rows(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of `system_level_accelerometer_bias`."""
    return _rows(catalog, sql, ACCELEROMETER_BIAS)


def gyro_bias_rows(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of `system_level_gyro_bias`."""
    return _rows(catalog, sql, GYRO_BIAS)


def _rows(catalog: Catalog, sql: str, quantity: Quantity) -> Iterator[dict[str, Any]]:
    steps: list[dict[str, Any]] = catalog.reader(sql).read_all().to_pylist()
    for (run, unit), group in groupby(steps, key=lambda step: (step["run"], step["unit"])):
        of_unit = list(group)
        known = _KNOWN.setdefault(catalog, {})
        key = (run, unit, *((step["index"], step["t_from_ns"], step["t_to_ns"]) for step in of_unit))
        if key not in known:
            known[key] = _of_unit(catalog, of_unit)
        for found in known[key]:
            for result in found.results:
                if (row := _row(found, result, quantity)) is not None:
                    yield {"run": run, "unit": unit, **row}


def _of_unit(catalog: Catalog, steps: Sequence[Mapping[str, Any]]) -> list[_AxisResults]:
    every = tuple(step["index"] for step in steps)
    latitude_deg = steps[0]["latitude_deg"]
    try:
        if latitude_deg is None:
            raise BadInput(_NO_LATITUDE)
        units = {
            name: unit for step in steps for name, unit in zip(step["signals"], step["units_of_measure"], strict=True)
        }
        channels = imu_channels(units)
        stated = catalog.rows(_STANDARDS, {"run": steps[0]["run"]})
        u_heading_rad = stated_u_heading_rad(stated[0][0] if stated else None) or ASSUMED_U_HEADING_RAD
    except BadInput as error:
        nothing = [_Record("", None, every, None, str(error))]
        return [_of_axis(axis, None, nothing, math.nan) for axis in range(3)]
    records = [
        _record(catalog, list(group), channels, latitude_deg, u_heading_rad)
        for _, group in groupby(steps, key=lambda step: (step["position"], step["axis"], step["epoch"]))
    ]
    return [_of_axis(axis, channels, records, latitude_deg) for axis in range(3)]


def _record(
    catalog: Catalog,
    steps: Sequence[Mapping[str, Any]],
    channels: ImuChannels,
    latitude_deg: float,
    u_heading_rad: float,
) -> _Record:
    first = steps[0]
    indices, position = tuple(step["index"] for step in steps), first["position"]
    name = f"{position or 'record'} (step {indices[0]})"
    start = start_of(position)
    word = (first["axis"] or "").upper()
    axis = AXES.index(word) if word in {*AXES} else None
    if axis is None and start is not None:
        axis = (int(position[-1]) - 1) // 3
    try:
        span = first["t_from_ns"], steps[-1]["t_to_ns"]
        series = imu_series(catalog, first["run"], first["unit"], channels, span, name)
        nominal = None if start is None else (start, u_heading_rad)
        rotation = evaluated(series, latitude_deg, nominal, name)
        if axis is not None and rotation.axis != axis:
            turning = channels.gyros[rotation.axis].signal
            raise BadInput(f"{name}: it is to turn about {AXES[axis]}, and {turning} turns; are axes swapped?")
    except BadInput as error:
        return _Record(name, axis, indices, None, str(error))
    return _Record(name, rotation.axis, indices, rotation, None)


def _of_axis(axis: int, channels: ImuChannels | None, records: Sequence[_Record], latitude_deg: float) -> _AxisResults:
    mine = [each for each in records if each.axis in {axis, None}]
    left_out = [each.reason for each in mine if each.reason is not None]
    used = [each for each in mine if each.rotation is not None]
    steps = tuple(step for each in mine for step in each.steps)
    rotations = [each.rotation for each in used if each.rotation is not None]
    if rotations:
        return _AxisResults(axis, channels, used, steps, left_out, results(rotations, latitude_deg))
    reason = left_out[0] if left_out else f"no rotation about {AXES[axis]} was recorded"
    ways = (Way.AVERAGE, Way.JOINT, Way.JOINT_REST, Way.REST)
    return _AxisResults(axis, channels, (), steps, left_out, [Result(way, (), {}, (), reason) for way in ways])


def _row(found: _AxisResults, result: Result, quantity: Quantity) -> dict[str, Any] | None:
    is_bias = quantity is GYRO_BIAS
    if is_bias and result.way in {Way.SPEED, Way.AVERAGE}:
        return None
    if not is_bias and result.way is Way.REST:
        return None
    records = [found.records[at] for at in result.rotations]
    rotations = [each.rotation for each in records if each.rotation is not None]
    parameters = _parameters(found, result, rotations)
    of_speed = sorted(step for each in records for step in each.steps)
    steps = of_speed if result.way is Way.SPEED else sorted(found.steps)
    row: dict[str, Any] = {
        "signal": _signal(found, rotations, quantity), "n": len(rotations), "parameters": parameters,
        "steps": steps, "reason": result.reason, "value": None,
        "standard_uncertainty": None, "freedom": None,
    }  # fmt: skip
    if (budget := result.budgets.get(quantity.letter)) is not None:
        row["value"] = budget.value * quantity.factor
        row["standard_uncertainty"] = budget.standard_uncertainty() * abs(quantity.factor)
        row["freedom"] = min(budget.freedom, 1e9)
        parameters["largest_component"] = max(budget.components, key=lambda each: each.u * abs(each.sensitivity)).en
        if quantity is ASYMMETRY:
            symmetric = result.budgets["S"].value
            parameters["gjb_asymmetry"] = _short(2e6 * abs(budget.value) / (1.0 + symmetric))
    return row


def _signal(found: _AxisResults, rotations: Sequence[Rotation], quantity: Quantity) -> str:
    across = rotations[0].across if rotations else (1, 0, 0)[found.axis]
    kind, axis = ("accel", across) if quantity.is_of_accelerometer else ("rate", found.axis)
    if found.channels is None:
        return f"{kind}_{AXES[axis].lower()}"
    of = found.channels.accelerometers if quantity.is_of_accelerometer else found.channels.gyros
    return of[axis].signal


def _parameters(found: _AxisResults, result: Result, rotations: Sequence[Rotation]) -> dict[str, Any]:
    speeds = ", ".join(f"{speed:.4g}" for speed in result.speeds_deg_per_s)
    parameters: dict[str, Any] = {"method": str(result.way), "axis": AXES[found.axis], "speeds_deg_per_s": speeds}
    if rotations:
        noise = noise_of(rotations)
        parameters["angle_random_walk"] = _short(noise.gyro.value * _DEG_PER_SQRT_H)
        parameters["heading"] = ", ".join(sorted({each.attitude.heading_source for each in rotations}))
        parameters["heading_uncertainty_deg"] = _short(math.degrees(max(e.attitude.u_heading_rad for e in rotations)))
    if result.way is Way.SPEED:
        parameters["changes_mm_per_s2"] = ", ".join(f"{each.change * 1e3:.6g}" for each in rotations)
    if result.misfit is not None:
        parameters["misfit"] = _short(result.misfit)
    if found.left_out and rotations:
        parameters["left_out"] = "; ".join(found.left_out)
    return parameters


def _short(value: float) -> float:
    return float(f"{value:.4g}")
