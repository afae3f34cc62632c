"""Attitude as heading, pitch, roll and as the matrix from the body to east, north, up (JJF 1536-2015 annex B)."""

import warnings
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from stream.batch import FloatArray
from stream.errors import BadInput

_SEQUENCE = "ZXY"  # turns about the body's own axes: heading about z, pitch about x, roll about y


class AttitudeAngles(NamedTuple):
    """Heading, pitch and roll, deg: -180 to 180, -90 to 90, -180 to 180."""

    heading_deg: float
    pitch_deg: float
    roll_deg: float


def attitude_matrix(heading_deg: float, pitch_deg: float, roll_deg: float) -> FloatArray:
    """The matrix C from body (x right, y ahead, z up) to east, north, up, (B.1).

    Heading is positive towards west: by the right-hand rule about the axis that points up. Clauses 5.3 to 5.5 put
    heading, pitch, roll on X, Y, Z, annex B on z, x, y: axes are named by their rotation here.

    >>> attitude_matrix(90.0, 0.0, 0.0).round(6).tolist()
    [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    return np.asarray(Rotation.from_euler(_SEQUENCE, [heading_deg, pitch_deg, roll_deg], degrees=True).as_matrix())


def attitude_angles(matrix: FloatArray) -> AttitudeAngles:
    """Heading = atan2(-T12, T22), pitch = asin(T32), roll = atan2(-T31, T33).

    Erratum: (B.4) prints both arctangents without the minus and without their quadrant; (130, -25, 160) deg would come
    back as (50, -25, 20). At a pitch of +-90 deg heading and roll turn about one line: the roll is then 0. Raises
    BadInput where the matrix is no rotation.

    >>> angles = attitude_angles(attitude_matrix(130.0, -25.0, 160.0))
    >>> [round(each, 9) for each in angles]
    [130.0, -25.0, 160.0]
    """
    given = np.asarray(matrix, np.float64)
    if given.shape != (3, 3) or not np.allclose(given @ given.T, np.eye(3), atol=1e-6) or np.linalg.det(given) < 0:
        raise BadInput("attitude: the matrix is no rotation: its rows must be perpendicular, of length 1, right-handed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of the pitch of 90 deg, which the docstring tells of
        angles = Rotation.from_matrix(given).as_euler(_SEQUENCE, degrees=True)
    return AttitudeAngles(*(float(each) for each in angles))
