"""Rates whose unit of measure is not that of their numbers: they follow the signal, but at a thousandth of its size."""

from collections.abc import Sequence

import numpy as np

from analytics.loop.blocks.checks import Note, in_runs
from analytics.loop.blocks.run_blocks import RunBlocks
from stream.batch import BoolArray, FloatArray
from stream.quantities import conversion, is_angular_rate

_RATES = ("input_rate", "table_rate")
_MISTAKES = {
    3600.0: "as of deg/s under a label of deg/h, or the other way round",
    60.0: "as of deg/s or deg/h beside deg/min",
    180.0 / np.pi: "as of radians under a label of degrees, or the other way round",
    3600.0 * 180.0 / np.pi: "as of rad/s under a label of deg/h, or the other way round",
    1000.0: "as of thousandths (mdps) under a label of the whole, or the other way round",
}
_NEAR = 0.02
_FOLLOWS = 0.95
_FEWEST = 10


def check_labels(runs: Sequence[RunBlocks]) -> list[Note]:
    """Notes on reference rates that the signal follows with a ratio that is one of two units of measure."""
    notes = []
    for name in _RATES:
        ratios = {run.run: ratio for run in runs if (ratio := _ratio(run, name)) is not None}
        wrong: dict[float, list[str]] = {}
        for run, ratio in ratios.items():
            for factor in _MISTAKES:
                size = max(abs(ratio), 1.0 / abs(ratio)) / factor
                if abs(size - 1.0) < _NEAR:
                    wrong.setdefault(factor, []).append(run)
                    break
        for factor, names in wrong.items():
            signal = runs[0].signal
            ratio = abs(ratios[names[0]])
            told = f"{ratio:,.4g} times" if ratio > 1 else f"1/{1 / ratio:,.4g} of"
            text = (
                f"{signal} is {told} {name} {in_runs(names, len(runs))}, both in the units they are labelled with, "
                f"{_MISTAKES[factor]}: mend the label and import anew, else every coefficient of {name} is off by that"
            )
            notes.append(Note("unit_label", text, name, tuple(names), is_limit=True))
    return notes


def _ratio(run: RunBlocks, name: str) -> float | None:
    """What a line makes of the signal over a rate, both in one unit; None where the signal does not follow it."""
    channel = run.channels.get(name)
    if channel is None or not is_angular_rate(run.unit_of_measure) or not is_angular_rate(channel.unit_of_measure):
        return None
    rate = channel.mean * conversion(channel.unit_of_measure, run.unit_of_measure)[0]
    known: BoolArray = np.isfinite(rate) & np.isfinite(run.value)
    if np.count_nonzero(known) < _FEWEST:
        return None
    x: FloatArray = rate[known] - rate[known].mean()
    y: FloatArray = run.value[known] - run.value[known].mean()
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if not (np.isfinite(xx) and np.isfinite(yy)) or xx <= 0.0 or yy <= 0.0 or xy**2 < _FOLLOWS * xx * yy:
        return None
    return xy / xx
