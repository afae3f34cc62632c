"""The six signals of a three-axis device, by name and unit of measure, and their samples on one grid."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from analytics.system_level.rotation_record import AXES, ImuSeries
from storage.sql.catalog import Catalog
from stream.batch import BoolArray, FloatArray, IntArray
from stream.channel_names import signal_axis
from stream.errors import BadInput, UnknownUnit
from stream.quantities import conversion, is_angular_rate

_SAMPLES = """
select signal, t_ns, value from internal.samples_in($paths)
where run = $run and unit = $unit and list_contains($signals, signal) and t_ns between $first and $last
order by signal, t_ns, seq
"""
# a sample more than this share of an interval beside the grid is another's
_OFF_GRID = 0.6
# lost samples at rest are replaced by the line between their neighbours, up to this share of a record
_MOST_LOST = 0.02
_MOVING_RAD_PER_S = 0.0087


class Channel(NamedTuple):
    """One sensor: its signal, and the factor to rad/s or m/s^2."""

    signal: str
    factor: float


class ImuChannels(NamedTuple):
    """Gyros and accelerometers of X, Y, Z."""

    gyros: tuple[Channel, Channel, Channel]
    accelerometers: tuple[Channel, Channel, Channel]

    @property
    def all(self) -> tuple[Channel, ...]:
        """All six."""
        return (*self.gyros, *self.accelerometers)


def imu_channels(units_of_measure: Mapping[str, str]) -> ImuChannels:
    """Find the six sensors among the signals of a unit, which have these units of measure.

    A gyro has the unit of an angular rate, an accelerometer that of an acceleration; the axis is a letter of the name.
    Raises BadInput if one is missing, or there are two.

    >>> units = {f"rate_{axis}": "deg/h" for axis in "xyz"} | {f"accel_{axis}": "m/s^2" for axis in "xyz"}
    >>> [channel.signal for channel in imu_channels(units | {"temperature": "degC"}).all][2:4]
    ['rate_z', 'accel_x']
    """
    found: dict[str, list[tuple[str, Channel]]] = {"gyro": [], "accelerometer": []}
    for signal, unit in sorted(units_of_measure.items()):
        axis = signal_axis(signal)
        if axis is None or signal.lower().startswith(("table", "reference", "input", "vibration")):
            continue
        with suppress(UnknownUnit):
            if is_angular_rate(unit):
                found["gyro"].append((axis, Channel(signal, conversion(unit, "rad/s")[0])))
            else:
                found["accelerometer"].append((axis, Channel(signal, conversion(unit, "m/s^2")[0])))
    sensors = [_of_axes(kind, channels, units_of_measure) for kind, channels in found.items()]
    return ImuChannels(*sensors)


def _of_axes(
    kind: str, channels: Sequence[tuple[str, Channel]], units_of_measure: Mapping[str, str]
) -> tuple[Channel, Channel, Channel]:
    own = {axis: [channel for of, channel in channels if of == axis.lower()] for axis in AXES}
    listed = ", ".join(f"{signal} [{unit}]" for signal, unit in sorted(units_of_measure.items())) or "none"
    unit = "deg/s, deg/h or rad/s" if kind == "gyro" else "g or m/s^2"
    for axis, mine in own.items():
        if len(mine) != 1:
            names = ", ".join(channel.signal for channel in mine)
            what = f"{kind} {axis} is missing" if not mine else f"there are several of {kind} {axis}: {names}"
            raise BadInput(
                f"three gyros and three accelerometers are needed, named as rate_x and accel_x, in {unit}; {what}; the "
                f"unit has {listed}"
            )
    return own["X"][0], own["Y"][0], own["Z"][0]


def imu_series(
    catalog: Catalog, run: str, unit: str, channels: ImuChannels, span: tuple[int, int], name: str
) -> ImuSeries:
    """Samples of a record on one grid; `span` is its first and last time, nanoseconds.

    Raises BadInput where samples are missing in the turn, or too many at rest.
    """
    signals = [channel.signal for channel in channels.all]
    asked = {"run": run, "unit": unit, "signals": signals, "first": span[0], "last": span[1]}
    table = catalog.reader(_SAMPLES, {"paths": catalog.checked_paths_of([run], _SAMPLES), **asked}).read_all()
    own, t_ns = np.asarray(table["signal"].to_numpy(zero_copy_only=False)), table["t_ns"].to_numpy()
    values = np.asarray(table["value"].to_numpy(), np.float64)
    series = {}
    for channel in channels.all:
        mine = own == channel.signal
        if mine.sum() < 2:
            raise BadInput(f"{name}: {mine.sum()} samples of {channel.signal} are in the store as they came")
        series[channel.signal] = t_ns[mine], values[mine] * channel.factor
    times = series[channels.gyros[0].signal][0]
    dt_ns = int(np.median(np.diff(times)))
    n = round((times[-1] - times[0]) / dt_ns) + 1
    for channel in channels.all:
        theirs = series[channel.signal][0]
        if abs(np.median(np.diff(theirs)) / dt_ns - 1.0) > 0.01:
            rate = f"{1e9 / dt_ns:.4g} Hz", f"{1e9 / np.median(np.diff(theirs)):.4g} Hz"
            raise BadInput(f"{name}: {channels.gyros[0].signal} comes at {rate[0]}, {channel.signal} at {rate[1]}")
        n = min(n, round((theirs[-1] - theirs[0]) / dt_ns) + 1)
    grids = [on_grid(*series[channel.signal], dt_ns, n) for channel in channels.all]
    lost: BoolArray = np.logical_not(np.isfinite(np.stack(grids)).all(axis=0))
    filled = np.stack([without_gaps(grid) for grid in grids])
    _check_lost(lost, filled[:3], name)
    return ImuSeries(dt_ns * 1e-9, filled[:3], filled[3:])


def on_grid(t_ns: IntArray, values: FloatArray, dt_ns: int, n: int) -> FloatArray:
    """Values on a grid that begins with a signal's first sample; NaN where a sample is missing."""
    places = np.rint((t_ns - t_ns[0]) / dt_ns).astype(np.int64)
    near = (np.abs(t_ns - t_ns[0] - places * dt_ns) <= _OFF_GRID * dt_ns) & (places < n)
    grid = np.full(n, np.nan)
    grid[places[near]] = values[near]
    return grid


def without_gaps(grid: FloatArray) -> FloatArray:
    """The values of a grid, with the line between neighbours where one is missing."""
    known = np.isfinite(grid)
    at = np.arange(len(grid))
    return np.asarray(np.interp(at, at[known], grid[known]), np.float64)


def _check_lost(lost: BoolArray, rates: FloatArray, name: str) -> None:
    if not lost.any():
        return
    moving = (np.abs(rates) > _MOVING_RAD_PER_S).any(axis=0)
    if in_turn := int((lost & moving).sum()):
        raise BadInput(f"{name}: {in_turn} samples are missing in the turn, whose angle is lost with them")
    if (count := int(lost.sum())) > _MOST_LOST * len(lost):
        raise BadInput(f"{name}: {count} of {len(lost)} samples are missing at rest, at most {_MOST_LOST:.0%} may be")
