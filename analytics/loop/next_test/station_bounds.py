"""Bounds of a station: what its chamber, rate table and supply may be set to."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from stream.errors import BadInput

THERMAL = ("temperature", "case_temperature", "chamber_temperature", "chamber_setpoint")
UNITS = {
    "least_deg_c": "degC", "most_deg_c": "degC", "slope_deg_c_per_min": "degC/min", "rate_deg_per_s": "deg/s",
    "acceleration_deg_per_s2": "deg/s^2", "least_angle_deg": "deg", "most_angle_deg": "deg", "least_v": "V",
    "most_v": "V",
}  # fmt: skip
"""Unit of measure of each bound."""
_LEAST_SWING_DEG_C = 1.0
_LEAST_OF_ANY = 1e-3  # of a slope, an acceleration or a rate
_LEAST_RATE_DEG_PER_S = 1e-3  # less is the noise of a table at rest
_LEAST_TURN_DEG = 1.0
_PAIRS = (("least_deg_c", "most_deg_c"), ("least_angle_deg", "most_angle_deg"), ("least_v", "most_v"))


class StationBounds(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What chamber, rate table and supply may be set to in a test.

    Parameters
    ----------
    slope_deg_c_per_min: Fastest ramp of the chamber.
    acceleration_deg_per_s2: Of the rate table.
    least_deg_c, most_deg_c, rate_deg_per_s: None if the chamber, or the table, is not to be used.
    least_angle_deg, most_angle_deg: None if the table is not to be sent to angles.
    least_v, most_v: None if the supply is not to be changed.
    sources: Where each bound that is not a default comes from: ``runs``, ``station`` or ``given``.
    """

    slope_deg_c_per_min: float = 2.0
    acceleration_deg_per_s2: float = 50.0
    least_deg_c: float | None = None
    most_deg_c: float | None = None
    rate_deg_per_s: float | None = None
    least_angle_deg: float | None = None
    most_angle_deg: float | None = None
    least_v: float | None = None
    most_v: float | None = None
    sources: dict[str, str] = {}

    def __post_init__(self) -> None:
        """Refuse bounds that no station has."""
        for name in UNITS:
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise BadInput(f"bound {name}={value:g} is no finite number")
        for name in ("slope_deg_c_per_min", "acceleration_deg_per_s2", "rate_deg_per_s"):
            value = getattr(self, name)
            if value is not None and not value >= _LEAST_OF_ANY:
                raise BadInput(f"bound {name}={value:g}: give a positive number, {_LEAST_OF_ANY:g} or more")
        for least, most in _PAIRS:
            low, high = getattr(self, least), getattr(self, most)
            if low is not None and high is not None and not low < high:
                raise BadInput(
                    f"bounds {least}={low:g} and {most}={high:g}: the first must be below the second; give both (what "
                    "is not given is what the unit has been through)"
                )

    @classmethod
    def of_runs(
        cls, runs: Sequence[RunBlocks], station: Mapping[str, float] | None = None, **given: Any
    ) -> "StationBounds":
        """What the unit has been through in its runs, within the limits of the station, as far as it is not given.

        Temperatures and rates that the runs do not show are those of the station; its voltages are not used, since a
        supply gives more than a unit withstands.
        """
        limits = dict(station or {})
        known = {name: value for name, value in _shown(runs).items() if value is not None}
        sources = dict.fromkeys(known, "runs")
        for name, value in limits.items():
            if name not in known:
                if not name.endswith("_v"):
                    known[name], sources[name] = value, "station"
            elif (value > known[name]) is name.startswith("least") and value != known[name]:
                known[name], sources[name] = value, "station"
        for name, value in given.items():
            if value is not None:
                _check_within(name, value, limits)
                known[name], sources[name] = value, "given"
        return cls(**known, sources=sources)

    @property
    def middle_deg_c(self) -> float:
        """Temperature at which a test begins; 25 degC where the chamber is not used."""
        return 25.0 if self.least_deg_c is None or self.most_deg_c is None else (self.least_deg_c + self.most_deg_c) / 2

    def document(self) -> dict[str, dict[str, Any]]:
        """JSON form: each bound with its unit and where it comes from."""
        return {
            name: {"value": getattr(self, name), "unit_of_measure": unit, "from": self.sources.get(name, "default")}
            for name, unit in UNITS.items()
            if getattr(self, name) is not None
        }


def limits_of_station(path: Path) -> dict[str, float]:
    """Limits of the chamber, the rate table and the power supply in a station file; fields of `StationBounds`.

    A station with several of a kind has the limits of the one that its settings name, else of the first.
    """
    from ingest.station.station import load_station

    station = load_station(path)
    limits: dict[str, float] = {}
    for setting, fields in (
        ("temperature", {"least_deg_c": "lowest_deg_c", "most_deg_c": "highest_deg_c"}),
        (
            "rate",
            {
                "rate_deg_per_s": "max_rate_deg_per_s", "least_angle_deg": "lowest_angle_deg",
                "most_angle_deg": "highest_angle_deg",
            },
        ),
        ("voltage", {"most_v": "max_voltage_v"}),
    ):  # fmt: skip
        if setting in station.settings:
            _, options = station.instruments[station.settings[setting]]
            limits |= {
                name: float(getattr(options, field)) for name, field in fields.items() if hasattr(options, field)
            }
    return limits


def _check_within(name: str, value: float, limits: Mapping[str, float]) -> None:
    """Refuse a bound that the station does not reach."""
    if name in limits and (value < limits[name] if name.startswith("least") else value > limits[name]):
        raise BadInput(
            f"bound {name}={value:g} is beyond {limits[name]:g} {UNITS[name]}, the limit in the station file; give a "
            "bound within it"
        )


def _shown(runs: Sequence[RunBlocks]) -> dict[str, float | None]:
    """What the unit has been through."""
    shown: dict[str, float | None] = {}
    temperatures = _range(runs, THERMAL[::-1], "degC")
    if temperatures is not None and np.ptp(temperatures) > _LEAST_SWING_DEG_C:
        shown["least_deg_c"], shown["most_deg_c"] = (float(np.round(each)) for each in temperatures)
    rates = _range(runs, ("input_rate", "table_rate"), "deg/s")
    if rates is not None and (most := float(f"{np.abs(rates).max():.2g}")) > _LEAST_RATE_DEG_PER_S:
        shown["rate_deg_per_s"] = most
    angles = _range(runs, ("table_angle",), "deg")
    if angles is not None and np.ptp(angles) > _LEAST_TURN_DEG:
        shown["least_angle_deg"], shown["most_angle_deg"] = _whole_turn(angles)
    volts = _range(runs, ("supply_voltage",), "V")
    if volts is not None and np.ptp(volts) > 0.01 * abs(float(np.mean(volts))):
        shown["least_v"], shown["most_v"] = (float(np.round(each, 1)) for each in volts)
    return shown


def _whole_turn(angles: tuple[float, float]) -> tuple[float, float]:
    """Range of angles; one full turn for a table that turned further."""
    return (0.0, 360.0) if np.ptp(angles) >= 360.0 else (float(np.round(angles[0])), float(np.round(angles[1])))


def _range(runs: Sequence[RunBlocks], names: Sequence[str], unit: str) -> tuple[float, float] | None:
    """Range of the first of these channels that every run has in the unit in which stations are set."""
    for name in names:
        if all(name in run.channels and run.channels[name].unit_of_measure == unit for run in runs):
            values = np.concatenate([run.mean(name) for run in runs])
            if np.isfinite(values).any():
                return float(np.nanmin(values)), float(np.nanmax(values))
    return None
