"""Rates about the cross axes that reach the output."""

import math
from typing import Annotated

import msgspec
import numpy as np

from stream.batch import FloatArray

_ARCSEC = math.pi / (180 * 3600)
_PPM = 1e-6
_EIGHTH_TURN_ARCSEC = 45 * 3600

_Lean = Annotated[float, msgspec.Meta(ge=-_EIGHTH_TURN_ARCSEC, le=_EIGHTH_TURN_ARCSEC)]


class Misalignment(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Direction of the true input axis in the housing, and cross-axis sensitivity.

    Parameters
    ----------
    y_arcsec, z_arcsec: Angles by which the input axis leans towards y and z, at most 45 deg each.
    cross_y_ppm, cross_z_ppm: Cross-axis sensitivity: what reaches the output of a rate about y and z without the axis
        being turned.

    Notes
    -----
    The normal of the coil stands a little off the housing's reference face, so that it sees rates across the nominal
    input axis; electronics and housing may couple further. Omega = Omega_x sqrt(1 - s_y^2 - s_z^2) +
    Omega_y (s_y + c_y) + Omega_z (s_z + c_z), with s the sines of the two angles.
    """

    y_arcsec: _Lean = 0.0
    z_arcsec: _Lean = 0.0
    cross_y_ppm: float = 0.0
    cross_z_ppm: float = 0.0


def sensed_rate(misalignment: Misalignment | None, rates_deg_per_s: FloatArray) -> FloatArray:
    """Rate about the true input axis, deg/s, of rates about x, y, z.

    Examples
    --------
    >>> float(sensed_rate(Misalignment(cross_z_ppm=-20.0), np.array([[0.0], [5.0], [100.0]]))[0])
    -0.002
    """
    x, across_y, across_z = rates_deg_per_s
    if misalignment is None:
        return np.asarray(x, np.float64)
    y, z = math.sin(misalignment.y_arcsec * _ARCSEC), math.sin(misalignment.z_arcsec * _ARCSEC)
    along = math.sqrt(1.0 - y * y - z * z)
    cross_y, cross_z = y + _PPM * misalignment.cross_y_ppm, z + _PPM * misalignment.cross_z_ppm
    return np.asarray(along * x + cross_y * across_y + cross_z * across_z, np.float64)
