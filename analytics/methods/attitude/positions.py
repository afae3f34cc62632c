"""Positions of an attitude unit, by the words that say where its axes point (JJF 1536-2015 7.2, table 2)."""

import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from stream.errors import BadInput

Direction = tuple[int, int, int]  # east, north, up
Orientation = Mapping[str, Direction]  # of each axis

EAST, NORTH, UP = (1, 0, 0), (0, 1, 0), (0, 0, 1)
_NAMES: Mapping[Direction, tuple[str, ...]] = MappingProxyType({
    EAST: ("east", "e", "东"), (-1, 0, 0): ("west", "w", "西"), NORTH: ("north", "n", "北"),
    (0, -1, 0): ("south", "s", "南"), UP: ("up", "u", "天"), (0, 0, -1): ("down", "d", "地"),
})  # fmt: skip
_DIRECTIONS = {name: direction for direction, names in _NAMES.items() for name in names}
# right-handed: of the rotations by annex B, pitch about x, roll about y, heading about z
TRIADS = (("X", "Y", "Z"), ("PITCH", "ROLL", "HEADING"))
_OTHER_NAMES = {"YAW": "HEADING", "AZIMUTH": "HEADING"}
_WORDS = "east|west|north|south|up|down"
_PAIR = re.compile(
    rf"(?<![a-z])(x|y|z|heading|yaw|azimuth|pitch|roll)[\s_]*(?:axis|轴)?[\s_:=朝]*({_WORDS}|[ewnsud](?![a-z])|[东西南北天地])",
    re.IGNORECASE,
)
_ANGLE = re.compile(r"\s*([+-]?[0-9]+(?:\.[0-9]+)?)\s*(?:deg|°|度)?\s*", re.IGNORECASE)
_MOUNTED_AND_ANGLE = re.compile(r"(.*[^0-9.+-])[\s_,，]([+-]?[0-9]+(?:\.[0-9]+)?)\s*(?:deg|°|度)\s*", re.IGNORECASE)


class Placed(NamedTuple):
    """Where a unit stood in a step: the directions of its axes, and the angle of a table that turns it from there."""

    axes: Orientation
    angle_deg: float | None = None


def triad_of(axis: str) -> tuple[str, str, str]:
    """The axes of the device that an axis belongs to, right-handed.

    >>> triad_of("Y"), triad_of("ROLL")
    (('X', 'Y', 'Z'), ('PITCH', 'ROLL', 'HEADING'))
    """
    return next(triad for triad in TRIADS if axis in triad)


def direction_name(direction: Direction) -> str:
    """The word for a direction."""
    return _NAMES[direction][0]


def position_name(orientation: Orientation, first: str, second: str) -> str:
    """The position as procedures call it, by two of its axes.

    >>> position_name({"X": EAST, "Y": NORTH, "Z": UP}, "X", "Y")
    'X_east_Y_north'
    """
    return "_".join(f"{axis}_{direction_name(orientation[axis])}" for axis in (first, second))


def placed(position: str | None) -> Placed | None:
    """Where a position word says that the unit stands; None where it does not say.

    Two axes give the third, right-handed. An angle after them is that of the table that turns the unit from there.
    Raises BadInput where they cannot be at once.

    >>> placed("X_east_Y_south").axes["Z"], placed("X朝东 Y朝北").axes["Z"], placed("30 deg").angle_deg
    ((0, 0, -1), (0, 0, 1), 30.0)
    >>> turned = placed("X_east_Y_north 30 deg")
    >>> turned.axes["Z"], turned.angle_deg
    ((0, 0, 1), 30.0)
    """
    text = position or ""
    if (match := _ANGLE.fullmatch(text)) is not None:
        return Placed({}, float(match[1]) % 360.0)
    angle_deg = None
    if (match := _MOUNTED_AND_ANGLE.fullmatch(text)) is not None and _PAIR.search(match[1]) is not None:
        text, angle_deg = match[1], float(match[2]) % 360.0
    found: dict[str, Direction] = {}
    for name, word in _PAIR.findall(text):
        axis = _OTHER_NAMES.get(name.upper(), name.upper())
        found[axis] = _DIRECTIONS[word.lower()]
    if not found:
        return None
    triad = triad_of(next(iter(found)))
    if strangers := sorted(set(found) - set(triad)):
        raise BadInput(f"position {text} names {strangers[0]} beside {next(iter(found))}: name one triad of axes")
    if len(found) == 2:
        (missing,) = set(triad) - set(found)
        at = triad.index(missing)
        found[missing] = _cross(found[triad[(at + 1) % 3]], found[triad[(at + 2) % 3]])
    if len(found) == 3 and (_cross(found[triad[0]], found[triad[1]]) != found[triad[2]] or (0, 0, 0) in found.values()):
        raise BadInput(f"position {text} cannot be: its axes are not perpendicular and right-handed")
    return Placed(found, angle_deg)


def _cross(a: Direction, b: Direction) -> Direction:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def missing_angles(angles_deg: Sequence[float], tolerance_deg: float = 0.1) -> str | None:
    """What a set of angles lacks to be equally spaced around the circle; None where it lacks nothing.

    >>> missing_angles([0, 90, 180, 270]), missing_angles([0, 30, 60, 90, 150, 180, 210, 240, 270, 300, 330])
    (None, 'not measured: 120 deg')
    """
    angles = sorted(angles_deg)
    if len(angles) < 3:
        return f"{len(angles)} angles were measured, at least 3 equally spaced ones are needed"
    gaps = [(b - a) % 360.0 for a, b in zip(angles, [*angles[1:], angles[0] + 360.0], strict=True)]
    n = round(360.0 / min(gaps))
    step = 360.0 / n
    grid = [(angles[0] + step * k) % 360.0 for k in range(n)]
    apart = [min(abs((angle - each + 180.0) % 360.0 - 180.0) for each in grid) for angle in angles]
    if max(apart) > tolerance_deg:
        listed = ", ".join(f"{gap:g}" for gap in dict.fromkeys(round(gap, 3) for gap in gaps))
        return f"the angles are not equally spaced: steps of {listed} deg"
    lacking = [
        each for each in grid if min(abs((each - angle + 180.0) % 360.0 - 180.0) for angle in angles) > tolerance_deg
    ]
    if lacking:
        return f"not measured: {', '.join(f'{each:g}' for each in sorted(lacking))} deg"
    return None
