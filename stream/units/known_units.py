"""Units of measure that need no pint, whose import and definitions take longer than many commands."""

import math
from typing import NamedTuple


class Known(NamedTuple):
    """A unit that is read without pint."""

    quantity: str
    factor: float = 1.0  # to the first unit of the quantity
    offset: float = 0.0


KNOWN = {
    "deg/h": Known("angular rate"), "deg/s": Known("angular rate", 3600.0),
    "dps": Known("angular rate", 3600.0), "mdps": Known("angular rate", 3.6), "°/h": Known("angular rate"),
    "°/s": Known("angular rate", 3600.0), "deg/min": Known("angular rate", 60.0),
    "rad/s": Known("angular rate", math.degrees(3600.0)), "mrad/s": Known("angular rate", math.degrees(3.6)),
    "arcsec/s": Known("angular rate"), "rpm": Known("angular rate", 21600.0),
    "degC": Known("temperature"), "°C": Known("temperature"), "K": Known("temperature", 1.0, -273.15),
    "degF": Known("temperature", 5 / 9, -160 / 9),
    "V": Known("voltage"), "mV": Known("voltage", 1e-3), "A": Known("current"), "mA": Known("current", 1e-3),
    "uV": Known("voltage", 1e-6), "uA": Known("current", 1e-6), "W": Known("power"), "mW": Known("power", 1e-3),
    "Hz": Known("frequency"), "kHz": Known("frequency", 1e3), "MHz": Known("frequency", 1e6),
    "ns": Known("time"), "us": Known("time", 1e3), "ms": Known("time", 1e6), "s": Known("time", 1e9),
    "min": Known("time", 6e10), "h": Known("time", 3.6e12),
    "deg/s^2": Known("angular acceleration"), "T": Known("magnetic flux density", 1e6),
    "mT": Known("magnetic flux density", 1e3), "uT": Known("magnetic flux density"),
    "nT": Known("magnetic flux density", 1e-3), "Pa": Known("pressure"), "hPa": Known("pressure", 100.0),
    "mbar": Known("pressure", 100.0), "kPa": Known("pressure", 1e3), "bar": Known("pressure", 1e5),
    "deg": Known("angle"), "°": Known("angle"), "rad": Known("angle", math.degrees(1.0)),
    "mrad": Known("angle", math.degrees(1e-3)), "arcmin": Known("angle", 1 / 60), "arcsec": Known("angle", 1 / 3600),
    "g_0": Known("acceleration", 9.80665), "mg_0": Known("acceleration", 9.80665e-3),
    "ug_0": Known("acceleration", 9.80665e-6), "m/s^2": Known("acceleration"), "m/s²": Known("acceleration"),
    "1": Known("ratio"), "count": Known("count"), "LSB": Known("count"), "percent": Known("share"),
    "ppm": Known("share", 1e-4),
    "deg/(h)**0.5": Known("angle random walk"),
}  # fmt: skip
# to pint these are numbers, or numbers per second, all alike
NUMBERS = {"angle", "angular rate", "count", "frequency", "ratio", "share"}
