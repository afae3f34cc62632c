"""Positions of CN 102680005 by the names of its procedure: where X, Y, Z point when each rotation begins."""

import json
import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from stream.batch import FloatArray

# Heading of the table in the laboratory, standard uncertainty where the station states none: what a surveyed north mark
# and a fixture give. Assumed, and listed in the budget.
ASSUMED_U_HEADING_RAD = math.radians(0.1)
_DIRECTIONS = {
    "E": (1.0, 0.0, 0.0), "N": (0.0, 1.0, 0.0), "U": (0.0, 0.0, 1.0),
    "W": (-1.0, 0.0, 0.0), "S": (0.0, -1.0, 0.0), "D": (0.0, 0.0, -1.0),
}  # fmt: skip
# Steps 2 to 10. A rotation begins where the one before has ended: the 4th at E, S, D, where the 3rd leaves the unit;
# taken as E, N, U again it would be turned about the opposite direction, and all of Y had the other sign.
_STARTS: Mapping[str, str] = MappingProxyType({
    "rotation_1": "ENU", "rotation_2": "ESD", "rotation_3": "ENU",
    "rotation_4": "ESD", "rotation_5": "WSU", "rotation_6": "ESD",
    "rotation_7": "NUE", "rotation_8": "SDE", "rotation_9": "NUE",
})  # fmt: skip


def start_of(position: str | None) -> FloatArray | None:
    """Directions of X, Y, Z in east, north, up at the start of a rotation; None for a word that names none.

    >>> start_of("rotation_4").tolist()[1], start_of("somewhere")
    ([0.0, -1.0, 0.0], None)
    """
    axes = _STARTS.get(position or "")
    return None if axes is None else np.array([_DIRECTIONS[each] for each in axes])


def stated_u_heading_rad(standards_text: str | None) -> float | None:
    """Standard uncertainty of the north reference that a run's details state; None where they state none.

    >>> text = '[{"quantities": [{"quantity": "heading", "u": 36.0, "unit": "arcsec"}]}]'
    >>> round(math.degrees(stated_u_heading_rad(text)), 6), stated_u_heading_rad(None)
    (0.01, None)
    """
    entries = json.loads(standards_text or "[]")
    stated = [
        quantity["u"] for entry in entries for quantity in entry["quantities"] if quantity["quantity"] == "heading"
    ]
    return math.radians(max(stated) / 3600.0) if stated else None
