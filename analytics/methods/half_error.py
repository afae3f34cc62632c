"""The smallest input whose output is within 50 % of the true one: the criterion of threshold and resolution."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from analytics.methods.confidence_bounds import joint_half_widths
from stream.batch import FloatArray

_SHARE = 0.5


class Direction(NamedTuple):
    """Inputs of one direction and the output errors, all in one unit.

    Parameters
    ----------
    size: Magnitudes of the inputs, not 0.
    error: Magnitudes of the differences between output (over the scale factor) and input.
    u, freedom: Standard uncertainties of the differences and their degrees of freedom.
    independent: How many of the differences are independent where they lie on a curve; else all are.
    """

    size: FloatArray
    error: FloatArray
    u: FloatArray
    freedom: FloatArray
    independent: int | None = None


def within_half_both_ways(points: Sequence[Mapping[str, Any]], what: str) -> dict[str, Any]:
    """`smallest_within_half` of points with ``is_forward, size, error, u, freedom``; a direction may be missing.

    Parameters
    ----------
    points: An unknown uncertainty counts as 0.
    what: What is measured in a direction, for the reason.
    """
    missing = {"size": np.nan, "error": np.nan, "u": 0.0, "freedom": 1.0}
    directions = {}
    for name, is_forward in (("forwards", True), ("backwards", False)):
        own = [each for each in points if each["is_forward"] == is_forward]
        size, error, u, freedom = (
            np.array([other if each[key] is None else each[key] for each in own], np.float64)
            for key, other in missing.items()
        )
        directions[name] = Direction(size, error, u, freedom)
    if empty := " and ".join(name for name, each in directions.items() if not each.size.size):
        return {"reason": f"no {what} {empty} was measured, the clause asks for both directions"}
    return smallest_within_half(directions)


def smallest_within_half(directions: Mapping[str, Direction]) -> dict[str, Any]:
    """The larger of the smallest inputs of each named direction: ``value, lo, hi, standard_uncertainty`` or ``reason``.

    Notes
    -----
    An input counts if ``error/size <= 50 %`` holds at it and at all larger ones of its direction. The bounds are tested
    inputs too: at the upper one and at all larger ones the condition holds also with the uncertainty of the outputs
    (for all points together, Bonferroni), at the lower one it certainly fails; 0 where it certainly fails at none, and
    no upper bound where it certainly holds at none.

    Examples
    --------
    >>> size = np.array([4.0, 2.0, 1.0, 0.5])
    >>> forwards = Direction(size, np.array([0.4, 0.6, 0.4, 0.5]), np.full(4, 0.01), np.full(4, 1e9))
    >>> smallest_within_half({"forwards": forwards})
    {'value': 1.0, 'lo': 0.5, 'hi': 1.0, 'standard_uncertainty': 0.14433756729740646}
    """
    found = {name: _of_direction(each) for name, each in directions.items()}
    if failed := [name for name, (value, _, _) in found.items() if value is None]:
        return {"reason": f"at no input {' and '.join(failed)} is the output within 50 % of what it should be"}
    value = max(value for value, _, _ in found.values() if value is not None)
    lo = max(lo for _, lo, _ in found.values())
    tops = [hi for _, _, hi in found.values() if hi is not None]
    hi = max(tops) if len(tops) == len(found) else None
    u = None if hi is None else (hi - lo) / 12**0.5
    return {"value": value, "lo": lo, "hi": hi, "standard_uncertainty": u}


def _of_direction(points: Direction) -> tuple[float | None, float, float | None]:
    """Smallest input within 50 %, and its bounds."""
    order = np.argsort(-points.size, kind="stable")
    size, error = points.size[order], points.error[order]
    half = joint_half_widths(points.u[order], points.freedom[order], points.independent)
    fails = error - half > _SHARE * size
    lo = float(size[np.argmax(fails)]) if fails.any() else 0.0
    return _last_of_run(error <= _SHARE * size, size), lo, _last_of_run(error + half <= _SHARE * size, size)


def _last_of_run(holds: np.ndarray[Any, np.dtype[np.bool_]], size: FloatArray) -> float | None:
    """The last input of those from the largest on at which it holds."""
    failing = np.flatnonzero(~holds)
    n = int(failing[0]) if failing.size else holds.size
    return float(size[n - 1]) if n else None
