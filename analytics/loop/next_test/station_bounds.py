"""Bounds of a station: what its chamber, rate table and supply may be set to."""

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from stream.errors import BadInput

THERMAL = ("temperature", "case_temperature", "chamber_temperature", "chamber_setpoint")
_LEAST_SWING_DEG_C = 1.0
_LEAST_OF_ANY = 1e-3  # of a slope, an acceleration or a rate
_LEAST_RATE_DEG_PER_S = 1e-3  # less is the noise of a table at rest


class StationBounds(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What chamber, rate table and supply may be set to in a test.

    Parameters
    ----------
    slope_deg_c_per_min: Fastest ramp of the chamber.
    acceleration_deg_per_s2: Of the rate table.
    least_deg_c, most_deg_c, rate_deg_per_s: None if the chamber, or the table, is not to be used.
    least_v, most_v: None if the supply is not to be changed.
    """

    slope_deg_c_per_min: float = 2.0
    acceleration_deg_per_s2: float = 50.0
    least_deg_c: float | None = None
    most_deg_c: float | None = None
    rate_deg_per_s: float | None = None
    least_v: float | None = None
    most_v: float | None = None

    def __post_init__(self) -> None:
        """Refuse bounds that no station has."""
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise BadInput(f"bound {name}={value:g} is no finite number")
        for name in ("slope_deg_c_per_min", "acceleration_deg_per_s2", "rate_deg_per_s"):
            value = getattr(self, name)
            if value is not None and not value >= _LEAST_OF_ANY:
                raise BadInput(f"bound {name}={value:g}: give a positive number, {_LEAST_OF_ANY:g} or more")
        for least, most in (("least_deg_c", "most_deg_c"), ("least_v", "most_v")):
            low, high = getattr(self, least), getattr(self, most)
            if low is not None and high is not None and not low < high:
                raise BadInput(
                    f"bounds {least}={low:g} and {most}={high:g}: the first must be below the second; give both (what "
                    "is not given is what the unit has been through)"
                )

    @classmethod
    def of_runs(cls, runs: Sequence[RunBlocks], **given: Any) -> "StationBounds":
        """What the unit has been through in its runs, as far as it is not given."""
        known: dict[str, float] = {}
        if (temperatures := _range(runs, THERMAL[::-1], "degC")) is not None and np.ptp(
            temperatures
        ) > _LEAST_SWING_DEG_C:
            known["least_deg_c"], known["most_deg_c"] = (float(np.round(each)) for each in temperatures)
        rates = _range(runs, ("input_rate", "table_rate"), "deg/s")
        if rates is not None and (most := float(f"{np.abs(rates).max():.2g}")) > _LEAST_RATE_DEG_PER_S:
            known["rate_deg_per_s"] = most
        volts = _range(runs, ("supply_voltage",), "V")
        if volts is not None and np.ptp(volts) > 0.01 * abs(float(np.mean(volts))):
            known["least_v"], known["most_v"] = (float(np.round(each, 1)) for each in volts)
        return cls(**{**known, **{name: value for name, value in given.items() if value is not None}})

    @property
    def middle_deg_c(self) -> float:
        """Temperature at which a test begins; 25 degC where the chamber is not used."""
        return 25.0 if self.least_deg_c is None or self.most_deg_c is None else (self.least_deg_c + self.most_deg_c) / 2


def _range(runs: Sequence[RunBlocks], names: Sequence[str], unit: str) -> tuple[float, float] | None:
    """Range of the first of these channels that every run has in the unit in which stations are set."""
    for name in names:
        if all(name in run.channels and run.channels[name].unit_of_measure == unit for run in runs):
            values = np.concatenate([run.mean(name) for run in runs])
            if np.isfinite(values).any():
                return float(np.nanmin(values)), float(np.nanmax(values))
    return None
