"""Tests of an attitude unit (JJF 1536-2015) for the simulated units: words, signal, rate about its axis, zero."""

from collections.abc import Iterator
from typing import Any, NamedTuple

RATES = (10.0, 25.0, 63.0, 100.0)
BIASES = {"X": 6.0, "Y": -3.0, "Z": 1.5}  # deg/h, beyond that of the unit
LEVEL_DEG_PER_H = 0.1  # of the Earth's rate, by an error of the heading
ELEMENTS = {"XY": 0.002, "XZ": -0.001, "YX": 0.003, "YZ": -0.002, "ZX": 0.0015, "ZY": -0.0025}
_SECOND = {"X": "Y", "Y": "Z", "Z": "X"}


class AxisStep(NamedTuple):
    """A step as one axis sees it; deg/s and deg/h."""

    words: dict[str, Any]
    axis: str
    rate: float = 0.0
    zero: float = 0.0

    @property
    def signal(self) -> str:
        """The output of its axis."""
        return f"rate_{self.axis.lower()}"


def attitude_tests() -> dict[str, list[AxisStep]]:
    """Steps by procedure."""
    return {
        "attitude_unit_scale_factor": list(_rates()),
        "attitude_unit_bias": list(_positions()),
        "attitude_unit_misalignment": list(_turns()),
    }


def _rates() -> Iterator[AxisStep]:
    for axis, zero in BIASES.items():
        for rate in (0.0, *(way * each for each in RATES for way in (1, -1)), 0.0):
            words = {"axis": axis, "position": f"{axis}_up", "rate_command": rate}
            yield AxisStep(words, axis, rate, zero)


def _positions() -> Iterator[AxisStep]:
    for axis, zero in BIASES.items():
        for towards, over, way in (
            ("east", "north", 1),
            ("east", "south", 1),
            ("west", "south", -1),
            ("west", "north", -1),
        ):
            words = {"axis": axis, "position": f"{axis}_{towards}_{_SECOND[axis]}_{over}"}
            yield AxisStep(words, axis, zero=zero + way * LEVEL_DEG_PER_H)


def _turns() -> Iterator[AxisStep]:
    for turned in BIASES:
        for rate in (60.0, -60.0):
            for axis, zero in BIASES.items():
                words = {"axis": turned, "position": f"{turned}_up", "rate_command": rate}
                own = rate if axis == turned else 0.0
                across = 0.0 if axis == turned else ELEMENTS[axis + turned] * rate * 3600
                yield AxisStep(words, axis, own, zero + across)
