"""Location and time zone of a station, as runs record them."""

import math
from collections.abc import Callable
from zoneinfo import ZoneInfo

import msgspec

from stream.errors import BadInput

_HIGHEST_M = 10_000.0
_DEEPEST_M = -5_000.0
# JJF and GJB stand on Earth: what lies outside is a slip of the unit
_GRAVITY_M_PER_S2 = (9.7, 9.9)


class StationLocation(msgspec.Struct, frozen=True, kw_only=True):
    """Location of a station; what is not known is None."""

    latitude_deg: float | None = None  # geodetic latitude, positive north
    time_zone: str | None = None  # IANA name, such as ``Asia/Shanghai``; it defines "the same day"
    altitude_m: float | None = None  # above the ellipsoid or the sea
    gravity_m_per_s2: float | None = None  # measured value; else it follows from latitude and altitude

    def check(self, named: Callable[[str], str]) -> "StationLocation":
        """Return it; raise BadInput, with fields as `named` names them, if it is no place on Earth."""
        for name, value, least, most, unit in (
            ("latitude_deg", self.latitude_deg, -90.0, 90.0, ""),
            ("altitude_m", self.altitude_m, _DEEPEST_M, _HIGHEST_M, " m"),
            ("gravity_m_per_s2", self.gravity_m_per_s2, *_GRAVITY_M_PER_S2, " m/s^2"),
        ):
            if value is not None and not least <= value <= most:
                raise BadInput(f"{named(name)} is {value:g}; it lies between {least:g} and {most:g}{unit}")
        if self.time_zone is not None:
            try:
                ZoneInfo(self.time_zone)
            except (ValueError, KeyError, OSError) as error:
                raise BadInput(
                    f"{named('time_zone')} is {self.time_zone!r}, which is not known; write it as Asia/Shanghai, or UTC"
                ) from error
        return self

    @property
    def details(self) -> dict[str, str]:
        """Details in the first document of a run."""
        gravity = self.gravity_m_per_s2
        if gravity is None and self.latitude_deg is not None and self.altitude_m is not None:
            gravity = normal_gravity_m_per_s2(self.latitude_deg, self.altitude_m)
        numbers = {
            "latitude_deg": None if self.latitude_deg is None else f"{self.latitude_deg:.10g}",
            "time_zone": self.time_zone,
            "altitude_m": None if self.altitude_m is None else f"{self.altitude_m:.10g}",
            "gravity_m_per_s2": None if gravity is None else f"{gravity:.6g}",
        }
        return {name: text for name, text in numbers.items() if text is not None}


def normal_gravity_m_per_s2(latitude_deg: float, altitude_m: float) -> float:
    """Gravity of the WGS 84 ellipsoid at a height above it (Somigliana's formula, second order in the height).

    >>> [round(normal_gravity_m_per_s2(latitude_deg, 0.0), 6) for latitude_deg in (0.0, 45.0, 90.0)]
    [9.780325, 9.806198, 9.832185]
    """
    square = math.sin(math.radians(latitude_deg)) ** 2
    at_ellipsoid = 9.7803253359 * (1 + 0.00193185265241 * square) / math.sqrt(1 - 0.00669437999013 * square)
    axis_m, flattening, ratio = 6_378_137.0, 1 / 298.257223563, 0.00344978650684
    height = altitude_m / axis_m
    return at_ellipsoid * (1 - 2 * (1 + flattening + ratio - 2 * flattening * square) * height + 3 * height**2)
