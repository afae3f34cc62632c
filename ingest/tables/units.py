"""Units of measure as files write them, and the quantity that a signal's name leads to expect."""

import re
from collections.abc import Callable
from functools import lru_cache

from stream.errors import BadInput, UnknownUnit
from stream.quantities import check_unit, conversion, is_angular_rate, plain_unit, result_factor

COUNT_UNITS = frozenset({"count", "LSB"})

# What files and databases write, in lower case and without blanks, "°" written as "deg".
_SPELLINGS = {
    "1": "- none null na n/a unitless bool boolean flag enum hex",
    "deg": "deg degree degrees",
    "deg/s": "deg/s deg/sec degree/s degrees/s degree/sec degrees/sec dps degps",
    "deg/h": "deg/h deg/hr deg/hour degree/h degrees/h dph",
    "rad/s": "rad/s rad/sec radps",
    "m/s^2": "m/s^2 m/s/s m/s2 m/s**2 m/sec^2 m/s² mps2 mpss (m/s)/s",
    "m/s": "m/s mps m/sec",
    "km/h": "km/h kph kmh km/hr kmph",
    "degC": "degc celsius cel degcelsius c",
    "degF": "degf fahrenheit",
    "percent": "% percent pct",
    "rpm": "rpm 1/min u/min rev/min",
    "s": "s sec second seconds",
    "V": "volt volts",
    "A": "amp amps ampere",
    "hour": "hours hrs",
    "minute": "minutes mins",
    "LSB": "lsb lsbs",
    "count": "counts cnt cnts raw",
    "gauss": "gauss",
}
_UNITS = {"": "1"} | {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings.split()}
_UNITS |= {
    "pulse": "count", "pulses": "count", "pulse/s": "count/s", "pulses/s": "count/s", "r/min": "rpm", "r/分": "rpm",
    "r/s": "turn/s",
}  # fmt: skip
_GRAVITY = {"g": "g_0", "gn": "g_0", "g0": "g_0", "mg": "mg_0", "ug": "ug_0", "µg": "ug_0", "μg": "ug_0"}
_MASSES = {"g", "mg", "ug", "µg", "μg"}  # pint reads them as gram
_GERMAN_DEGREE = re.compile("[Gg]rad(?![a-z])")  # pint reads Grad as gigaradian, grad as gradian
_MOST_OF_A_UNIT = 1e5  # deg/s, V or A: more is a prefix in the wrong case
_PER_TIME = ("m/s", "m/s^2", "count/s", "K/s")
_RAW = ("1", "count", "V", "A", "Hz")
_AXIS = r"(?:[_.]?(?:[xyz]|\d+))?"
_EXPECTED: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    (
        r"(?:angular_)?rate|gyro|omega|.*角速[率度].*|(?:[xyz]轴?)?陀螺仪?(?:输出)?",
        "an angular rate",
        ("deg/s", "deg/h", "rad/s"),
    ),
    (r"acc|accel|acceleration|(?:[xyz]轴?)?(?:加速度计?|加计|加表)(?:输出)?", "an acceleration", ("g_0", "m/s^2")),
    (r"temp|temperature|.*温度?", "a temperature", ("degC", "K")),
    (r"(?:supply_)?voltage|.*电压", "a voltage", ("V",)),
    (r"(?:supply_)?current|.*电流", "a current", ("A",)),
    (r"pressure", "a pressure", ("Pa", "hPa")),
)


def database_unit(text: str | None, signal: str) -> tuple[str, bool]:
    """Unit of a CAN database as gyrofleet writes it, and whether it is known; an unknown one stays as it is.

    In a database "g" on an acceleration is standard gravity, not gram, and "C" a temperature, not coulomb.

    >>> database_unit("°/s", "YawRate"), database_unit("smoots", "Length"), database_unit("mg", "AccX")
    (('deg/s', True), ('smoots', False), ('mg_0', True))
    """
    written = (text or "").strip()
    plain = _plain(written)
    if plain in _GRAVITY and _is_acceleration(signal):
        return _GRAVITY[plain], True
    if plain in _UNITS:
        return _UNITS[plain], True
    try:
        return check_unit(_GERMAN_DEGREE.sub("deg", written)), True
    except UnknownUnit:
        return written, False


def database_remark(text: str | None, unit: str, signal: str) -> str:
    """What a reader must know of a unit that `database_unit` has found; '' for nothing.

    >>> database_remark("furlong", "furlong", "rate")
    "'rate' is expected to be an angular rate, in deg/s, deg/h or rad/s; furlong is another quantity"
    >>> database_remark("g", "g", "load")
    "'g' is taken as a mass; give it unit_of_measure = 'g_0' in a mapping if it is standard gravity"
    >>> database_remark("grad/s", "deg/s", "rate")
    "'grad/s' is taken as deg/s (German Grad, a degree); give it unit_of_measure = 'gon/s' in a mapping for gradians"
    """
    written = (text or "").strip()
    if _GERMAN_DEGREE.match(written) and not is_temperature(unit):
        gradian = _GERMAN_DEGREE.sub("gon", written)
        taken = (
            f"{written!r} is taken as {unit} (German Grad, a degree); give it unit_of_measure = {gradian!r} in a "
            "mapping for gradians"
        )
        return "; ".join(filter(None, (_unexpected(unit, signal).removeprefix("warning: "), taken)))
    if unit == written and written in _MASSES and not _is_mass(signal):
        return (
            f"{written!r} is taken as a mass; give it unit_of_measure = {_GRAVITY[written]!r} in a mapping if it is "
            "standard gravity"
        )
    return _unexpected(unit, signal).removeprefix("warning: ")


def is_same_unit(one: str, other: str) -> bool:
    """Whether two texts, as files write them, name one unit of measure.

    >>> is_same_unit("°/s", "deg/s"), is_same_unit("s", "sec"), is_same_unit("s", "ms"), is_same_unit("s", "V")
    (True, True, False, False)
    """
    names = [time_unit(each) for each in (one, other)]
    try:
        return names[0] == names[1] or conversion(names[0], names[1]) == (1.0, 0.0)
    except UnknownUnit:
        return False


def is_unit(text: str) -> bool:
    """Whether a text is a unit of measure, as files write it.

    >>> is_unit("°/s"), is_unit("ms"), is_unit("脉冲"), is_unit("rate_x")
    (True, True, True, False)
    """
    if _plain(text) in _UNITS or _plain(text) in _GRAVITY:
        return True
    try:
        check_unit(text)
    except UnknownUnit:
        return False
    return True


@lru_cache(maxsize=4096)  # files of one command have the same titles
def column_unit(text: str, signal: str) -> tuple[str, str]:
    """Unit of a column of a table, and a remark if it was interpreted or does not suit the signal; else ''.

    A unit that pint knows stays as it is written.

    >>> column_unit("dps", "rate"), column_unit("dph", "rate")
    (('dps', ''), ('deg/h', ''))
    >>> column_unit("g", "acceleration_x")
    ('g_0', "g is taken as standard gravity (g_0), since 'acceleration_x' is an acceleration")
    >>> column_unit("furlong", "rate")[1]
    "warning: 'rate' is expected to be an angular rate, in deg/s, deg/h or rad/s; furlong is another quantity"
    """
    written = text.strip()
    plain = _plain(written)
    if plain in _GRAVITY and _is_acceleration(signal):
        unit = _GRAVITY[plain]
        return unit, f"{written} is taken as standard gravity ({unit}), since {signal!r} is an acceleration"
    if written in _MASSES and not _is_mass(signal):
        raise BadInput(
            f"unit {written!r} may be standard gravity or a mass; write {_GRAVITY[written]!r} for gravity, "
            f"{written.replace('g', 'gram')!r} for a mass"
        )
    if (written == "度" or plain in {"c", "f"}) and re.match("temp|.*温", signal.lower()):
        unit = "degF" if plain == "f" else "degC"
        return unit, f"{written} is taken as {unit}, since {signal!r} is a temperature"
    unit = known_unit(written)
    if _GERMAN_DEGREE.match(written) and not is_temperature(unit):
        taken = f"{written} is taken as {unit} (German Grad, a degree); write gon for gradians"
        return unit, "; ".join(filter(None, (_unexpected(unit, signal), taken)))
    for base in ("deg/s", "V", "A"):
        if _converts(unit, base, result_factor) and (of_unit := result_factor(unit, base)) > _MOST_OF_A_UNIT:
            raise BadInput(
                f"unit {written!r} is {of_unit:.3g} {base}: M is mega and G is giga; write "
                f"{written[0].lower() + written[1:]!r} if that is meant, or another unit"
            )
    return unit, _unexpected(unit, signal)


def known_unit(text: str) -> str:
    """A unit of measure as it is written, or as gyrofleet writes it if pint does not know that; else UnknownUnit.

    >>> known_unit("deg/s"), known_unit("度/小时"), known_unit("dph"), known_unit("°/S"), known_unit("deg C")
    ('deg/s', 'deg/h', 'deg/h', '°/s', 'degC')
    """
    written = text.strip()
    plain = _plain(written)
    if plain in {"deg/s", "deg/h"} and written[-1].isupper():  # to pint siemens and henry
        written = written.lower()
    is_apart = plain in {"degc", "degf"} and len(written.split()) > 1
    if is_apart or (_GERMAN_DEGREE.match(written) and plain in _UNITS):  # deg C, where pint reads a degree by coulomb
        return _UNITS[plain]
    try:
        return check_unit(_GERMAN_DEGREE.sub("deg", written))
    except UnknownUnit:
        if plain not in _UNITS:
            raise
        return _UNITS[plain]


def is_per_time(text: str) -> bool:
    """Whether a text is a unit of what gyros, accelerometers and tables give in a time, such as an angular rate.

    >>> [is_per_time(each) for each in ("deg/h", "r/min", "m/s", "m/s²", "脉冲/秒", "T/℃", "V/s", "s", "2 deg/s")]
    [True, True, True, True, True, False, False, False, False]
    """
    try:
        unit = known_unit(text)
    except BadInput:
        return False
    return is_angular_rate(unit) or any(_converts(unit, each, result_factor) for each in _PER_TIME)


def is_time_unit(text: str) -> bool:
    """Whether a text is a unit of time."""
    return _converts(time_unit(text), "s", result_factor)


def time_unit(text: str) -> str:
    """A unit of time as files write it, such as ``秒``, as units are written here."""
    return _UNITS.get(_plain(text), plain_unit(text).strip())


def is_temperature(unit: str) -> bool:
    """Whether a unit of measure is one of temperature.

    >>> is_temperature("K"), is_temperature("V")
    (True, False)
    """
    return _converts(unit, "degC", conversion)


def _plain(written: str) -> str:
    plain = re.sub(r"\s+", "", plain_unit(written)).replace("°", "deg").replace("º", "deg")
    return _GERMAN_DEGREE.sub("deg", plain).lower()


def _is_acceleration(signal: str) -> bool:
    return "acc" in signal.lower() or re.search("加速度|加计|加表", signal) is not None


def _is_mass(signal: str) -> bool:
    return re.search("mass|weight", signal.lower()) is not None


def _unexpected(unit: str, signal: str) -> str:
    """A warning if the unit does not suit the signal's name; raw outputs (counts, V, A, Hz) suit any."""
    for pattern, quantity, units in _EXPECTED:
        if re.fullmatch(f"(?:{pattern}){_AXIS}", signal.lower()):
            is_rate = units[0] == "deg/s"
            convert = conversion if quantity == "a temperature" else result_factor
            suits = is_angular_rate(unit) if is_rate else _converts(unit, units[0], convert)
            if not suits and not any(_converts(unit, raw, result_factor) for raw in _RAW):
                known = " or ".join(filter(None, [", ".join(units[:-1]), units[-1]]))
                return f"warning: {signal!r} is expected to be {quantity}, in {known}; {unit} is another quantity"
    return ""


def expected_unit(signal: str) -> str:
    """The unit that a signal of this name has as a rule; '' where none is usual, as of angular rates."""
    of = (units[0] for pattern, _, units in _EXPECTED if re.fullmatch(f"(?:{pattern}){_AXIS}", signal.lower()))
    found = next(of, "")
    return "" if found == "deg/s" else found


def _converts(source: str, target: str, convert: Callable[[str, str], object]) -> bool:
    try:
        convert(source, target)
    except UnknownUnit:
        return False
    return True
