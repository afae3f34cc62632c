"""Units of measure in the writing of D-SI (https://ptb.de/si)."""

import tomllib
from importlib.resources import files

from stream.errors import UnknownUnit
from stream.quantities import UnitPart, unit_parts

_WRITING = tomllib.loads(files("analytics.certificate.document").joinpath("si_units.toml").read_text(encoding="utf-8"))
_NAMES = {name: written for name, written in _WRITING["units"].items() if isinstance(written, str)}
_PREFIXED: dict[str, str] = _WRITING["units"]["with_prefixes"]
_PREFIXES: dict[str, str] = _WRITING["prefixes"]
_COUNTS = frozenset(name for name, written in _NAMES.items() if not written)


def si_unit(unit_of_measure: str) -> str | None:
    r"""A unit of measure in D-SI; None where that has none.

    >>> si_unit("V/(deg/s)"), si_unit("deg/sqrt(h)"), si_unit("count"), si_unit("deg/h/g")
    ('\\volt\\degree\\tothe{-1}\\second', '\\degree\\hour\\tothe{-0.5}', '\\one', None)
    """
    if "g" in unit_of_measure.split("/"):  # of gravity, to which D-SI has no name; a reader of units takes it for gram
        return None
    try:
        written = [_written(each) for each in unit_parts(unit_of_measure)]
    except UnknownUnit:
        return None
    known = [each for each in written if each is not None]
    return None if len(known) < len(written) else "".join(known) or r"\one"


def counts_in(unit_of_measure: str) -> bool:
    """Whether a unit has counts, which are no unit in D-SI.

    >>> counts_in("LSB/(deg/s)"), counts_in("V/(deg/s)")
    (True, False)
    """
    return any(each.name in _COUNTS for each in unit_parts(unit_of_measure))


def _written(part: UnitPart) -> str | None:
    name = _PREFIXED.get(part.name) if part.prefix else _NAMES.get(part.name, _PREFIXED.get(part.name))
    prefix = _PREFIXES.get(part.prefix) if part.prefix else ""
    if name is None or prefix is None or (part.name == "degree_Celsius" and part.power != 1):
        return None
    power = "" if part.power == 1 or not name else f"\\tothe{{{part.power:g}}}"
    return f"{prefix}{name}{power}"
