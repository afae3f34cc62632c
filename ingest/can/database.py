"""CAN databases (DBC and what else cantools reads): their messages, with names and units of measure as used here."""

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ingest.can.frames import EXTENDED
from stream.errors import BadInput, UnknownUnit
from stream.quantities import check_unit

if TYPE_CHECKING:
    from cantools.database.can import Message

SHORTEST_EXTENDED = 0x800

# What databases write, in lower case and without blanks; "°" has been made "deg" by then.
_UNITS = {
    **dict.fromkeys(("", "-", "none", "null", "na", "n/a", "unitless", "bool", "boolean", "flag", "enum", "hex"), "1"),
    **dict.fromkeys(("deg", "degree", "degrees"), "deg"),
    **dict.fromkeys(
        ("deg/s", "deg/sec", "degree/s", "degrees/s", "degree/sec", "degrees/sec", "dps", "degps"), "deg/s"
    ),
    **dict.fromkeys(("deg/h", "deg/hr", "deg/hour", "degree/h", "degrees/h", "dph"), "deg/h"),
    **dict.fromkeys(("rad/s", "rad/sec", "radps"), "rad/s"),
    **dict.fromkeys(("m/s^2", "m/s/s", "m/s2", "m/s**2", "m/sec^2", "m/s²", "mps2", "mpss", "(m/s)/s"), "m/s^2"),
    **dict.fromkeys(("m/s", "mps", "m/sec"), "m/s"),
    **dict.fromkeys(("km/h", "kph", "kmh", "km/hr", "kmph"), "km/h"),
    **dict.fromkeys(("degc", "celsius", "cel", "degcelsius", "c"), "degC"),
    **dict.fromkeys(("degf", "fahrenheit"), "degF"),
    **dict.fromkeys(("%", "percent", "pct"), "percent"),
    **dict.fromkeys(("rpm", "1/min", "u/min", "rev/min"), "rpm"),
    **dict.fromkeys(("sec", "second", "seconds"), "s"),
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("amp", "amps", "ampere"), "A"),
    **dict.fromkeys(("hours", "hrs"), "hour"),
    **dict.fromkeys(("minutes", "mins"), "minute"),
    **dict.fromkeys(("lsb", "lsbs"), "LSB"),
    **dict.fromkeys(("counts", "cnt", "cnts", "raw"), "count"),
    **dict.fromkeys(("gauss",), "gauss"),
}
_REFUSED = re.compile(r"[\s/*$?#@\x00-\x1f]+")


def load_messages(paths: Sequence[Path]) -> "list[Message]":
    """Messages of the databases, in their order.

    Raises
    ------
    BadInput: If one cannot be read.
    """
    import cantools

    found: list[Message] = []
    for path in paths:
        try:
            # real databases overlap signals and overrun messages here and there; that spoils no other signal
            database = cantools.database.load_file(path, strict=False, encoding=_encoding(path))
        except FileNotFoundError as error:
            raise BadInput(f"{path}: no such file; give a CAN database (.dbc)") from error
        except Exception as error:  # parsers raise whatever bad text leads to
            raise BadInput(_told(path, error)) from error
        if not isinstance(database, cantools.database.can.Database):
            raise BadInput(f"{path}: holds diagnostics, not messages; give a CAN database (.dbc)")
        found += database.messages
    return found


def _told(path: Path, error: Exception) -> str:
    """What is wrong with a database, where, and what to do about it, around the words of the parser."""
    from cantools.database.errors import UnsupportedDatabaseFormatError

    said = " ".join(str(error).split())
    line = re.search(r"\bline (\d+)", said)
    cause = getattr(error, "e_dbc", None)
    if isinstance(cause, KeyError):
        said = f"it uses {cause.args[0]}, which it does not define"
    elif ">>!<<" in said:
        said = f"the parser stopped at the mark >>!<<, {said}"
    is_database = isinstance(error, UnsupportedDatabaseFormatError)
    todo = "mend that, or export it anew from the tool it comes from" if is_database else "give a CAN database (.dbc)"
    return f"{path}: {f'line {line[1]}: ' if line else ''}cannot be read as a CAN database ({said}); {todo}"


def _encoding(path: Path) -> str | None:
    """Databases are of Windows' code page by tradition (cantools' own choice), of UTF-8 more and more."""
    content = path.read_bytes()
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return None
    return "utf-8-sig" if content.startswith(b"\xef\xbb\xbf") else "utf-8"


def arbitration_id(identifier: int, *, is_extended: bool) -> int:
    """An identifier as frames carry it here: bit 31 says that it is of 29 bits, as any beyond 0x7FF must be.

    Examples
    --------
    >>> hex(arbitration_id(0x24, is_extended=False)), hex(arbitration_id(0x900, is_extended=False))
    ('0x24', '0x80000900')
    """
    return identifier | EXTENDED if is_extended or identifier >= SHORTEST_EXTENDED else identifier


def id_text(identifier: int) -> str:
    """An arbitration id for people: ``0x024``, or ``0x17F00010`` where it is of 29 bits.

    Examples
    --------
    >>> id_text(0x24), id_text(0x24 | EXTENDED)
    ('0x024', '0x00000024')
    """
    return f"0x{identifier & ~EXTENDED:08X}" if identifier & EXTENDED else f"0x{identifier:03X}"


def unit_of_measure(text: str | None, signal: str) -> tuple[str, bool]:
    """Unit of measure as gyrofleet writes it, and whether it is known; an unknown one stays as it is.

    In a database "g" on an acceleration is standard gravity, not gram, and "C" a temperature, not coulomb.

    Examples
    --------
    >>> unit_of_measure("°/s", "YawRate"), unit_of_measure("smoots", "Length"), unit_of_measure("g", "AccX")
    (('deg/s', True), ('smoots', False), ('g_0', True))
    """
    written = (text or "").strip()
    plain = re.sub(r"\s+", "", written).replace("°", "deg").replace("º", "deg").replace("grad/s", "deg/s").lower()
    if plain in {"g", "gn", "g0"} and "acc" in signal.lower():
        return "g_0", True
    if plain in _UNITS:
        return _UNITS[plain], True
    try:
        return check_unit(written), True
    except UnknownUnit:
        return written, False


def own_names(messages: "Sequence[Message]") -> dict[tuple[str, str], str]:
    """Name of every signal by message and signal: in lower case, `message.signal` where one occurs twice."""
    pairs = [(message.name, signal.name) for message in messages for signal in message.signals]
    often = Counter(signal.lower() for _, signal in pairs)
    names = {
        (message, signal): _clean(signal if often[signal.lower()] == 1 else f"{message}.{signal}").lower()
        for message, signal in pairs
    }
    # what differs in nothing but case keeps it
    again = Counter(names.values())
    return {pair: name if again[name] == 1 else _clean(f"{pair[0]}.{pair[1]}") for pair, name in names.items()}


def _clean(name: str) -> str:
    return _REFUSED.sub("_", name).lstrip(".")
