"""Whether the biases of a unit's runs differ by station, where its diagnosis says that nothing is missing."""

from collections.abc import Mapping, Sequence
from itertools import combinations

import msgspec
import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.events import STATION
from analytics.loop.model.declared_noise import run_constants
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.result.diagnosis_result import (
    BiasTest,
    Diagnosis,
    EffectCoefficient,
    FoundEffect,
    ModelVerdict,
)
from analytics.loop.tracing.search.fitted_candidates import ALPHA
from analytics.loop.tracing.verdict.noise_agreement import MOST_RUNS
from analytics.loop.tracing.whitening.least_squares import fit
from analytics.methods.distributions import chi_square_isf, f_sf, student_quantile
from stream.batch import FloatArray

_BETWEEN = 1e-6  # spread of a declared column within a run, over its size, below which it differs between runs only


def with_station_levels(
    diagnosis: Diagnosis, runs: Sequence[RunBlocks], stations: Mapping[str, str], model: ErrorModel
) -> Diagnosis:
    """The diagnosis; `unreplicated` with the difference of stations in place of `nothing_missing`, if there is one.

    Analysis of variance of the runs' constants beside the declared model, at 1 %: exact for runs of one length whose
    biases are independent and normal. The two stations that differ most are named, with bounds for all pairs together.

    Parameters
    ----------
    stations: Of each whole run.
    """
    if diagnosis.verdict is not ModelVerdict.NOTHING_MISSING or diagnosis.replication == "within_run":
        return diagnosis
    known = [(run, constant) for run, constant in run_constants(runs, model) if run.whole_run in stations]
    names, at = np.unique(np.array([stations[run.whole_run] for run, _ in known], np.str_), return_inverse=True)
    if len(known) <= MOST_RUNS or names.size < 2:
        return diagnosis
    value = np.array([constant for _, constant in known])
    base = _between([run for run, _ in known], model)
    levels = np.asarray(at[:, None] == np.arange(names.size), np.float64)
    whole = np.column_stack([base, levels[:, 1:]])
    degrees = value.size - int(np.linalg.matrix_rank(whole))
    more = int(np.linalg.matrix_rank(whole)) - int(np.linalg.matrix_rank(base))
    if degrees < 1 or more < names.size - 1:  # a declared term tells the stations apart
        return diagnosis
    found = fit(whole, value)
    left = float(np.sum((value - whole @ found.coefficients) ** 2))
    before = float(np.sum((value - base @ fit(base, value).coefficients) ** 2))
    p_value = f_sf((before - left) / more / max(left / degrees, 1e-300), more, degrees)
    if p_value >= ALPHA:
        return diagnosis
    size = np.concatenate([[0.0], found.coefficients[base.shape[1] :]])
    pairs = list(combinations(range(names.size), 2))
    first, second = max(pairs, key=lambda pair: abs(size[pair[1]] - size[pair[0]]))
    apart = np.zeros(whole.shape[1])
    apart[base.shape[1] :] = (np.arange(1, names.size) == second).astype(float) - (np.arange(1, names.size) == first)
    error = float(np.sqrt(apart @ found.covariance @ apart * left / degrees))
    half = float(student_quantile(1.0 - 0.025 / len(pairs), degrees)) * error
    difference = float(size[second] - size[first])
    label = f"{names[second]} \N{MINUS SIGN} {names[first]}"
    bounds = difference, difference - half, difference + half
    statistic = float(chi_square_isf(max(p_value, 1e-300), 1))
    named = FoundEffect(
        name=STATION,
        parameters={},
        coefficients=(EffectCoefficient(label, *bounds, runs[0].unit_of_measure),),
        significance=float(np.sqrt(statistic)),
        evidence=statistic,
        roles={},
        of_biases=BiasTest(value.size, 1, degrees, p_value, *bounds, is_in_training=False),
    )
    return msgspec.structs.replace(
        diagnosis, verdict=ModelVerdict.UNREPLICATED, unreplicated=(*diagnosis.unreplicated, named)
    )


def _between(runs: Sequence[RunBlocks], model: ErrorModel) -> FloatArray:
    """A constant, and the means of the declared columns that differ between runs only."""
    columns = [model.columns(run) for run in runs]
    means = np.array([np.nanmean(each, axis=0) for each in columns])
    inside = np.max([np.nanstd(each, axis=0) for each in columns], axis=0)
    is_between = inside <= _BETWEEN * np.maximum(np.abs(means).max(axis=0), 1e-300)
    is_between &= np.ptp(means, axis=0) > 0
    return np.column_stack([np.ones(len(runs)), means[:, is_between]])
