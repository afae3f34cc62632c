"""Initial noise where none is declared: from a unit's own Allan fits, and the scatter of its bias over runs."""

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from analytics.curves.noise_coefficients import MOST_MISFIT
from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.blocks.signal_blocks import MEDIAN_OF_SQUARE
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.methods.distributions import chi_square_isf
from storage.sql.catalog import Catalog
from stream.batch import FloatArray
from stream.decoding import decode_json
from stream.estimators.base import NoEstimate
from stream.quantities import ANGULAR_RATE_UNIT

_KEYS = ("angle_random_walk", "bias_instability", "rate_random_walk")
_QUANTILE = 0.25
_OF_LIMIT = 1.0 / 3.0
_NORMAL_PER_MAD = 1.4826
_LEAST_DOUBLINGS, _MOST_DOUBLINGS = 2, 12  # of the blocks in an average
_LEAST_DEGREES = 4.0  # of a variance from which the random walk is bounded
_RATES = ("input_rate", "table_rate")
_MOST_DRIVEN = (
    4.0  # above this ratio of variances, whole and left of a line in the rate, a run's Allan fit is of motion
)


def declared_noise(catalog: Catalog, runs: Sequence[RunBlocks], model: ErrorModel) -> ModelNoise | NoEstimate:
    """Noise coefficients of a unit from the Allan fits of its runs in the store, or why there are none.

    An Allan deviation contains the effects as well as the noise: of several runs the lower quartile is taken; of a term
    that a run does not show, a third of its upper bound. White noise that no run shows, as in means of a minute, where
    it shares the least values of the curve with flicker, is at least what differences of neighbouring blocks show.
    Fits with a misfit above a quarter do not count, nor do runs in which the unit was rotated: their Allan deviation is
    that of the motion, a million times the noise. The turn-on scatter is that of the runs' constants beside the
    declared model by least squares (1.4826 times the median distance from the median); of a single run it is unknown,
    and the bias instability is taken instead. Flicker and random walk appear at long averaging times only, where a
    short run shows its effects: they are taken from the runs at least half as long as the longest of those whose fits
    count. A power-on within a run has the fit of the whole run. The random walk is at most what averages of the blocks
    beside the declared model bound: the Allan curve of a temperature cycle has that of the declared temperature term.
    What the fits allow (`ModelNoise.most`) are the lower quartiles of their upper bounds.
    """
    unit, signal = runs[0].unit, runs[0].signal
    if runs[0].unit_of_measure != ANGULAR_RATE_UNIT:
        unit_of_measure = runs[0].unit_of_measure
        return _unknown(
            f"signal {signal} is in {unit_of_measure}: the noise terms are those of an angular rate",
            f"信号{signal}的单位为{unit_of_measure}：噪声各项是针对角速率的",
        )
    names = {name for run in runs for name in (run.run, run.whole_run)}
    turned = {name for run in runs if _is_turned(run) for name in (run.run, run.whole_run)}
    if names == turned:
        return _unknown(
            f"unit {unit}, signal {signal}: it was turned in all runs, whose Allan fits are of the motion; noise is "
            "estimated from these runs alone, or give --noise",
            f"产品{unit}，信号{signal}：各次试验均在转动，其Allan拟合反映的是运动；噪声仅由这些试验估计，或用--noise给出",
        )
    rows = catalog.rows(
        "select run, document->'$.coefficients' as coefficients from events "
        "where kind = 'NoiseFitted' and unit = $unit and signal = $signal order by t_ns",
        {"unit": unit, "signal": signal},
    )
    fits = {str(run): decode_json(text) for run, text in rows if text and run in names - turned}
    usable = {run: fit for run, fit in fits.items() if fit is not None and fit.get("misfit", 0.0) <= MOST_MISFIT}
    if not usable:
        count = len(names - turned)
        return _unknown(
            f"unit {unit}, signal {signal}: none of {count} runs has an Allan fit that describes it; noise is "
            "estimated from these runs alone, or give --noise",
            f"产品{unit}，信号{signal}：{count}次试验均无可用的Allan拟合；噪声仅由这些试验估计，或用--noise给出",
        )
    lengths_s = _lengths_s(runs)
    longest_s = max(lengths_s[run] for run in usable)
    long = [fit for run, fit in usable.items() if lengths_s[run] >= longest_s / 2]
    fits_of = (list(usable.values()), long, long)
    white, flicker, walk = (
        float(np.quantile([_value(fit[key]) for fit in those], _QUANTILE))
        for key, those in zip(_KEYS, fits_of, strict=True)
    )
    if not any(fit[_KEYS[0]]["observable"] for fit in usable.values()):
        shown = _white_of_blocks([run for run in runs if {run.run, run.whole_run} & usable.keys()])
        most = max(float(fit[_KEYS[0]]["hi"]) for fit in usable.values())
        white = max(white, min(shown, most))
    walk = min(walk, _most_walk(runs, model))
    n, b, k = (
        float(np.quantile([fit[key]["hi"] for fit in those], _QUANTILE))
        for key, those in zip(_KEYS, fits_of, strict=True)
    )
    return msgspec.structs.replace(with_turn_on(GivenNoise(white, flicker, walk, None), runs, model), most=(n, b, k))


class GivenNoise(NamedTuple):
    """Noise given by the user: N, B and K in the units of `NoiseCoefficients`, and turn-on scatter if known."""

    N: float
    B: float
    K: float
    turn_on: float | None


def with_turn_on(noise: GivenNoise, runs: Sequence[RunBlocks], model: ErrorModel) -> ModelNoise:
    """Noise with turn-on scatter: as given, else that of the runs' constants, for a single run the flicker."""
    white, flicker, walk, turn_on = noise
    if turn_on is None:
        constants = np.array([constant for _, constant in run_constants(runs, model)])
        turn_on = flicker
        if len(constants) > 1:
            turn_on = _NORMAL_PER_MAD * float(np.median(np.abs(constants - np.median(constants))))
    return ModelNoise(N=white, B=flicker, K=walk, turn_on=turn_on)


def _unknown(en: str, zh: str) -> NoEstimate:
    return NoEstimate(Bilingual(en, zh))


def _lengths_s(runs: Sequence[RunBlocks]) -> dict[str, float]:
    """Length of each run, and of each whole run of power-ons."""
    found: dict[str, float] = defaultdict(float)
    for run in runs:
        for name in {run.run, run.whole_run}:
            found[name] += run.value.size * run.block_s
    return found


def _is_turned(run: RunBlocks) -> bool:
    """Whether the signal of a run is mostly the rate at which the unit was rotated."""
    for name in _RATES:
        if name not in run.channels:
            continue
        pairs = np.column_stack([run.mean(name), run.value])
        pairs = pairs[np.isfinite(pairs).all(axis=1)]
        if len(pairs) < 3 or np.ptp(pairs[:, 0]) == 0:
            continue
        rate, value = (pairs - pairs.mean(axis=0)).T
        left = value - rate * (rate @ value) / (rate @ rate)
        return bool(value @ value > _MOST_DRIVEN * (left @ left))
    return False


def _white_of_blocks(runs: Sequence[RunBlocks]) -> float:
    """White noise that the differences of neighbouring blocks show, deg/sqrt(h); 0 where there are none.

    By the median of their squares, which the few differences at a step or a power-on do not move.
    """
    squares = np.concatenate([[], *(np.diff(run.value) ** 2 * run.block_s / 3600.0 for run in runs)])
    squares = squares[np.isfinite(squares)]
    return math.sqrt(float(np.median(squares)) / (2.0 * MEDIAN_OF_SQUARE)) if squares.size else 0.0


def _most_walk(runs: Sequence[RunBlocks], model: ErrorModel) -> float:
    """Upper bound (95 %) of the random walk beside the declared model, deg/h/sqrt(h); infinite where there is none.

    Of averages over tau next to each other half the mean square difference is at least K**2*tau/3 (IEEE 952-2020).
    """
    found = fit_constants(runs, model)
    most = math.inf
    for number in range(_LEAST_DOUBLINGS, _MOST_DOUBLINGS):
        blocks = 2**number
        steps = np.concatenate([[], *(np.diff(_averages(run, left, blocks)) for run, left in found.residuals)])
        steps = steps[np.isfinite(steps)]
        degrees = steps.size / 2.0  # differences next to each other share an average
        if degrees < _LEAST_DEGREES:
            break
        hours = blocks * runs[0].block_s / 3600.0
        square = 0.5 * float(steps @ steps) / steps.size * degrees / float(chi_square_isf(0.95, degrees))
        most = min(most, math.sqrt(3.0 * square / hours))
    return most


def _averages(run: RunBlocks, value: FloatArray, blocks: int) -> FloatArray:
    """Averages over so many blocks one after the other; NaN where a block lacks."""
    number = run.slot - run.slot[0]
    every = np.full((int(number[-1]) // blocks + 1) * blocks, np.nan)
    every[number] = value
    return np.asarray(every.reshape(-1, blocks).mean(axis=1))


def _value(coefficient: dict[str, Any]) -> float:
    if coefficient["observable"] or coefficient["value"] > 0.0:
        return float(coefficient["value"])
    return float(coefficient["hi"]) * _OF_LIMIT


def run_constants(runs: Sequence[RunBlocks], model: ErrorModel) -> list[tuple[RunBlocks, float]]:
    """Constant of each run beside the model's terms, by least squares; without runs that have no whole block."""
    return fit_constants(runs, model).constants


class ConstantsFit(NamedTuple):
    """Constants of runs beside a model, and what is left of their blocks; without runs that have no whole block."""

    constants: list[tuple[RunBlocks, float]]
    residuals: list[tuple[RunBlocks, FloatArray]]  # NaN where a channel of the model has no value


def fit_constants(runs: Sequence[RunBlocks], model: ErrorModel) -> ConstantsFit:
    """Fit the model's terms and a constant of each run by least squares."""
    every = [np.column_stack([model.columns(run), run.value]) for run in runs]
    both = [each[np.isfinite(each).all(axis=1)] for each in every]
    row = np.repeat(np.arange(len(runs)), list(map(len, both)))
    terms, value = np.split(np.concatenate(both), [-1], axis=1)
    value = value[:, 0]
    present = np.unique(row)
    if len(present) == 0:
        return ConstantsFit([], [])
    own = (row[:, None] == present).astype(np.float64)
    means = (own.T @ np.column_stack([terms, value])) / own.sum(axis=0)[:, None]
    terms, value = terms - own @ means[:, :-1], value - own @ means[:, -1]
    scale = np.sqrt(np.sum(terms**2, axis=0))
    is_known = scale > 1e-9 * (np.abs(means[:, :-1]).max(axis=0, initial=0.0) + 1e-300) * np.sqrt(len(row))
    found, *_ = np.linalg.lstsq(terms[:, is_known], value, rcond=None)
    constants = means[:, -1] - means[:, :-1][:, is_known] @ found
    left = [every[at][:, -1] - every[at][:, :-1][:, is_known] @ found for at in present]
    return ConstantsFit(
        [(runs[at], float(constant)) for at, constant in zip(present, constants, strict=True)],
        [(runs[at], each - constant) for at, constant, each in zip(present, constants, left, strict=True)],
    )
