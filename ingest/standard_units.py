"""Units in which the uncertainty of a measurement standard may be stated; what has several meanings is refused.

A logarithm (dB, Np), a count, an information (B is the byte) and ppt are no share; a mil is one of several angles;
grad is a gon, and a degree in German. To all of them pint has a factor.
"""

import re
from typing import NamedTuple

from stream.errors import BadInput, UnknownUnit
from stream.quantities import check_unit, conversion, unit_parts

_SHARES = frozenset({"percent", "permille", "ppm"})
_ANGLES = frozenset({"degree", "radian", "turn", "arcminute", "arcsecond", "milliarcsecond", "grade"})
_TIMES = frozenset({"second", "minute", "hour", "day"})
_LENGTHS = frozenset({"meter"})
_TEMPERATURES = frozenset(f"{delta}degree_{scale}" for delta in ("", "delta_") for scale in ("Celsius", "Fahrenheit"))
_OTHERS = frozenset({"volt", "ampere", "watt", "hertz", "kelvin", "revolutions_per_minute"})
_ALL = _SHARES | _ANGLES | _TIMES | _LENGTHS | _TEMPERATURES | _OTHERS
_GRADE = re.compile(r"(?i)grad")


class _Kind(NamedTuple):
    """What fits a quantity."""

    words: str
    names: frozenset[str]  # of one of them to the first power, alone
    dimensions: tuple[frozenset[str], ...]  # the quotient of two of one of these is one too


_BY_KEPT = {
    "ppm": _Kind("1, %, permille, ppm, or a quotient as uV/V", _SHARES, (_ALL - _SHARES,)),
    "arcsec": _Kind("arcsec, arcmin, deg, rad, mrad, gon, or a slope as mm/m", _ANGLES, (_LENGTHS,)),
    "V": _Kind("V, mV, uV, nV", frozenset({"volt"}), ()),
    "degC": _Kind("degC, K, mK, degF", _TEMPERATURES | {"kelvin"}, ()),
    "s": _Kind("s, ms, us, ns, min, h", _TIMES, ()),
}  # fmt: skip


def factor_to_kept(unit: str, kept: str) -> float:
    """Factor from a stated unit to that in which the quantity is kept. Raises BadInput if it is none that fits.

    >>> factor_to_kept("mm/m", "arcsec"), factor_to_kept("′", "arcsec"), factor_to_kept("degF", "degC")
    (206.26480624709637, 60.0, 0.5555555555555556)
    """
    kind = _BY_KEPT[kept]
    try:
        plain = check_unit(unit)
        if _fits(plain, kind, kept):
            return conversion(plain, kept)[0]
        why = "does not fit or has several meanings"
    except UnknownUnit:
        why = "is not known"
    raise BadInput(f"{unit!r} {why}; it is kept in {kept}: write {kind.words}")


def _fits(unit: str, kind: _Kind, kept: str) -> bool:
    parts = unit_parts(unit)
    if not parts:
        return kept == "ppm"
    if _GRADE.search(unit):
        return False
    if len(parts) == 1:
        return parts[0].power == 1 and parts[0].name in kind.names
    names = {each.name for each in parts}
    alike = any(names <= each for each in kind.dimensions)
    angles = sum(each.power for each in parts if each.name in _ANGLES or each.name == "revolutions_per_minute")
    return alike and angles == 0
