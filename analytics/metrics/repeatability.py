"""Repeatability over days: the deviations that standards ask for, less the noise of what was measured."""

import math
from typing import Any, NamedTuple

from analytics.metrics.variance_components import MeansNoise, Scatter, Variance, between, beyond

KINDS = ("all", "run_to_run", "day_to_day", "within_day_component", "between_day_component")
_NOT_KNOWN = Variance(math.nan, math.nan)


class Noise(NamedTuple):
    """What the noise of values adds to their scatter: as estimated, and the least that it can be."""

    likely: MeansNoise
    least: MeansNoise


_NO_NOISE = Noise(*[MeansNoise(_NOT_KNOWN, _NOT_KNOWN, _NOT_KNOWN)] * 2)


def deviation_of(found: Scatter, kind: str, what: str, noise: Noise = _NO_NOISE, *, is_dated: bool) -> dict[str, Any]:
    """One of the `KINDS` of deviations with its limits, or the reason why there is none.

    Parameters
    ----------
    found: At least 2 values in groups of days; in groups of runs where the days are not known.
    kind: Which.
    what: What was measured, in the plural, as ``power-ons``.
    noise: What the values' own noise adds; it is taken off.
    is_dated: Whether the days are known.

    Returns
    -------
    dict
        The columns of a `Deviation`, or `reason`.
    """
    days = "days" if is_dated else "runs"
    of_days = kind in {"day_to_day", "between_day_component"} or (kind != "all" and not found.within_freedom)
    if of_days and not is_dated:
        return {"reason": "the date is unknown, so the day is: import with the moment of the start"}
    if kind == "all":
        if found.groups > 1 and found.within_freedom:
            return {
                "reason": f"{found.values} {what} of {found.groups} {days}, several of one, which share its effect: "
                "one deviation of all says neither; see run_to_run, day_to_day and their components"
            }
        return beyond(Variance(found.square, found.values - 1), noise.likely.square, noise.least.square)._asdict()
    if kind != "day_to_day" and not found.within_freedom:
        return {"reason": f"each of the {found.values} {what} is of another day, 2 of one day are needed"}
    if kind in {"run_to_run", "within_day_component"}:
        return beyond(Variance(found.within, found.within_freedom), noise.likely.within, noise.least.within)._asdict()
    if found.groups < 2:
        return {"reason": f"all {found.values} {what} are of one day, 2 days are needed"}
    if kind == "day_to_day":
        return beyond(Variance(found.of_means, found.groups - 1), noise.likely.of_means, noise.least.of_means)._asdict()
    # the scatter within the days has the noise of the values in it
    return between(found)._asdict()


def scatters(found: Scatter, noise: Noise, kind: str) -> dict[str, float | None]:
    """What a deviation is made of: the scatter by the equation of the clauses, and the noise of the values in it."""
    observed, known = {
        "all": (found.square, noise.likely.square),
        "run_to_run": (found.within, noise.likely.within),
        "within_day_component": (found.within, noise.likely.within),
    }.get(kind, (found.of_means, noise.likely.of_means))
    return {"scatter": _root(observed), "uncertainty_of_means": _root(known.value)}


def _root(variance: float) -> float | None:
    return math.sqrt(variance) if variance >= 0 else None
