"""The Allan variance directly from its definition, for comparison."""

import numpy as np

from stream.batch import FloatArray
from stream.errors import EstimatorError


def overlapping_allan_variance(values: FloatArray, averaging_factor: int) -> float:
    """Allan variance with full overlap, directly from its definition; for comparison.

    Parameters
    ----------
    values: shape (n,); samples on a grid without gaps.
    averaging_factor: tau over the sample interval, k below; at least 2 k samples are needed.

    Notes
    -----
    With the integrated values x_i (x_0 = 0, in units of the sample interval),

        AVAR = sum_(i=0)^(n-2k) (x_(i+2k) - 2 x_(i+k) + x_i)**2 / (2 k**2 (n - 2k + 1)),

    NIST SP 1065 equation (11), IEEE 952-2020 annex C; JJF 2014-2022 7.2.20 (34)-(39), GJB 2426A-2004 5.12.5.4.2.
    Erratum: both Chinese standards print clusters of k + 1 terms over k and differences of clusters one sample apart,
    JJF (37) also a further n in the denominator; that falls as 1/tau**2 whatever the noise.

    Examples
    --------
    >>> overlapping_allan_variance(np.array([1.0, 3.0, 2.0, 6.0, 4.0]), 2)
    2.5625
    """
    k, n = averaging_factor, len(values)
    if k < 1 or n < 2 * k:
        raise EstimatorError(f"{n} samples are too few for two averages of {k}")
    integral = np.concatenate([[0.0], np.cumsum(values - values[0])])
    second_difference = integral[2 * k :] - 2.0 * integral[k : n + 1 - k] + integral[: n + 1 - 2 * k]
    return float(np.sum(np.square(second_difference)) / (2.0 * k**2 * (n - 2 * k + 1)))
