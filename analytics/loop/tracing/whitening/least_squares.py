"""Least squares in the whitened space, where all blocks have equal weight."""

from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray, IntArray

LEAST_EIGENVALUE = 1e-9  # of the scaled normal matrix; combinations of columns below it are ignored
LEAST_SINGULAR = 1e-6


class Solution(NamedTuple):
    """Coefficients and their covariance."""

    coefficients: FloatArray
    covariance: FloatArray


def _scaled(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A normal matrix with unit diagonal, and the lengths of its columns."""
    scale = np.sqrt(np.diag(normal))
    scale = np.where(scale > 0, scale, 1.0)
    return normal / np.outer(scale, scale), scale


def solve(normal: FloatArray, right: FloatArray) -> Solution:
    """Solve normal equations; combinations of columns that the data do not determine get a coefficient of zero.

    >>> solve(np.array([[4.0]]), np.array([2.0]))
    Solution(coefficients=array([0.5]), covariance=array([[0.25]]))
    """
    if not right.shape[0]:
        return Solution(np.zeros(right.shape), np.zeros(normal.shape))
    scaled, scale = _scaled(normal)
    eigenvalues, vectors = np.linalg.eigh(scaled)
    kept = eigenvalues > LEAST_EIGENVALUE
    covariance = (vectors[:, kept] / eigenvalues[kept]) @ vectors[:, kept].T / np.outer(scale, scale)
    return Solution(covariance @ right, covariance)


def log_determinant(normal: FloatArray) -> float:
    """Logarithm of the determinant over the combinations of columns that the data determine."""
    if not normal.shape[0]:
        return 0.0
    scaled, scale = _scaled(normal)
    eigenvalues = np.linalg.eigvalsh(scaled)
    return float(np.sum(np.log(eigenvalues[eigenvalues > LEAST_EIGENVALUE])) + 2 * np.sum(np.log(scale)))


def fit(columns: FloatArray, value: FloatArray) -> Solution:
    """Least squares of whitened columns on whitened values."""
    return solve(columns.T @ columns, columns.T @ value)


def fit_of_clusters(columns: FloatArray, value: FloatArray, cluster: IntArray) -> Solution | None:
    """Ordinary least squares with a cluster-robust covariance; None with fewer than two clusters.

    The covariance is the sum over clusters of the outer products of their scores, times G / (G - 1) for G clusters
    (Liang and Zeger, doi:10.1093/biomet/73.1.13). It holds for any noise within a cluster.

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
    """Normal equations of k columns after projection onto the complement of other columns."""

    normal: FloatArray  # shape (k, k)
    right: FloatArray  # shape (k,)
    before: FloatArray  # shape (k,); squared norms of the columns before the projection


def project(gram: FloatArray, others: int) -> Projected:
    """Project the last columns of a Gram matrix of value, others and these onto the complement of the `others`."""
    out, rest = slice(1, 1 + others), slice(1 + others, None)
    inverse = solve(gram[out, out], gram[out, 0]).covariance
    onto = gram[rest, out] @ inverse
    normal = gram[rest, rest] - onto @ gram[out, rest]
    right = gram[rest, 0] - onto @ gram[out, 0]
    return Projected(normal, right, np.diag(gram)[rest].copy())


def orthonormal(columns: FloatArray) -> FloatArray:
    """Orthonormal basis of the span of columns, without directions within rounding error."""
    lengths = np.linalg.norm(columns, axis=0)
    there = lengths > 0
    if not there.any():
        return columns[:, there]
    left, singular, _ = np.linalg.svd(columns[:, there] / lengths[there], full_matrices=False)
    return np.asarray(left[:, singular > LEAST_SINGULAR * singular[0]])
