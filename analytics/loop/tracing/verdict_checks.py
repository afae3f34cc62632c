"""What the held-out runs say against a verdict: errors above the noise, slopes that are not one, gains by chance."""

import math
from collections.abc import Sequence

from analytics.loop.tracing.error_result import ErrorAt, ErrorTable
from analytics.loop.tracing.fitted_candidates import LINE
from analytics.loop.tracing.result import Answer, FoundEffect, Holdout, HoldoutSlope

REFERENCE_S = 1800.0
FAR_ABOVE_FLOOR = 1.5
"""Ratio to the floor, which is capped at what the noise allows once in 1000 sets of runs."""
FAR_ABOVE_NOISE = 3.0
"""Ratio to the noise within runs, which is not capped."""
LIKELY_DIFFERENT, SURELY_DIFFERENT = 1.96, 3.29
"""Standard errors by which a slope differs from one: by chance in 1 of 20, and in 1 of 1000 right findings."""
_MOST_NAMED = 3


def reference_row(table: ErrorTable | None) -> ErrorAt | None:
    """The averaging time by which errors are compared: 1800 s, or the longest of which runs have more than one."""
    rows = [row for row in (table.rows if table else ()) if row.averaging_s <= REFERENCE_S]
    rows = [row for row in rows if row.before_within > 0] or rows
    return max(rows, key=lambda row: row.averaging_s, default=None)


def unexplained_error(table: ErrorTable) -> str | None:
    """Say by how much the error of the model found exceeds the noise; None where it is within reach of it."""
    for row in sorted(table.rows, key=lambda row: -row.averaging_s):
        # two numbers and their names: the raw error, and the error about the mean of each run
        pairs = (
            (row.after, row.floor, FAR_ABOVE_FLOOR, "leave"),
            (row.after_within, row.floor_within, FAR_ABOVE_NOISE, "leave about the mean of each run"),
        )
        for error, noise, most, leave in pairs:
            if noise > 0 and error > most * noise:
                where = "the held-out runs" if table.is_held_out else "the runs"
                return (
                    f"{where} {leave} {error:.4g} {table.unit_of_measure} RMS over {row.averaging_s:g} s, where noise "
                    f"allows {noise:.4g}: the model does not hold there"
                )
    return None


def untold_terms(labels: Sequence[str], training: Sequence[str], held_out: Sequence[str]) -> tuple[str, ...]:
    """Say which terms of the declared model the training runs do not excite, and what helps."""
    runs = ", ".join(training) if len(training) <= _MOST_NAMED else f"{len(training)} runs"
    helps = "hold out other runs with --holdout runs=A,B" if held_out else "measure runs that excite it"
    return tuple(
        f"term {label} of the declared model cannot be determined from the fitted runs ({runs}): {helps}, or leave "
        "the term out of the model"
        for label in labels
    )


def holdout_limits(holdout: Holdout | None, effects: Sequence[FoundEffect]) -> list[str]:
    """What the held-out runs leave open of the effects: they do not excite them, or show another size."""
    limits = []
    for effect in effects:
        slopes = () if holdout is None else holdout.effects
        slope = next((each for each in slopes if each.effect == effect.name), None)
        if slope is None:
            continue
        told = f"{slope.slope:.3g} ± {slope.slope_se:.2g}"
        if slope.answer is Answer.NO_POWER:
            limits.append(
                f"{effect.name}: the held-out runs do not excite it and can neither confirm nor refuse it (slope "
                f"{told}); {_better_holdout(effect)}"
            )
        elif effect.name != LINE:
            limits += _wrong_size(effect.name, slope, told)
    return limits


def _wrong_size(name: str, slope: HoldoutSlope, told: str) -> list[str]:
    apart = abs(slope.slope - 1) / math.hypot(slope.slope_se, slope.training_se)
    if apart >= SURELY_DIFFERENT:
        text = ", more than chance: its form is not exact, or it changes from run to run"
    elif apart >= LIKELY_DIFFERENT:
        text = ": its form is likely not exact, or it changes from run to run"
    else:
        return []
    return [f"{name}: the held-out runs show {told} times what was predicted{text}"]


def _better_holdout(effect: FoundEffect) -> str:
    """Which runs to hold out: those that tell most of the effect, if there are others to find it in."""
    exciting = sorted(effect.by_run, key=lambda run: effect.by_run[run][1])
    if len(exciting) < 3:
        return "measure more runs that excite it"
    return f"hold out runs that do, as --holdout runs={','.join(sorted(exciting[: len(exciting) // 3]))}"


def gain_limit(table: ErrorTable | None) -> str | None:
    """Say that the error does not fall by more than chance; None where it does or nothing was found."""
    row = reference_row(table)
    if table is None or row is None or row.gain is None or row.gain_within is None:
        return None
    if row.gain.lo is None or row.gain.is_significant or row.gain_within.is_significant:
        return None
    rises = "rises" if row.gain_within.is_loss else "does not change significantly"
    return (
        f"the RMS error over {row.averaging_s:g} s in {row.gain.runs} runs {rises}: {row.before:.3g} before and "
        f"{row.after:.3g} {table.unit_of_measure} after, about the mean of each run {row.before_within:.3g} and "
        f"{row.after_within:.3g}"
    )
