"""Which axis of its device a signal is of, by its name, and which signals of a device are its own outputs."""

import re

from stream.errors import UnknownUnit
from stream.quantities import conversion, is_angular_rate

_RATE_WORDS = "rate|gyro|gyr|omega|velocity|vel|spin|turn"
_LETTER_APART = re.compile(r"(?:^|_)([xyz])(?=_|$)")
_LETTER_JOINED = re.compile(rf"(?:(?:{_RATE_WORDS}|^w|_w)([xyz])(?=_|$))|(?:(?:^|_)([xyz])(?={_RATE_WORDS}))")
_REFERENCE = re.compile(r"table|stage|fixture|reference|command|set_?point|input|(?:^|_)ref(?:_|$)")
_AXIS_WORD = re.compile(
    r"(?P<before>[+-]?)(?:axis_)?(?P<name>[xyz]|i|ia|ira|input|o|oa|ora|output|s|sa|sra|spin)(?:_axis)?(?P<after>[+-]?)"
)
_INPUT = frozenset({"i", "ia", "ira", "input"})


def signal_axis(signal: str) -> str | None:
    """Axis of its device that a signal is of: ``x``, ``y`` or ``z``; None where its name does not say.

    Examples
    --------
    >>> [signal_axis(name) for name in ("rate_x", "angularratey", "gyro_z_filtered", "xrate", "rate", "temperature")]
    ['x', 'y', 'z', 'x', None, None]
    """
    name = signal.lower()
    found = {letter for match in _LETTER_APART.finditer(name) for letter in match.groups()}
    found = found or {letter for match in _LETTER_JOINED.finditer(name) for letter in match.groups() if letter}
    return found.pop() if len(found) == 1 else None


def is_output(signal: str, unit_of_measure: str) -> bool:
    """Whether a signal of a unit under test is an inertial output of it, not a reference.

    Angular rates of one device are the axes of one triad, whatever they are called; so are its accelerations. A rate
    that is called after a table, a reference, a command or an input is none.

    Examples
    --------
    >>> is_output("angularratey", "deg/s"), is_output("acc_x", "m/s^2"), is_output("table_speed", "deg/s")
    (True, True, False)
    """
    if is_angular_rate(unit_of_measure):
        return _REFERENCE.search(signal.lower()) is None
    try:
        conversion(unit_of_measure, "m/s^2")
    except UnknownUnit:
        return False
    return True


def turned_about(axis: str | None, signal: str) -> float | None:
    """Component of the axis that turned along the input axis of a signal: 1, -1, 0; None where the word does not say.

    Examples
    --------
    >>> [turned_about(word, "rate_z") for word in ("X", "Z", "-z", "fixture")]
    [0.0, 1.0, -1.0, None]
    >>> [turned_about(word, "rate") for word in ("IRA", "OA", "X")]
    [1.0, 0.0, None]
    """
    match = _AXIS_WORD.fullmatch((axis or "").strip().lower().replace(" ", "_"))
    if match is None:
        return None
    name = match["name"]
    if name in ("x", "y", "z"):
        own = signal_axis(signal)
        if own is None:
            return None
        along = float(name == own)
    else:
        along = float(name in _INPUT)
    return -along if along and "-" in match["before"] + match["after"] else along
