"""White variance of each block, by run and class of rate; outliers; a first estimate of the noise."""

from operator import methodcaller

import numpy as np
from scipy import ndimage

from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.whitening.least_squares import fit
from analytics.loop.tracing.whitening.stack import (
    DECLARED_SPREAD,
    ESTIMATED_SPREAD,
    SINGLE_RUN_SPREAD,
    NoisePrior,
    Stack,
    UnitRecord,
)
from analytics.loop.tracing.whitening.whitener import NoiseModel
from stream.batch import BoolArray, FloatArray, IntArray

RATE_CLASSES = (0.0005, 0.05, 0.1, 0.2, 0.4, 0.7)  # edges of classes of rate over the largest rate, the first at rest
FEWEST_PAIRS = 40  # of a run and class; with fewer, the class of all runs counts
SLOW_SHARE = 0.05  # prior share of flicker, and of random walk, in the block-to-block scatter of a single run
LIKELY_CHANCE = 0.25  # logarithm of a variance ratio expected by chance from 40 pairs; such logarithms are halved
LEAST_RATIO, LARGEST_RATIO = 0.3, 50.0
BURST_BLOCKS, LEAST_BURST = 5, 2.0
OUTLIER = 4.5
OUTLIER_RATIO = 1e3
MOST_OUTLIERS = 0.02
MAD_TO_SIGMA = 1.4826
TENTH_TO_SIGMA = 0.608
COARSE = 0.3  # variance by the median over that by the upper tenth: 1 for Gaussian noise, 0.8 for Student t(3)


def record_of(
    stack: Stack, declared: ModelNoise | None, beside: FloatArray | None = None, *, turn_on_is_declared: bool = True
) -> UnitRecord:
    """The blocks with the white variance of each; their noise is estimated unless declared.

    `beside` are columns of effects: what they explain is no noise, and no outlier. Turn-on scatter of a `declared`
    noise may be an estimate from these runs.
    """
    value, steps, noise_model = stack.value, stack.steps, stack.noise_model
    design = stack.design if beside is None else np.column_stack([stack.design, beside])
    residual = np.asarray(value - design @ fit(design, value).coefficients)
    if declared is not None:
        spread = DECLARED_SPREAD if turn_on_is_declared else np.append(DECLARED_SPREAD[:3], ESTIMATED_SPREAD[3])
        prior = NoisePrior(declared, spread, turn_on_is_declared)
    elif len(stack.runs) == 1:
        prior = NoisePrior(_from_one_run(stack, residual, steps, noise_model), SINGLE_RUN_SPREAD)
    else:
        prior = NoisePrior(_estimated(stack, residual, steps, noise_model), ESTIMATED_SPREAD, False)
    white = _relative_white(stack, residual, steps, noise_model.space(prior.center).white)
    record = UnitRecord(stack, value, stack.design, steps, noise_model, prior, white)
    white[_outliers(record, beside)] *= OUTLIER_RATIO
    return record


def _pair_variance(differences: FloatArray) -> float:
    """White variance from the median of differences of neighbours, robust against drift and outliers."""
    return _median_variance(np.abs(differences - np.median(differences)))


def _median_variance(apart: FloatArray) -> float:
    return float((MAD_TO_SIGMA * np.median(apart)) ** 2 / 2)


def _class_variance(differences: FloatArray) -> float:
    """White variance of blocks of one class; from the upper tenth of the differences if the signal is coarse."""
    apart = np.abs(differences - np.median(differences))
    usual = _median_variance(apart)
    tenth = float(np.quantile(apart, 0.9))
    wide = (TENTH_TO_SIGMA * tenth) ** 2 / 2
    return usual if usual > COARSE * wide else wide


def _neighbours(stack: Stack, steps: IntArray) -> BoolArray:
    """Mark the blocks whose predecessor is at the shortest interval of the run."""
    marks = np.zeros(len(stack), dtype=bool)
    number = stack.run_number
    for run in range(len(stack.runs)):
        of_run = (number == run) & (steps > 0)
        if of_run.any():
            marks |= of_run & (steps == steps[of_run].min())
    return marks


def rate_classes(stack: Stack) -> tuple[IntArray, IntArray]:
    """Class of the rate at which each block turns about any axis, and about the input axis as well."""
    classes = []
    for names in (("input_rate", "rate_o", "rate_s", "table_rate"), ("input_rate",)):
        rate = np.zeros(len(stack))
        for name in names:
            if all(name in run.channels for run in stack.runs):
                rate = np.maximum(rate, np.abs(np.nan_to_num(stack.column(methodcaller("mean", name)))))
        classes.append(np.digitize(rate, np.array(RATE_CLASSES) * max(float(rate.max()), 1e-300)))
    return classes[0], classes[0] * (len(RATE_CLASSES) + 1) + classes[1]


def _relative_white(stack: Stack, residual: FloatArray, steps: IntArray, expected: float) -> FloatArray:
    """White variance of each block over the expected one, by run and class of rate."""
    difference = np.diff(residual, prepend=0.0)
    number = stack.run_number
    turning, both = rate_classes(stack)
    same = _neighbours(stack, steps) & (np.diff(both, prepend=-1) == 0)
    ratio = np.ones(len(stack))
    in_run = [number == run for run in range(len(stack.runs))]
    groups = list(in_run)
    for classes in (turning, both):  # the finest group with enough pairs counts
        in_class = [classes == each for each in np.unique(classes)]
        groups += [*in_class, *(run & each for run in in_run for each in in_class)]
    for rows in groups:
        if np.count_nonzero(rows & same) >= FEWEST_PAIRS:
            ratio[rows] = _class_variance(difference[rows & same]) / expected
    logarithm = np.log(np.clip(ratio, LEAST_RATIO, LARGEST_RATIO))
    return np.exp(np.where(np.abs(logarithm) < LIKELY_CHANCE, logarithm / 2, logarithm)) * _bursts(stack, turning)


def _bursts(stack: Stack, rate_class: IntArray) -> FloatArray:
    """Ratio of the scatter within blocks to that of their run and class, in bursts; 1 elsewhere."""
    scatter = stack.column(lambda run: run.white_variance)
    factor = np.ones(len(stack))
    number = stack.run_number
    for run in range(len(stack.runs)):
        for each in np.unique(rate_class[number == run]):
            own = (number == run) & (rate_class == each)
            if np.count_nonzero(own) < FEWEST_PAIRS or not np.all(np.isfinite(scatter[own])):
                continue
            usual = float(np.median(scatter[own]))
            if usual > 0:
                factor[own] = ndimage.median_filter(scatter[own], BURST_BLOCKS, mode="nearest") / usual
    return np.where(factor > LEAST_BURST, np.minimum(factor, LARGEST_RATIO), 1.0)


def _outliers(record: UnitRecord, beside: FloatArray | None) -> BoolArray:
    """Blocks far from their prediction by the preceding blocks; none if they exceed 2 % of all."""
    columns = record.design if beside is None else np.column_stack([record.design, beside])
    whitened = record.whitener(record.prior.center)(np.column_stack([record.value, columns]))
    residual = whitened[:, 0] - whitened[:, 1:] @ fit(whitened[:, 1:], whitened[:, 0]).coefficients
    far = np.zeros(len(record), dtype=bool)
    number = record.stack.run_number
    for run in range(len(record.stack.runs)):
        of_run = number == run
        sigma = MAD_TO_SIGMA * np.median(np.abs(residual[of_run]))
        far[of_run] = np.abs(residual[of_run]) > OUTLIER * max(float(sigma), 1e-300)
    far &= record.steps > 0
    if np.count_nonzero(far) > MOST_OUTLIERS * len(record):
        far[:] = False
    return far


def _estimated(stack: Stack, residual: FloatArray, steps: IntArray, noise_model: NoiseModel) -> ModelNoise:
    """Noise coefficients estimated from the residual of the declared model, within a small factor."""
    white, number = _scatter(stack, residual, steps), stack.run_number
    means = np.array([residual[number == run].mean() for run in range(len(stack.runs))])
    long = max(2, round(len(stack) / len(stack.runs) / 8))
    slow = _average_variance(residual, number, long) - white / long
    floor = 0.05 * white / long
    slow = max(slow, floor)
    hours = long * _usual_step_h(stack, steps, noise_model)
    turn_on = float(np.var(means)) if means.size > 1 else slow
    return ModelNoise(
        N=float(np.sqrt(white * noise_model.block_h)),
        B=float(np.sqrt(slow / 2 / 0.44)),
        K=float(np.sqrt(slow / 2 * 3 / hours)),
        turn_on=float(np.sqrt(max(turn_on, floor))),
    )


def _from_one_run(stack: Stack, residual: FloatArray, steps: IntArray, noise_model: NoiseModel) -> ModelNoise:
    """Noise of a single run, from its block-to-block scatter alone.

    In one run a random walk and a slow effect look alike. Estimated from slow changes, the walk would absorb every
    effect, so the scatter is attributed to white noise, and only a small share to flicker and random walk.
    """
    scatter = _scatter(stack, residual, steps)
    slow = SLOW_SHARE * scatter
    return ModelNoise(
        N=float(np.sqrt(scatter * noise_model.block_h)),
        B=float(np.sqrt(slow / 0.44)),
        K=float(np.sqrt(slow / _usual_step_h(stack, steps, noise_model))),
        turn_on=float(np.sqrt(scatter)),
    )


def _scatter(stack: Stack, residual: FloatArray, steps: IntArray) -> float:
    """White variance by the differences of neighbours, above 0."""
    differences = np.diff(residual, prepend=0.0)[_neighbours(stack, steps)]
    scatter = _pair_variance(differences) if differences.size else float(np.var(residual))
    return max(scatter, 1e-12 * float(np.mean(residual**2)), 1e-300)


def _usual_step_h(stack: Stack, steps: IntArray, noise_model: NoiseModel) -> float:
    """Typical interval of blocks, hours; longer than a block if the record consists of bursts."""
    near = steps[_neighbours(stack, steps)]
    return noise_model.block_h * (float(np.median(near)) if near.size else 1.0)


def _average_variance(residual: FloatArray, number: IntArray, length: int) -> float:
    """Allan variance of averages of `length` blocks, pooled over runs."""
    squares = []
    for run in np.unique(number):
        own = residual[number == run]
        averages = own[: own.size // length * length].reshape(-1, length).mean(axis=1)
        squares.append(np.diff(averages) ** 2 / 2)
    joined = np.concatenate(squares)
    return float(np.median(joined) / 0.455) if joined.size else 0.0
