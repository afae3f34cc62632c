"""Units of measure: parsed at the border, stored as the source wrote them, reported as the standards require."""

import difflib
import re
import threading
from functools import cache
from typing import TYPE_CHECKING, NamedTuple, cast

from stream.errors import UnknownUnit
from stream.units.chinese_units import chinese_unit
from stream.units.known_units import KNOWN, NUMBERS

if TYPE_CHECKING:
    import pint

ANGULAR_RATE_UNIT = "deg/h"

_ANGLES = frozenset({"degree", "radian", "turn", "arcminute", "arcsecond", "milliarcsecond", "grade", "milliradian"})
_ROTATIONS = frozenset({"revolutions_per_minute", "revolutions_per_second", "dps"})
_SIDE = re.compile(r"(.*?)\s*,\s*(one|two)-sided\s*")
_ROOT = re.compile(r"sqrt\(([^()]+)\)")
_ROOT_SIGN = re.compile(r"(?:√|(?<![A-Za-z])rt)(?:\(([^()]+)\)|(?<=√)([A-Za-z]+))|(?<![A-Za-z])rt(Hz|h|hr)\b")
_PLAIN = {0xFF01 + at: chr(0x21 + at) for at in range(94)} | {
    ord("℃"): "degC", ord("℉"): "degF", ord("∕"): "/", ord("⁄"): "/", ord("˚"): "°", ord("−"): "-", ord("″"): "arcsec",
    ord("′"): "arcmin", ord("‰"): "permille", 0x3000: " ",
}  # fmt: skip
_STRANGE = re.compile(r"[^A-Za-z0-9\s._*/^()+\-%°ºµμΩΩÅ²³¹⁰⁴⁵⁶⁷⁸⁹⁻·⋅×]")
_HIGH_POWER = re.compile(r"\d{4}|(?:\*\*|\^).*(?:\*\*|\^)[^A-Za-z]*$|(?<![\w.])[\d.]+\s*(?:\*\*|\^)")
_LONGEST = 100
_COMMON = (
    *("deg/s", "deg/h", "rad/s", "rad/h", "arcsec/s", "rpm", "degC", "K", "V", "mV", "A", "mA", "W", "g_0", "m/s^2"),
    *("T", "nT", "Hz", "s", "ms", "count", "LSB", "Pa", "hPa", "percent", "ohm", "Mohm", "1"),
)
# one or two of each quantity that is measured
_LISTED = ("deg/s", "deg/h", "rad/s", "g_0", "m/s^2", "degC", "V", "mA", "ohm", "Mohm", "Hz", "s", "count", "Pa", "1")


_one_defines = threading.Lock()


def _registry() -> "pint.UnitRegistry[float]":
    with _one_defines:  # quantities of two registries do not mix
        return _defined()


@cache
def _defined() -> "pint.UnitRegistry[float]":
    import pint

    registry: pint.UnitRegistry[float] = pint.UnitRegistry(cache_folder=None, on_redefinition="ignore")
    registry.define("mil = π / 3200 * radian")  # pint has a tenth of it
    registry.define("LSB = count")
    registry.define("dps = degree / second")
    return registry


def read_definitions() -> None:
    """Read the definitions of all units now: the first unit of measure that is not a usual one waits for them."""
    _powers("deg/h/degC")


def plain_unit(text: str) -> str:
    """A unit in the letters that units have here: Chinese words, full-width letters and roots are written otherwise.

    >>> plain_unit("°／h"), plain_unit("℃"), plain_unit("°/√h"), plain_unit("°/√(h)"), plain_unit("mdps/rtHz")
    ('°/h', 'degC', '°/sqrt(h)', '°/sqrt(h)', 'mdps/sqrt(Hz)')
    >>> plain_unit("度每小时"), plain_unit("兆欧")
    ('deg/h', 'Mohm')
    """
    plain = text.translate(_PLAIN)
    if (word := chinese_unit(plain)) is not None:
        return word
    return _ROOT_SIGN.sub(lambda match: f"sqrt({match[1] or match[2] or match[3]})", plain)


@cache
def check_unit(text: str) -> str:
    """Return `text` if it is a unit of measure that pint can parse; an empty text means dimensionless, ``1``.

    Raises a UnknownUnit if it is none; the message names similar units.

    >>> check_unit("deg/s")
    'deg/s'
    """
    if text.strip() in {"", "1"}:
        return "1"
    text = plain_unit(text)
    if text in KNOWN:
        return text
    try:
        if len(text) > _LONGEST or _HIGH_POWER.search(text):  # hours of arithmetic
            raise ValueError(text)
        if strange := _STRANGE.search(_ROOT.sub(r"(\1)**0.5", text)):  # pint would leave it out in silence
            raise ValueError(strange[0])
        _registry().parse_units(text)
    except Exception as error:
        near = difflib.get_close_matches(text, _COMMON, n=3, cutoff=0.5)
        hint = f"did you mean {', '.join(near)}?" if near else f"known units are: {', '.join(_LISTED)}"
        raise UnknownUnit(f"unit of measure {text!r} is not known; {hint}") from error
    return text


@cache
def conversion(source: str, target: str) -> tuple[float, float]:
    """Factor and offset that convert a value from `source` to `target` units; an UnknownUnit if it is not possible.

    >>> conversion("deg/s", "deg/h")
    (3600.0, 0.0)
    """
    if source == target:
        return 1.0, 0.0
    source, target = check_unit(source), check_unit(target)
    if (known := _known_conversion(source, target)) is not None:
        return known
    quantity = _registry().Quantity
    from pint.errors import PintError

    try:
        zero = quantity(0.0, _unit(source)).to(_unit(target)).magnitude
        one = quantity(1.0, _unit(source)).to(_unit(target)).magnitude
    except (PintError, ArithmeticError, AssertionError) as error:  # the last for parts of logarithms, as in dB*degC
        raise _no_conversion(source, target) from error
    factor = float(one - zero)
    # a factor of exactly 3600 comes out of pint as 3599.9999999999995
    return (float(round(factor)) if abs(factor - round(factor)) < 1e-12 * abs(factor) else factor), float(zero)


def side_of(text: str) -> tuple[str, str | None]:
    """A unit of a noise density without its side, and the side: ``one``, ``two``, or None where none is named.

    >>> side_of("mdps/sqrt(Hz), one-sided"), side_of("deg/h")
    (('mdps/sqrt(Hz)', 'one'), ('deg/h', None))
    """
    match = _SIDE.fullmatch(text)
    return (match[1], match[2]) if match else (text, None)


@cache
def is_noise_density(text: str) -> bool:
    """Whether `text` is per root of a frequency.

    >>> is_noise_density("mdps/sqrt(Hz)"), is_noise_density("deg/sqrt(h)"), is_noise_density("deg/h")
    (True, False, False)
    """
    text, _ = side_of(text)
    if "hz" not in text.lower() and "hertz" not in text.lower():
        return False
    return _powers(_ROOT.sub(r"(\1)**0.5", plain_unit(text))).get("hertz") == -0.5


@cache
def is_angular_rate(text: str) -> bool:
    """Whether `text` measures an angle per time; False for an unknown unit, as CAN databases may have.

    To pint angles are dimensionless, so that deg/s and Hz have one dimension: angles are recognised by name.

    >>> is_angular_rate("rad/s"), is_angular_rate("Hz"), is_angular_rate("rpm"), is_angular_rate("mdps")
    (True, False, True, True)
    >>> is_angular_rate("smoots")
    False
    """
    if (known := KNOWN.get(text)) is not None:
        return known.quantity == "angular rate"
    try:
        unit = _unit(text)
    except UnknownUnit:
        return False
    powers = _powers(text)
    angles = [power for name, power in powers.items() if name in _ANGLES]
    is_rotation = any(name in _ROTATIONS for name in powers)
    return (angles == [1] or is_rotation) and unit.dimensionality == _unit("1/s").dimensionality


@cache
def report_unit(text: str) -> tuple[str, float]:
    """Unit in which results on a signal in `text` are reported, and the factor to it, without offset.

    Angular rates are reported in deg/h, everything else in its own unit, also where that is unknown.

    >>> report_unit("deg/s"), report_unit("degC")
    (('deg/h', 3600.0), ('degC', 1.0))
    """
    if is_angular_rate(text):
        return ANGULAR_RATE_UNIT, conversion(text, ANGULAR_RATE_UNIT)[0]
    return text, 1.0


@cache
def result_factor(source: str, target: str) -> float:
    """Factor between two units of results, such as ``deg/sqrt(h)`` and ``ppm/degC``; an UnknownUnit if there is none.

    Here an angle has a dimension: Hz is not deg/h, and ppm not arcsec. A noise density that is one-sided is sqrt(2)
    times the coefficient of the walk, whose spectrum N**2 is two-sided (IEEE 952-1997 annex C.1.1).

    >>> result_factor("deg/sqrt(h)", "deg/sqrt(s)") * 60
    1.0
    >>> round(result_factor("mdps/sqrt(Hz), one-sided", "deg/sqrt(h)") * 12, 4)
    0.5091
    >>> result_factor("deg/h", "Hz")
    Traceback (most recent call last):
    stream.errors.UnknownUnit: 'deg/h' cannot be converted to 'Hz': they measure different quantities
    >>> result_factor("V/sqrt(h)", "deg/sqrt(h)")
    Traceback (most recent call last):
    stream.errors.UnknownUnit: 'V/sqrt(h)' cannot be converted to 'deg/sqrt(h)': they measure different quantities
    """
    if source == target:
        return 1.0
    (source, of_source), (target, of_target) = side_of(source), side_of(target)
    roots = (of_target == "one") - (of_source == "one")
    return _plain_factor(source, target) * float(2.0 ** (roots / 2))


def _plain_factor(source: str, target: str) -> float:
    if source == target:
        return 1.0
    plain = [_ROOT.sub(r"(\1)**0.5", plain_unit(check_result_unit(text))) for text in (source, target)]
    if (known := _known_conversion(*plain)) is not None and known[1] == 0.0:
        return known[0]
    try:
        factor, offset = conversion(plain[0], plain[1])
    except UnknownUnit as error:
        raise _no_conversion(source, target) from error
    if offset != 0.0 or _angles(plain[0]) != _angles(plain[1]):
        raise _no_conversion(source, target)
    return factor


def _no_conversion(source: str, target: str) -> UnknownUnit:
    return UnknownUnit(f"{source!r} cannot be converted to {target!r}: they measure different quantities")


def _known_conversion(source: str, target: str) -> tuple[float, float] | None:
    one, other = KNOWN.get(source), KNOWN.get(target)
    if one is None or other is None or (one.quantity != other.quantity and {one.quantity, other.quantity} <= NUMBERS):
        return None
    if one.quantity != other.quantity:
        raise _no_conversion(source, target)
    return one.factor / other.factor, (one.offset - other.offset) / other.factor


def check_result_unit(text: str) -> str:
    """Return `text` if it is a unit of a result: like `check_unit`, and ``sqrt(h)`` is allowed.

    >>> check_result_unit("deg/sqrt(h)")
    'deg/sqrt(h)'
    """
    plain, side = side_of(text)
    check_unit(_ROOT.sub(r"(\1)**0.5", plain_unit(plain)))
    if side is not None and not is_noise_density(plain):
        raise UnknownUnit(f"{text!r}: only a noise density, as deg/s/sqrt(Hz), is one- or two-sided")
    return text


def _angles(text: str) -> float:
    """The power of angles in a unit."""
    powers = _powers(text)
    return float(sum(power for name, power in powers.items() if name in _ANGLES or name in _ROTATIONS))


class UnitPart(NamedTuple):
    """A part of a unit, as volt, its prefix, as milli or none, and its power."""

    prefix: str
    name: str
    power: float


def unit_parts(text: str) -> list[UnitPart]:
    """The parts of a unit of a result; an UnknownUnit if it is none.

    >>> unit_parts("mV/sqrt(h)")
    [UnitPart(prefix='milli', name='volt', power=1.0), UnitPart(prefix='', name='hour', power=-0.5)]
    """
    # pint has no public way to the parts of a unit
    powers = cast("dict[str, float]", dict(_unit(_ROOT.sub(r"(\1)**0.5", plain_unit(text)))._units))  # noqa: SLF001
    found = []
    for name, power in powers.items():
        prefix, plain, _ = (*_registry().parse_unit_name(name), ("", name, ""))[0]
        found.append(UnitPart(prefix, plain, float(power)))
    return found


def _powers(text: str) -> dict[str, float]:
    """The parts of a unit without prefixes, such as milli in mdps, and their powers."""
    found: dict[str, float] = {}
    for _, name, power in unit_parts(text):
        found[name] = found.get(name, 0.0) + power
    return found


def _unit(text: str) -> "pint.Unit":
    plain = check_unit(text)
    return _registry().parse_units("" if plain == "1" else plain)


def format_unit(unit_of_measure: str | None) -> str:
    """A unit of measure for display; empty for a dimensionless number.

    >>> format_unit("deg/h/(degC/s)"), format_unit("1")
    ('deg/h/(degC/s)', '')
    """
    return "" if unit_of_measure in (None, "", "1") else str(unit_of_measure)
