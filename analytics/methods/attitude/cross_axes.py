"""What an axis of an attitude unit sees of the Earth's rate about the other two, by L (JJF 1536-2015 5.1)."""

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from analytics.methods.attitude.positions import UP, Direction, Orientation, placed
from stream.errors import BadInput

EARTH_DEG_PER_H = 15.041067
_DOWN: Direction = (0, 0, -1)
_STAYS = "what the axis sees of the Earth's vertical rate, L sin(latitude) 15.04 deg/h, is in it"


class Element(NamedTuple):
    """An off-diagonal element of the matrix L, rad."""

    value: float
    u: float
    freedom: float


Elements = Mapping[tuple[str, str], Element]  # by unit and name


def element_name(own: str, turned: str) -> str:
    """The element by what gives the output, and what is turned, as in 5.6.

    >>> element_name("Y", "X"), element_name("PITCH", "ROLL")
    ('L_yx', 'L_pitch_roll')
    """
    apart = "" if len(own) == 1 else "_"
    return f"L_{own.lower()}{apart}{turned.lower()}"


def seen_across(own: str, axes: Orientation, unit: str, latitude_deg: float | None, elements: Elements) -> float | None:
    """What an axis sees of the Earth's rate about the other two, sum L_ij A_j of (4) to (6), deg/h; None if unknown.

    >>> known = {("U1", "L_yx"): Element(3e-3, 1e-5, 9.0), ("U1", "L_yz"): Element(0.0, 1e-5, 9.0)}
    >>> axes = {"X": UP, "Y": (1, 0, 0), "Z": (0, 1, 0)}
    >>> round(seen_across("Y", axes, "U1", 30.0, known), 5)
    0.02256
    """
    if latitude_deg is None:
        return None
    latitude = math.radians(latitude_deg)
    total = 0.0
    for axis, (_, north, up) in axes.items():
        if axis == own or not (north or up):
            continue
        element = elements.get((unit, element_name(own, axis)))
        if element is None:
            return None
        total += element.value * EARTH_DEG_PER_H * (north * math.cos(latitude) + up * math.sin(latitude))
    return total


def vertical_part(
    own: str, positions: Iterable[str], unit: str, latitude_deg: float | None, elements: Elements
) -> Element | str:
    """What an axis that a table turns in the level plane sees of the Earth's vertical rate, deg/h.

    It is the same at every angle: L Omega_e sin(latitude). Where it cannot be known, what is missing for it.
    """
    sides = {_vertical(position, own) for position in positions}
    (side,) = sides if len(sides) == 1 else (None,)
    if side is None:
        return f"{_STAYS}: name the mount, as X_east_Y_north 30 deg"
    if latitude_deg is None:
        return f"{_STAYS}: state the latitude of the station"
    axis, sign = side
    element = elements.get((unit, element_name(own, axis)))
    if element is None:
        return f"{_STAYS}: measure {element_name(own, axis)} (7.3)"
    rate = sign * EARTH_DEG_PER_H * math.sin(math.radians(latitude_deg))
    return Element(element.value * rate, element.u * abs(rate), element.freedom)


def _vertical(position: str, own: str) -> tuple[str, int] | None:
    """The axis that is vertical, and whether it points up (1) or down (-1)."""
    try:
        where = placed(position)
    except BadInput:
        return None
    for axis, direction in ({} if where is None else where.axes).items():
        if axis != own and direction in {UP, _DOWN}:
            return axis, direction[2]
    return None
