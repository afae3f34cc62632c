"""Compensation of an attitude unit: from the angles that it gives to those that it turned (JJF 1536-2015 5.1)."""

from collections.abc import Mapping, Sequence

import numpy as np

from stream.batch import FloatArray
from stream.errors import BadInput

_LETTERS = "xyz"


def misalignment_matrix(elements: Mapping[str, float]) -> FloatArray:
    """The matrix L of (1), ones on its diagonal, from the six elements in rad: row of what gives the output.

    >>> misalignment_matrix({"L_xy": 0.002, "L_xz": -0.001, "L_yx": 0.003, "L_yz": -0.002, "L_zx": 0.0015,
    ...                      "L_zy": -0.0025})[1].tolist()
    [0.003, 1.0, -0.002]
    """
    wanted = {
        f"L_{row}{column}": (i, j) for i, row in enumerate(_LETTERS) for j, column in enumerate(_LETTERS) if i != j
    }
    if missing := sorted(wanted.keys() - elements.keys()):
        raise BadInput(f"misalignment matrix: {', '.join(missing)} not given; all six elements are needed, in rad")
    matrix = np.eye(3)
    for name, at in wanted.items():
        matrix[at] = elements[name]
    return matrix


def compensated_angles(
    outputs_deg: Sequence[float] | FloatArray, matrix: FloatArray, bias_deg_per_s: Sequence[float] | FloatArray,
    duration_s: float | FloatArray,
) -> FloatArray:  # fmt: skip
    """Angles A = inv(L)(N - B T) that the axes turned, deg.

    `outputs_deg`: angles N that X, Y, Z give after `duration_s`, shape (3,) or (n, 3) with durations (n,). `matrix`: L,
    `misalignment_matrix`. Erratum: (2) prints a sum of the inverse matrix and the column in place of their product.

    >>> matrix = np.array([[1, 0.002, -0.001], [0.003, 1, -0.002], [0.0015, -0.0025, 1]])
    >>> bias_deg_per_s = np.array([6.0, -3.0, 1.5]) / 3600
    >>> compensated_angles([10.03, -20.08, 30.09], matrix, bias_deg_per_s, 60.0).round(2).tolist()
    [10.0, -20.0, 30.0]
    """
    outputs, bias = np.asarray(outputs_deg, np.float64), np.asarray(bias_deg_per_s, np.float64)
    if matrix.shape != (3, 3) or outputs.shape[-1:] != (3,) or bias.shape != (3,):
        raise BadInput(
            f"compensation: outputs of shape {outputs.shape}, biases of {bias.shape} and a matrix of {matrix.shape}; "
            f"(3,) or (n, 3), (3,) and (3, 3) are needed"
        )
    drift = np.multiply.outer(np.asarray(duration_s, np.float64), bias)
    try:
        return np.asarray(np.linalg.solve(matrix, (outputs - drift)[..., np.newaxis])[..., 0], np.float64)
    except np.linalg.LinAlgError as error:
        raise BadInput("compensation: the matrix of misalignments has no inverse") from error
