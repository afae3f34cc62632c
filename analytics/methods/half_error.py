"""The smallest input whose output is within 50 % of the true one: threshold, by a slow turn too, and resolution."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from analytics.methods.confidence_bounds import joint_half_widths
from storage.sql.catalog import Catalog
from stream.batch import FloatArray

_HALF = 0.5
# relative uncertainty of the fit at its least input: the criterion is one half
_SHARE = 1 / 6
_FINER = 1.1
_EVALUATED = 200
_QUARTERS = ("north towards crossing", "crossing towards south", "south towards crossing", "crossing towards north")

_MEANS = """
select (t_ns - $start) / 1e9 as t_s, mean from internal.rollup_1s_in($paths)
where run = $run and unit = $unit and signal = $signal and t_ns >= $start and t_ns + 1000000000 <= $end + 1
order by t_ns
"""


class Direction(NamedTuple):
    """Inputs of one direction and the output errors, all in one unit."""

    size: FloatArray  # magnitudes of the inputs, not 0
    error: FloatArray  # magnitudes of the differences between output (over the scale factor) and input
    u: FloatArray  # standard uncertainties of the differences, with their degrees of freedom
    freedom: FloatArray
    # how many of the differences are independent where they lie on a curve; else all are
    independent: int | None = None


def within_half_both_ways(points: Sequence[Mapping[str, Any]], what: str) -> dict[str, Any]:
    """`smallest_within_half` of points with ``is_forward, size, error, u, freedom``; a direction may be missing.

    An unknown uncertainty counts as 0. `what` is measured in a direction, for the reason.
    """
    directions = {}
    for name, is_forward in (("forwards", True), ("backwards", False)):
        own = [each for each in points if each["is_forward"] == is_forward]
        size, error, u, freedom = (
            np.array([each[key] for each in own], np.float64) for key in ("size", "error", "u", "freedom")
        )
        directions[name] = Direction(size, error, np.nan_to_num(u), np.nan_to_num(freedom, nan=1.0))
    if empty := " and ".join(name for name, each in directions.items() if not each.size.size):
        return {"reason": f"no {what} {empty} was measured, the clause asks for both directions"}
    return smallest_within_half(directions)


def smallest_within_half(directions: Mapping[str, Direction]) -> dict[str, Any]:
    """The larger of the smallest inputs of each named direction: ``value, lo, hi, standard_uncertainty`` or ``reason``.

    An input counts if ``error/size <= 50 %`` holds at it and at all larger ones of its direction. The bounds are tested
    inputs too: at the upper one and at all larger ones the condition holds also with the uncertainty of the outputs
    (for all points together, Bonferroni), at the lower one it certainly fails; 0 where it certainly fails at none, and
    no upper bound where it certainly holds at none.

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
    fails = error - half > _HALF * size
    lo = float(size[np.argmax(fails)]) if fails.any() else 0.0
    return _last_of_run(error <= _HALF * size, size), lo, _last_of_run(error + half <= _HALF * size, size)


def _last_of_run(holds: np.ndarray[Any, np.dtype[np.bool_]], size: FloatArray) -> float | None:
    """The last input of those from the largest on at which it holds."""
    failing = np.flatnonzero(~holds)
    n = int(failing[0]) if failing.size else holds.size
    return float(size[n - 1]) if n else None


def of_slow_turn(catalog: Catalog, row: Mapping[str, Any]) -> dict[str, Any]:
    """The threshold of a recorded turn, see `threshold_in_turn`."""
    asked = {name: row[name] for name in ("run", "unit", "signal")} | {"start": row["t_from_ns"], "end": row["t_to_ns"]}
    means = catalog.reader(_MEANS, {"paths": catalog.checked_paths_of([row["run"]], _MEANS), **asked}).read_all()
    t_s, output = (np.asarray(means[name].to_numpy(), np.float64) for name in ("t_s", "mean"))
    if t_s.size < 8 * len(_QUARTERS):
        return {"reason": f"{t_s.size} means of 1 s in the turn, too few to see four crossings"}
    return threshold_in_turn(t_s + 0.5, output * row["deg_per_h"], row["input_rate"], row["level"])


def threshold_in_turn(t_s: FloatArray, output: FloatArray, turn_deg_per_s: float, level: float) -> dict[str, Any]:
    """Threshold from the output during one turn.

    `output` is over the scale factor, in deg/h; the phase of the turn at time 0 need not be known. `level`: rate of the
    Earth on a level axis that points north, deg/h.

    The zero and the phase are those of the sine fitted to the turn. Each quarter of the turn ends or begins at one of
    the four candidates about the two crossings, the largest of which is the threshold. The departure from the sine is
    fitted over the quarter, not judged sample by sample: straight pieces over the input, an octave long, down to the
    input at which the fit is known to a sixth of it; smaller ones are not judged. The uncertainty of a sample is its
    noise from second to second.
    """
    angle = np.radians(turn_deg_per_s) * t_s
    design = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    (zero, in_phase, across), *_ = np.linalg.lstsq(design, output, rcond=None)
    phase = np.mod(angle + np.arctan2(-across, in_phase), 2 * np.pi)
    rate = level * np.cos(phase)
    error = rate - (output - zero)
    u = float(np.std(np.diff(error)) / np.sqrt(2))
    quarter = np.minimum((phase // (np.pi / 2)).astype(int), 3)
    is_input = np.abs(rate) > 0
    parts = {name: np.flatnonzero((quarter == i) & is_input) for i, name in enumerate(_QUARTERS)}
    freedom = float(t_s.size - 3) / 1.5  # of a variance from differences of neighbours
    groups = {name: _fitted(np.abs(rate[at]), error[at], u, freedom) for name, at in parts.items()}
    if empty := [name for name, each in groups.items() if not each.size.size]:
        return {"reason": f"noise of {u:.3g} deg/h in means of 1 s hides the Earth's rate {' and '.join(empty)}"}
    return smallest_within_half(groups)


def _fitted(size: FloatArray, error: FloatArray, u: float, freedom: float) -> Direction:
    """Error over the input in a quarter: linear pieces between knots an octave apart, down to the limit by noise."""
    least, found = float(size.max()), None
    while (narrower := _pieces(size, error, u, least / _FINER)) is not None:
        least, found = least / _FINER, narrower
    if found is None:
        nothing = np.empty(0)
        return Direction(nothing, nothing, nothing, nothing)
    knots, values, covariance = found
    inputs = np.geomspace(knots[0], knots[-1], _EVALUATED)
    hats = _hats(inputs, knots)
    spread = np.sqrt(np.einsum("ij,jk,ik->i", hats, covariance, hats))
    return Direction(inputs, np.abs(hats @ values), spread, np.full(_EVALUATED, freedom), len(knots) * len(_QUARTERS))


def _pieces(size: FloatArray, error: FloatArray, u: float, least: float) -> tuple[FloatArray, ...] | None:
    """Knots from an input up, the errors there, their covariance; None where the lowest is not known well enough."""
    top = float(size.max())
    knots = np.geomspace(least, top, 1 + max(1, round(np.log2(top / least))))
    inside = size >= least
    hats = _hats(size[inside], knots)
    gram = hats.T @ hats
    if inside.sum() <= len(knots) or np.linalg.matrix_rank(gram) < len(knots):
        return None
    covariance = u * u * np.linalg.inv(gram)
    if covariance[0, 0] > (_SHARE * least) ** 2:
        return None
    values = np.asarray(np.linalg.solve(gram, hats.T @ error[inside]), np.float64)
    return knots, values, np.asarray(covariance, np.float64)


def _hats(inputs: FloatArray, knots: FloatArray) -> FloatArray:
    """Shares of the knots in straight pieces between them, shape (inputs, knots)."""
    return np.stack([np.interp(inputs, knots, each) for each in np.eye(len(knots))], axis=1)
