"""Least squares in the whitened space, where every block weighs the same."""

from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray, IntArray

LEAST_EIGENVALUE = 1e-9  # of the scaled normal matrix; below it a combination of columns counts as nothing
LEAST_SINGULAR = 1e-6


class Solution(NamedTuple):
    """Coefficients and their covariance."""

    coefficients: FloatArray
    covariance: FloatArray


def solve(normal: FloatArray, right: FloatArray) -> Solution:
    """Solve normal equations; combinations of columns that the data say nothing of get a coefficient of zero.

    Examples
    --------
    >>> solve(np.array([[4.0]]), np.array([2.0]))
    Solution(coefficients=array([0.5]), covariance=array([[0.25]]))
    """
    if not right.shape[0]:
        return Solution(np.zeros(right.shape), np.zeros(normal.shape))
    scale = np.sqrt(np.diag(normal))
    scale = np.where(scale > 0, scale, 1.0)
    eigenvalues, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    kept = eigenvalues > LEAST_EIGENVALUE
    covariance = (vectors[:, kept] / eigenvalues[kept]) @ vectors[:, kept].T / np.outer(scale, scale)
    return Solution(covariance @ right, covariance)


def log_determinant(normal: FloatArray) -> float:
    """Logarithm of the determinant, of the combinations of columns that the data say something of."""
    if not normal.shape[0]:
        return 0.0
    scale = np.sqrt(np.diag(normal))
    scale = np.where(scale > 0, scale, 1.0)
    eigenvalues = np.linalg.eigvalsh(normal / np.outer(scale, scale))
    return float(np.sum(np.log(eigenvalues[eigenvalues > LEAST_EIGENVALUE])) + 2 * np.sum(np.log(scale)))


def fit(columns: FloatArray, value: FloatArray) -> Solution:
    """Least squares of whitened columns on whitened values."""
    return solve(columns.T @ columns, columns.T @ value)


def fit_of_clusters(columns: FloatArray, value: FloatArray, cluster: IntArray) -> Solution | None:
    """Plain least squares, and the covariance that clusters of values tell by how they differ.

    It holds whatever the noise within a cluster is, and whatever the columns lack: the sum over clusters of the outer
    products of their scores, times G / (G - 1) for G clusters (Liang and Zeger, doi:10.1093/biomet/73.1.13).

    Returns
    -------
    Solution or None
        None where there is one cluster only: it tells nothing of how clusters differ.

    Examples
    --------
    >>> fit_of_clusters(np.ones((4, 1)), np.array([1.0, 1.0, 3.0, 3.0]), np.array([0, 0, 1, 1]))
    Solution(coefficients=array([2.]), covariance=array([[1.]]))
    """
    numbers, at = np.unique(cluster, return_inverse=True)
    if numbers.size < 2:
        return None
    coefficients, inverse = fit(columns, value)
    scores = np.zeros((numbers.size, columns.shape[1]))
    np.add.at(scores, at, columns * (value - columns @ coefficients)[:, None])
    spread = numbers.size / (numbers.size - 1)
    return Solution(coefficients, spread * inverse @ (scores.T @ scores) @ inverse)


class Projected(NamedTuple):
    """Normal equations of some columns, with others taken out of them.

    Parameters
    ----------
    normal: shape (k, k); of the columns.
    right: shape (k,); their products with the values.
    before: shape (k,); squared norms of the columns before the others were taken out.
    """

    normal: FloatArray
    right: FloatArray
    before: FloatArray


def project(gram: FloatArray, taken_out: int) -> Projected:
    """Take the first columns out of the others.

    Parameters
    ----------
    gram: shape (1 + p + k, 1 + p + k); products of the whitened value, the p columns that are taken out, and k others.
    taken_out: p.
    """
    out, rest = slice(1, 1 + taken_out), slice(1 + taken_out, None)
    inverse = solve(gram[out, out], gram[out, 0]).covariance
    onto = gram[rest, out] @ inverse
    normal = gram[rest, rest] - onto @ gram[out, rest]
    right = gram[rest, 0] - onto @ gram[out, 0]
    return Projected(normal, right, np.diag(gram)[rest].copy())


def orthonormal(columns: FloatArray) -> FloatArray:
    """Orthonormal basis of what columns span; directions that rounding alone could make are left out."""
    lengths = np.linalg.norm(columns, axis=0)
    there = lengths > 0
    if not there.any():
        return columns[:, there]
    left, singular, _ = np.linalg.svd(columns[:, there] / lengths[there], full_matrices=False)
    return np.asarray(left[:, singular > LEAST_SINGULAR * singular[0]])
