"""The calibration of an attitude unit: K, B and L of its axes as the store has measured them (JJF 1536-2015, 7)."""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from analytics.evaluation.selection import Row, Selection, selected
from analytics.methods.attitude.compensation import misalignment_matrix
from analytics.methods.attitude.cross_axes import element_name
from analytics.methods.attitude.positions import TRIADS
from storage.sql.catalog import Catalog
from stream.batch import FloatArray
from stream.errors import BadInput

_ARCMIN_PER_RAD = 10800 / np.pi
_BEGAN = "select run, t_start_ns from unit_runs where unit = $unit"


class Coefficient(msgspec.Struct, frozen=True, kw_only=True):
    """A measured value with its standard uncertainty and the run that gave it."""

    value: float
    standard_uncertainty: float
    run: str


class AttitudeCalibration(msgspec.Struct, frozen=True, kw_only=True):
    """Scale factors, biases (deg/h) and misalignments (rad, by element) of a unit, by axis."""

    unit: str
    axes: tuple[str, str, str]  # right-handed: pitch about the first, roll about the second, heading about the third
    scale_factor: dict[str, Coefficient]
    bias_deg_per_h: dict[str, Coefficient]
    misalignment_rad: dict[str, Coefficient]

    @property
    def matrix(self) -> FloatArray:
        """L of (1)."""
        values = {
            f"L_{'xyz'[i]}{'xyz'[j]}": self.misalignment_rad[element_name(own, turned)].value
            for i, own in enumerate(self.axes)
            for j, turned in enumerate(self.axes)
            if i != j
        }
        return misalignment_matrix(values)

    @property
    def bias_deg_per_s(self) -> FloatArray:
        """B of the three axes."""
        return np.array([self.bias_deg_per_h[axis].value for axis in self.axes]) / 3600.0

    def uncertainty_deg(self, turned_deg: FloatArray, duration_s: float) -> FloatArray:
        """Standard uncertainty of the compensated angles that K, B and L leave, shape (3,), deg (JCGM 100, 5.1.2)."""
        of_bias = np.array([self.bias_deg_per_h[axis].standard_uncertainty for axis in self.axes]) / 3600 * duration_s
        scales = [self.scale_factor[axis] for axis in self.axes]
        of_scale = np.array([each.standard_uncertainty / each.value for each in scales]) * turned_deg
        of_elements = np.zeros((3, 3))
        for i, own in enumerate(self.axes):
            for j, turned in enumerate(self.axes):
                if i != j:
                    element = self.misalignment_rad[element_name(own, turned)]
                    of_elements[i, j] = element.standard_uncertainty * turned_deg[j]
        return np.asarray(np.sqrt(of_bias**2 + of_scale**2 + (of_elements**2).sum(axis=1)), np.float64)


def attitude_calibration(catalog: Catalog, unit: str, runs: Sequence[str] = ()) -> AttitudeCalibration:
    """The last value of each coefficient of a unit, of these runs alone if any are named.

    A bias by four positions goes before one by equal angles. Raises BadInput with all that has not been measured.
    """
    rows = selected(catalog, Selection(units=(unit,), runs=tuple(runs), standards=("JJF1536",)))
    began = dict(catalog.rows(_BEGAN, {"unit": unit}))
    valued = [row for row in rows if row["value"] is not None]
    valued.sort(key=lambda row: (row["parameters"].get("method") != "equal angles", began.get(row["run"], 0)))
    found: dict[str, dict[str, Coefficient]] = {"K": {}, "B": {}, "L": {}}
    for row in valued:
        kind, name, per = _named(row)
        if kind:
            found[kind][name] = Coefficient(
                value=row["value"] / per, standard_uncertainty=_standard_uncertainty(row) / per, run=row["run"]
            )
    axes = next((triad for triad in TRIADS if set(triad) & {*found["K"], *found["B"]}), TRIADS[0])
    elements = [element_name(own, turned) for own in axes for turned in axes if own != turned]
    lacking = [
        *(f"the scale factor of {axis}" for axis in axes if axis not in found["K"]),
        *(f"the bias of {axis}" for axis in axes if axis not in found["B"]),
        *(name for name in elements if name not in found["L"]),
    ]
    if lacking:
        among = f" in {', '.join(runs)}" if runs else ""
        raise BadInput(
            f"unit {unit} is not calibrated by JJF 1536{among}: {', '.join(lacking)} not measured; see "
            f"`gyrofleet metrics --unit {unit} --standard 'JJF 1536'` for the reasons"
        )
    return AttitudeCalibration(
        unit=unit, axes=axes, scale_factor={axis: found["K"][axis] for axis in axes},
        bias_deg_per_h={axis: found["B"][axis] for axis in axes},
        misalignment_rad={name: found["L"][name] for name in elements},
    )  # fmt: skip


def _named(row: Row) -> tuple[str, str, float]:
    """Which coefficient a value is of, its name, and the divisor to its unit here."""
    words: Mapping[str, Any] = row["parameters"]
    match row["metric"]:
        case "scale_factor":
            return "K", str(words.get("axis") or (row["signal"] or "").rpartition("_")[2]).upper(), 1.0
        case "attitude_unit_bias":
            return "B", str(words["axis"]), 1.0
        case "attitude_unit_misalignment":
            return "L", str(words["element"]), _ARCMIN_PER_RAD
    return "", "", 1.0


def _standard_uncertainty(row: Row) -> float:
    """Of U where it is known, else of the scatter alone."""
    if row["U"] is not None:
        return float(row["U"] / row["k"])
    return float(row["u_type_a"] or row["standard_uncertainty"] or 0.0)
