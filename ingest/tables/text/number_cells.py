"""Cells of a text table that are nearly numbers: full-width, with a unit, with separators of thousands."""

import re

from ingest.tables.times import NUMBER
from ingest.tables.units import is_unit

_WIDE = "０１２３４５６７８９．－＋−"
_NARROW = str.maketrans(_WIDE, "0123456789.-+-")
_WIDE_NUMBER = re.compile(
    rf'(?m)(?P<before>(?:^|[,;\t"]) *)(?P<number>[{_WIDE}0-9.eE+-]*[{_WIDE}][{_WIDE}0-9.eE+-]*)(?= *(?:[,;\t"\r]|$))'
)
WIDE_MARKS = ("０".encode()[:2], "−".encode())  # first bytes of the full-width characters, and the sign of mathematics
_THOUSANDS = re.compile(r"[+-]?[0-9]{1,3}(?:,[0-9]{3})+(?:\.[0-9]*)?")
_WITH_UNIT = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?\s*([^0-9\s.,:;+-].*)")


def narrow_numbers(text: str) -> str:
    r"""Text in which the cells that are numbers in full-width characters are written in usual ones.

    >>> narrow_numbers("陀螺－００１,－０．５\n０,−1.5"), narrow_numbers("２０２６年")
    ('陀螺－００１,-0.5\n0,-1.5', '２０２６年')
    """
    return _WIDE_NUMBER.sub(lambda found: found["before"] + found["number"].translate(_NARROW), text)


def no_number(cell: str, delimiter: str = ",") -> str:
    """What a cell holds that is a number with more in it, and what to do; '' for all others.

    One comma may be that of decimals where commas do not separate the cells.

    >>> no_number("0.36728°/h")
    "numbers with their unit, as '0.36728°/h' (write the unit in the title, as [°/h])"
    >>> no_number("1,234,603")
    "numbers whose thousands are separated, as '1,234,603' (in Excel, format the column as numbers without separators)"
    >>> no_number("1.5"), no_number("1e-3"), no_number("2026-11-03"), no_number("8:05"), no_number("FOG-1")
    ('', '', '', '', '')
    """
    cell = cell.strip()
    if NUMBER.fullmatch(cell):
        return ""
    if _THOUSANDS.fullmatch(cell) and (delimiter == "," or cell.count(",") > 1):
        separated = f"numbers whose thousands are separated, as {cell!r}"
        return f"{separated} (in Excel, format the column as numbers without separators)"
    if (found := _WITH_UNIT.fullmatch(cell.replace(",", "."))) is not None and is_unit(found[1]):
        return f"numbers with their unit, as {cell!r} (write the unit in the title, as [{found[1]}])"
    return ""
