"""The verdict on a declared error model: the effects that it lacks, their alternatives, detection limits."""

from enum import StrEnum
from typing import Any, Literal

import msgspec
import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.notes.left_out import LeftOut
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.result.holdout import ErrorTable, Holdout
from analytics.methods.distributions import chi_square_sf


class EffectCoefficient(msgspec.Struct, frozen=True):
    """A coefficient with its 95 % confidence bounds; `name` is that of its column, such as ``cos``."""

    name: str
    value: float
    lo: float
    hi: float
    unit_of_measure: str


class ConfoundedEffect(msgspec.Struct, frozen=True):
    """An effect that explains the data as well as the one found."""

    name: str
    parameters: dict[str, Any]  # values of its shape parameters
    evidence_behind: float | None  # to the effect found, in chi-square; None if it was not fitted
    role: str  # cause, proxy or alias
    separating_test: str  # the measurement that separates the two
    separating_test_zh: str
    recorded: bool = True  # whether its channels are; an unrecorded cause cannot be excluded
    coefficient: float | None = None  # its first, if fitted
    implied: float | None = None  # of a clock error: its least size
    most: float | None = None  # the largest plausible size
    implied_unit: str = ""  # of both

    @property
    def is_plausible(self) -> bool:
        """Whether the size that it needs is plausible."""
        return self.implied is None or self.most is None or self.implied <= self.most

    def document(self, beside: str) -> dict[str, Any]:
        """JSON form; `beside` is the name of the effect found."""
        size = {"value": self.implied, "most": self.most, "unit_of_measure": self.implied_unit}
        return {
            "name": self.name,
            "beside": beside,
            "parameters": self.parameters,
            "role": self.role,
            "recorded": self.recorded,
            "separating_test": self.separating_test,
            "implied": None if self.implied is None else size | {"plausible": self.is_plausible},
        }


class BiasTest(msgspec.Struct, frozen=True):
    """Regression of the biases of all runs, held-out ones as well, on a cause that differs between runs only.

    Parameters
    ----------
    runs, tests: Number of biases, and of causes that were tested on them.
    degrees, p_value: Degrees of freedom of Student's t, and its two-sided p-value, below 1 % over the number of tests.
    value, lo, hi: The coefficient over all runs with its 95 % bounds by Student's t.
    is_in_training: Whether the training runs alone name this cause, at 5 % over the number of tests.
    within: Coefficient and standard error within the runs, where these contradict it; else None.
    """

    runs: int
    tests: int
    degrees: int
    p_value: float
    value: float
    lo: float
    hi: float
    is_in_training: bool
    within: tuple[float, float] | None = None


class FoundEffect(msgspec.Struct, frozen=True):
    """An effect that the declared model lacks."""

    name: str
    parameters: dict[str, Any]  # values of its shape parameters
    coefficients: tuple[EffectCoefficient, ...]  # fitted to the training runs
    significance: float  # equivalent z of a test with one degree of freedom; noise fitted with and without the effect
    evidence: float  # equivalent chi-square of one degree less the multiplicity penalty
    roles: dict[str, str]  # of each of its channels: cause, proxy or alias
    parameter_bounds: dict[str, tuple[float, float]] = {}  # 95 %, of a shape parameter that was searched
    confounded: tuple[ConfoundedEffect, ...] = ()  # effects that the data cannot separate from it
    companions: tuple[str, ...] = ()  # proxies that follow it
    unknown_function_of: tuple[str, ...] = ()  # channels on which the residual depends in another form
    form_p_value: float = 1.0  # test of the form
    heterogeneity_p_value: float = 1.0  # test of equal coefficients in all runs
    largest_share: float = 0.0  # of the best run in the leave-one-run-out gain
    replicates: bool = True  # whether it improves the prediction of runs that it was not fitted to
    confirmed: bool | None = None  # by the held-out runs; None if they cannot answer
    by_run: dict[str, tuple[float, float]] = {}  # first coefficient and its standard error in each run that excites it
    # share of the squared held-out error about the mean of each run that it takes away; None if it predicts nothing
    error_share: float | None = None
    sole_run: str | None = None  # the run without which the biases of the others do not show it
    coincides: tuple[str, ...] = ()  # of a jump: channels that step at the same time, which may be its cause
    of_biases: BiasTest | None = None  # if the search did not find it, but the biases of all runs follow it

    @property
    def is_sized(self) -> bool:
        """Whether the training runs give it a size: the bounds of a coefficient leave out zero."""
        return any(each.lo > 0 or each.hi < 0 for each in self.coefficients)

    @property
    def has_no_size(self) -> bool:
        """Whether its only coefficient may as well be zero."""
        return len(self.coefficients) == 1 and not self.is_sized

    def document(self) -> dict[str, Any]:
        """JSON form: one coefficient as a number, several as lists in the order of `columns`."""
        each = self.coefficients
        document: dict[str, Any] = {"name": self.name, "parameters": self.parameters}
        if len(each) == 1:
            document["coefficient"] = each[0].value
        else:
            document |= {"columns": [one.name for one in each], "coefficient": [one.value for one in each]}
        document["unit_of_measure"] = each[0].unit_of_measure
        for bound in ("lo", "hi"):
            values = [getattr(one, bound) for one in each]
            document[bound] = values[0] if len(each) == 1 else values
        return document | {
            "parameter_bounds": {name: list(bounds) for name, bounds in self.parameter_bounds.items()},
            "significance": self.significance,
            "evidence": self.evidence,
            "roles": self.roles,
            "companions": list(self.companions),
            "unknown_function_of": list(self.unknown_function_of),
            "heterogeneity_p_value": self.heterogeneity_p_value,
            "confirmed": self.confirmed,
            "error_share": self.error_share,
            "by_run": {run: {"coefficient": value, "se": se} for run, (value, se) in self.by_run.items()},
            "sole_run": self.sole_run,
            "coincides": list(self.coincides),
            "of_biases": msgspec.to_builtins(self.of_biases),
        }


class DetectionLimit(msgspec.Struct, frozen=True):
    """Detection limit of an effect that was not found."""

    coefficient: float  # smallest that is found with a probability of 90 %
    absent_above: float  # larger ones are excluded at 95 %
    unit_of_measure: str


class ModelVerdict(StrEnum):
    """The verdict of the measured data on a declared error model."""

    NOTHING_MISSING = "nothing_missing"
    EFFECT_FOUND = "effect_found"
    CONFOUNDED = "confounded"  # an effect is present; the data cannot separate several candidates
    UNREPLICATED = "unreplicated"  # seen once, refused by the held-out runs, or not tested by them
    UNKNOWN_FUNCTION = "unknown_function"  # depends on a channel, but not in the form of any effect of the library
    UNEXPLAINED = "unexplained"  # more noise than declared, or held-out error than noise, without an explanation
    NOT_ENOUGH_DATA = "not_enough_data"


class Diagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """The result of a trace."""

    verdict: ModelVerdict
    units: tuple[str, ...]
    signal: str
    effects: tuple[FoundEffect, ...] = ()  # missing ones, largest evidence first; confirmed by the held-out runs if any
    unreplicated: tuple[FoundEffect, ...] = ()  # seen, but not in other runs, or refused by the held-out runs
    holdout: Holdout | None = None  # None if no runs were held out or nothing was found
    error: ErrorTable | None = None
    noise: ModelNoise | None = None  # fitted with the model found
    declared_noise: ModelNoise | None = None  # None if it was estimated from these data
    # largest ratio of fitted to declared noise variance at averages of 300 and 3600 s
    noise_excess: float | None = None
    detection_limits: dict[str, DetectionLimit] = {}  # of effects tested and not found
    not_tested: dict[str, Bilingual] = {}  # effects that could not be tested, and why
    limits: tuple[Bilingual, ...] = ()  # caveats of the verdict
    replication: Literal["runs", "within_run"] = "runs"  # the replicates: runs, or contiguous segments of one run
    training_runs: tuple[str, ...] = ()  # the fitted ones of `runs`
    runs: tuple[str, ...] = ()
    declared: ErrorModel | None = None  # fitted to the training runs with its own noise, as is the model found
    model: ErrorModel | None = None
    # declared model as `error` has it: by `noise` or ordinary least squares, as predicts better
    judged: ErrorModel | None = None
    missing: tuple[Bilingual, ...] = ()  # what is missing if the verdict is not_enough_data
    left_out: tuple[LeftOut, ...] = ()  # of the record, the worst first
    tests: float = 1.0  # independent tests of the search, for the probability of a false alarm
    # undeclared turn-on scatter far above the noise within the runs, which may hide an effect between runs
    scatter: Bilingual | None = None
    unexplained: Bilingual | None = None  # by how much the held-out error exceeds the noise, if it is far above

    @property
    def held_out_runs(self) -> tuple[str, ...]:
        """Runs, or segments, that were held out of the fit."""
        return tuple(run for run in self.runs if run not in self.training_runs)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects found."""
        return tuple(effect.name for effect in self.effects)

    def false_alarm(self, found: FoundEffect) -> float:
        """Probability that noise of the fitted model shows an effect as significant in any of the tests."""
        tests = self.tests if found.of_biases is None else found.of_biases.tests
        p_value = float(chi_square_sf(found.significance**2, 1))
        return float(-np.expm1(tests * np.log1p(-min(p_value, 1.0 - 1e-15))))

    @property
    def by_size(self) -> tuple[FoundEffect, ...]:
        """The effects in the order of a report: confirmed ones first, then by the share of the error they explain."""
        return tuple(sorted(self.effects, key=lambda each: (not each.confirmed, -(each.error_share or 0.0))))

    @property
    def losses(self) -> tuple[Bilingual, ...]:
        """Parts left out that a reader has to know before the verdict."""
        return tuple(each.sentence for each in self.left_out if each.is_grave)

    @property
    def confounded(self) -> tuple[ConfoundedEffect, ...]:
        """All effects that the data cannot separate from one that was found."""
        return tuple(other for effect in self.effects for other in effect.confounded)

    def document(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "verdict": self.verdict.value,
            "units": list(self.units),
            "signal": self.signal,
            "effects": [
                effect.document() | {"false_alarm_probability": self.false_alarm(effect)} for effect in self.effects
            ],
            "confounded": [other.document(effect.name) for effect in self.effects for other in effect.confounded],
            "unreplicated": [
                effect.document() | {"confounded": [other.document(effect.name) for other in effect.confounded]}
                for effect in self.unreplicated
            ],
            "holdout": None if self.holdout is None else self.holdout.document(),
            "error": None if self.error is None else self.error.document(),
            "noise": self._noise(),
            "detection_limits": msgspec.to_builtins(self.detection_limits),
            "not_tested": {name: str(why) for name, why in self.not_tested.items()},
            "limits": [str(each) for each in self.limits],
            "missing": [str(each) for each in self.missing],
            "left_out": [each.document() for each in self.left_out],
            "replication": self.replication,
            "training_runs": list(self.training_runs),
            "model": None if self.model is None else {"text": str(self.model), **msgspec.to_builtins(self.model)},
        }

    def _noise(self) -> dict[str, Any] | None:
        if self.noise is None:
            return None
        declared = None if self.declared_noise is None else msgspec.to_builtins(self.declared_noise)
        return {**msgspec.to_builtins(self.noise), "declared": declared, "excess": self.noise_excess}
