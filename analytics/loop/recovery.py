"""Plant and recover: how often effects of the sizes found are found again, planted in noise like that of the data."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import msgspec
import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.residuals import Residuals
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from stream.batch import FloatArray


class Recovery(msgspec.Struct, frozen=True, kw_only=True):
    """How often an effect was found again.

    Parameters
    ----------
    alone: Times it was a single name.
    in_set: Times it was among names that the data cannot separate.
    lo, hi: 95 % confidence bounds of the share of both (Clopper and Pearson).
    """

    tries: int
    alone: int
    in_set: int
    lo: float
    hi: float

    @property
    def share(self) -> float:
        """Share of the tries in which it was found."""
        return (self.alone + self.in_set) / self.tries


def recovered(
    diagnosis: Diagnosis,
    residuals: Residuals,
    model: ErrorModel,
    tries: int,
    *,
    declared_noise: ModelNoise | None = None,
    seed: int = 0,
    on_progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Recovery]:
    """Plant the model found in noise of the fitted coefficients, on the channels of the data, and diagnose again.

    Lines, jumps and turn-on scatter are no terms of the model, and are not planted.

    Parameters
    ----------
    model, declared_noise: As they were diagnosed.
    tries: Diagnoses with noise of their own.
    """
    assert diagnosis.model is not None
    stack = residuals.record.stack
    whitener = residuals.record.whitener(residuals.noise)
    rng = np.random.default_rng(seed)
    # the segments of a single run are not runs to name
    held_out = None if diagnosis.replication == "within_run" else diagnosis.held_out_runs
    names = [name for name in diagnosis.names if name in diagnosis.model.effects]
    planted = stack.column(diagnosis.model.predict)
    alone = dict.fromkeys(names, 0)
    in_set = dict.fromkeys(names, 0)
    for number in range(tries):
        on_progress(f"planting what was found ({number + 1} of {tries})")
        noise = whitener.colour(rng.standard_normal((len(stack), 1)))[:, 0]
        runs = _with_values(stack.runs, stack.rows, planted + noise)
        found = diagnose(runs, model, declared_noise=declared_noise, holdout=held_out, seed=seed)
        for name in names:
            alone[name] += any(each.name == name and not each.confounded for each in found.effects)
            sets = [
                {each.name, *(other.name for other in each.confounded)} for each in found.effects if each.confounded
            ]
            in_set[name] += any(name in each for each in sets)
    return {name: _recovery(tries, alone[name], in_set[name]) for name in names}


def _recovery(tries: int, alone: int, in_set: int) -> Recovery:
    from scipy.stats import binomtest  # slow to import

    bounds = binomtest(alone + in_set, tries).proportion_ci(0.95)
    return Recovery(tries=tries, alone=alone, in_set=in_set, lo=float(bounds.low), hi=float(bounds.high))


def _with_values(runs: Sequence[RunBlocks], rows: Sequence[np.ndarray], values: FloatArray) -> list[RunBlocks]:
    parts = np.split(values, np.cumsum([each.size for each in rows])[:-1])
    found = []
    for run, own, part in zip(runs, rows, parts, strict=True):
        value = np.full(len(run), np.nan)
        value[own] = part
        found.append(replace(run, value=value))
    return found
