"""Encodings of text in which a table is not read, and how to convert it."""

import codecs
import shlex
from pathlib import Path

_MANY = 0.3  # of the characters, as digits and separators are
_FEW = 0.02


def utf16_of(begin: bytes) -> str | None:
    """The UTF-16 in which a text is by its first bytes, also without a byte-order mark; None if it is in another one.

    Half of the bytes of digits and Latin letters are zero in it, those at odd places or those at even ones.

    >>> [utf16_of("time[s],rate[deg/s]".encode(each)) for each in ("utf-16-le", "utf-16-be", "utf-8")]
    ['UTF-16LE', 'UTF-16BE', None]
    """
    if begin.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "UTF-16"
    pairs = max(1, len(begin) // 2)
    at_even, at_odd = (begin[first::2].count(0) / pairs for first in (0, 1))
    if at_odd > _MANY and at_even < _FEW:
        return "UTF-16LE"
    return "UTF-16BE" if at_even > _MANY and at_odd < _FEW else None


def how_to_convert(path: Path, encoding: str) -> str:
    """The end of a message on a file in another encoding.

    >>> how_to_convert(Path("a.csv"), "UTF-16LE")
    "save it as UTF-8 ('CSV UTF-8' in Excel), or convert it: iconv -f UTF-16LE -t UTF-8 a.csv > a-utf8.csv"
    """
    other = path.with_name(f"{path.stem}-utf8{path.suffix}")
    command = f"iconv -f {encoding} -t UTF-8 {shlex.quote(str(path))} > {shlex.quote(str(other))}"
    return f"save it as UTF-8 ('CSV UTF-8' in Excel), or convert it: {command}"
