"""A root of a function between two points."""

import math
from collections.abc import Callable

_MOST_STEPS = 200


def root_between(
    function: Callable[[float], float], lo: float, hi: float, *, absolute: float = 2e-12, relative: float = 1e-15
) -> float:
    """Root of a continuous function between two points where its signs differ; ValueError if they do not.

    Brent's method: R. P. Brent, Algorithms for Minimization without Derivatives, Prentice-Hall 1973, chapter 4. That of
    `scipy.optimize` finds the same, but takes longer to import than most commands.

    Parameters
    ----------
    absolute, relative: The root is within ``absolute + relative * abs(root)``.

    >>> round(root_between(lambda x: x * x - 2.0, 0.0, 2.0), 12)
    1.414213562373
    """
    before, best, other = lo, hi, lo
    f_before, f_best = function(lo), function(hi)
    f_other = f_before
    if f_before * f_best > 0.0:
        raise ValueError(f"no change of sign between {lo} and {hi}: {f_before} and {f_best}")
    step = last = best - before
    for _ in range(_MOST_STEPS):
        if abs(f_other) < abs(f_best):
            before, best, other = best, other, best
            f_before, f_best, f_other = f_best, f_other, f_best
        tolerance = 0.5 * (absolute + relative * abs(best))
        half = 0.5 * (other - best)
        if abs(half) <= tolerance or f_best == 0.0:
            break
        step, last = _next_step((before, best, other), (f_before, f_best, f_other), step, last, tolerance)
        before, f_before = best, f_best
        best += step if abs(step) > tolerance else math.copysign(tolerance, half)
        f_best = function(best)
        if (f_best > 0.0) == (f_other > 0.0):
            other, f_other = before, f_before
            step = last = best - before
    return best


def _next_step(
    at: tuple[float, float, float], f: tuple[float, float, float], step: float, last: float, tolerance: float
) -> tuple[float, float]:
    """The next step and the one before it: interpolated where that converges, else to the middle."""
    (before, best, other), (f_before, f_best, f_other) = at, f
    half = 0.5 * (other - best)
    if abs(last) < tolerance or abs(f_before) <= abs(f_best):
        return half, half
    s = f_best / f_before
    if before == other:  # linear
        p, q = 2.0 * half * s, 1.0 - s
    else:  # inverse quadratic
        q, r = f_before / f_other, f_best / f_other
        p = s * (2.0 * half * q * (q - r) - (best - before) * (r - 1.0))
        q = (q - 1.0) * (r - 1.0) * (s - 1.0)
    q = -q if p > 0.0 else q
    p = abs(p)
    if 2.0 * p < min(3.0 * half * q - abs(tolerance * q), abs(last * q)):
        return p / q, step
    return half, half
