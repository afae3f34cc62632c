"""What a trace of the residual says: the verdict, its evidence, and the error before and after; JSON."""

from enum import StrEnum
from typing import Any, Literal

import msgspec

from analytics.loop.blocks.left_out import LeftOut
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.tracing.error_result import ErrorTable


class Verdict(StrEnum):
    """What the measured data say of a declared error model."""

    NOTHING_MISSING = "nothing_missing"
    EFFECT_FOUND = "effect_found"
    CONFOUNDED = "confounded"
    """An effect is there; the data cannot tell which of several."""
    UNREPLICATED = "unreplicated"
    """Seen once, refused by the held-out runs, or not put to the test: none were held out, or they do not excite it."""
    UNKNOWN_FUNCTION = "unknown_function"
    """It depends on a channel, but not as any effect of the library does."""
    UNEXPLAINED = "unexplained"
    """More noise than declared, or a larger error in the held-out runs than the noise, and nothing that explains it."""
    NOT_ENOUGH_DATA = "not_enough_data"


class Answer(StrEnum):
    """What the held-out runs say of an effect."""

    CONFIRMED = "confirmed"
    REFUSED = "refused"
    NO_POWER = "no_power"
    """They hardly excite it: in such runs a true effect of this size shows too seldom for its absence to mean much."""


class Coefficient(msgspec.Struct, frozen=True):
    """One coefficient with its 95 % limits; `name` tells columns apart, such as ``cos`` and ``sin``."""

    name: str
    value: float
    lo: float
    hi: float
    unit_of_measure: str


class ConfoundedEffect(msgspec.Struct, frozen=True):
    """An effect that explains the data as well as the one that is named.

    Parameters
    ----------
    name: Of the effect.
    parameters: Values of its shape parameters.
    evidence_behind: By how much its evidence is less than that of the named effect, in units of chi-square; None where
        it was not compared, as of a cause that is not recorded.
    role: cause, proxy or alias.
    separating_test, separating_test_zh: The measurement that would tell them apart.
    recorded: Whether its channels are in the record; what is not recorded cannot be excluded.
    coefficient: Its first coefficient, where it was fitted.
    implied, most: Of a clock's error: how large it would have to be, at least, and the most that clocks are off.
    implied_unit: Unit of measure of both.
    """

    name: str
    parameters: dict[str, Any]
    evidence_behind: float | None
    role: str
    separating_test: str
    separating_test_zh: str
    recorded: bool = True
    coefficient: float | None = None
    implied: float | None = None
    most: float | None = None
    implied_unit: str = ""

    @property
    def is_plausible(self) -> bool:
        """Whether it can be as large as it would have to be."""
        return self.implied is None or self.most is None or self.implied <= self.most


class HoldoutSlope(msgspec.Struct, frozen=True):
    """Regression of the held-out residual on what was predicted, whitened; 1 where the prediction is right.

    Parameters
    ----------
    effect: Whose prediction; ``all`` for the sum.
    slope, slope_se: The slope and its standard error.
    training_se: Relative standard error of the coefficient that was frozen.
    accepted: 1.64*SE < 1 and slope - 1.64*SE > 0, and either abs(slope - 1) < 3.29*sqrt(SE^2 + training_se^2) or, of a
        large effect, the prediction as it is wins at least 0.9 of what it would win at its right size: (slope - 1)^2 <
        0.1*slope^2.
    answer: Confirmed if accepted; no power if 1.64*SE > 1 and the slope agrees with one, even if it is far from zero by
        luck, or if 2.48*SE > 1 and it agrees with zero and with one; else refused.
    """

    effect: str
    slope: float
    slope_se: float
    training_se: float
    accepted: bool
    answer: Answer = Answer.REFUSED


class Holdout(msgspec.Struct, frozen=True):
    """What the runs say that were held out; coefficients frozen before they were looked at.

    Parameters
    ----------
    runs: The runs, or the segments of the run.
    total: Of all found effects together.
    effects: Of each.
    """

    runs: tuple[str, ...]
    total: HoldoutSlope
    effects: tuple[HoldoutSlope, ...]

    @property
    def accepted(self) -> bool:
        """Whether all of it is confirmed."""
        return self.total.accepted and all(each.accepted for each in self.effects)

    @property
    def overall(self) -> Answer:
        """Confirmed if all of it is, refused if any of it is, else no power."""
        answers = [self.total.answer, *(each.answer for each in self.effects)]
        if self.accepted:
            return Answer.CONFIRMED
        return Answer.REFUSED if Answer.REFUSED in answers else Answer.NO_POWER

    def answer(self, name: str) -> Answer | None:
        """What the held-out runs say of an effect; None where they were not asked, as of a jump."""
        return next((each.answer for each in self.effects if each.effect == name), None)

    def confirms(self, name: str) -> bool | None:
        """Whether they confirm an effect; None where they cannot tell or were not asked."""
        return {Answer.CONFIRMED: True, Answer.REFUSED: False}.get(self.answer(name) or Answer.NO_POWER)


class FoundEffect(msgspec.Struct, frozen=True):
    """An effect that the declared model lacks.

    Parameters
    ----------
    name, parameters: The effect and the values of its shape parameters.
    coefficients: As fitted to the training runs.
    significance: Of the effect as a whole, as the z of a test with one degree of freedom, noise re-fitted with and
        without it.
    evidence: Chi-square of one degree less the multiplicity penalty.
    roles: Part that each of its channels plays: cause, proxy or alias.
    confounded: Others that the data cannot tell from it.
    companions: Proxies that follow it.
    unknown_function_of: Channels on which the residual depends in another way than this effect says; empty where its
        form fits.
    form_p_value: Of the test of that.
    heterogeneity_p_value: Of the test that the coefficient is the same in all runs.
    largest_share: Share of the leave-one-run-out gain that the best run alone gives.
    replicates: Whether runs that were not used to fit it are predicted better with it.
    confirmed: What the held-out runs say; None where they could not be asked.
    by_run: First coefficient and its standard error in each run that excites it.
    """

    name: str
    parameters: dict[str, Any]
    coefficients: tuple[Coefficient, ...]
    significance: float
    evidence: float
    roles: dict[str, str]
    confounded: tuple[ConfoundedEffect, ...] = ()
    companions: tuple[str, ...] = ()
    unknown_function_of: tuple[str, ...] = ()
    form_p_value: float = 1.0
    heterogeneity_p_value: float = 1.0
    largest_share: float = 0.0
    replicates: bool = True
    confirmed: bool | None = None
    by_run: dict[str, tuple[float, float]] = {}

    def document(self) -> dict[str, Any]:
        """Return it as it stands in JSON: one coefficient as a number, several as lists in the order of `columns`."""
        document: dict[str, Any] = {"name": self.name, "parameters": self.parameters}
        if len(self.coefficients) == 1:
            one = self.coefficients[0]
            document |= {"coefficient": one.value, "unit_of_measure": one.unit_of_measure, "lo": one.lo, "hi": one.hi}
        else:
            document |= {
                "columns": [each.name for each in self.coefficients],
                "coefficient": [each.value for each in self.coefficients],
                "unit_of_measure": self.coefficients[0].unit_of_measure,
                "lo": [each.lo for each in self.coefficients],
                "hi": [each.hi for each in self.coefficients],
            }
        return document | {
            "significance": self.significance,
            "evidence": self.evidence,
            "roles": self.roles,
            "companions": list(self.companions),
            "unknown_function_of": list(self.unknown_function_of),
            "heterogeneity_p_value": self.heterogeneity_p_value,
            "confirmed": self.confirmed,
            "by_run": {run: {"coefficient": value, "se": se} for run, (value, se) in self.by_run.items()},
        }


class DetectionLimit(msgspec.Struct, frozen=True):
    """How small an effect that was not found can have been.

    Parameters
    ----------
    coefficient: Smallest coefficient that would have been found with a probability of 90 %.
    absent_above: A coefficient larger than this is excluded at 95 %.
    unit_of_measure: Of both.
    """

    coefficient: float
    absent_above: float
    unit_of_measure: str


class Diagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of a trace.

    Parameters
    ----------
    verdict: In one word.
    units, signal: Of which units and signal.
    effects: What is missing, largest evidence first; confirmed by the held-out runs where there are any.
    unreplicated: What was seen but does not repeat in other runs, or was refused by the held-out runs.
    holdout: None where no held-out set was possible or nothing was found.
    error: Before, after, floor.
    noise: As fitted with the model found.
    declared_noise: As declared, None where it was estimated from these data.
    noise_excess: Largest ratio of fitted to declared noise variance at averages of 300 and 3600 s.
    detection_limits: By name of the effects that were looked for and not found.
    not_tested: Effects that could not be looked for, and why.
    limits: What the reader has to know of this verdict.
    replication: What was left out and predicted: runs, or contiguous segments of one run.
    training_runs, runs: Runs that were fitted; all runs.
    declared, model: The declared model and the model with what was found, both fitted to the training runs, each with
        its own noise.
    judged: The declared model as `error` judges it: fitted with the noise of the model found or by plain least squares,
        whichever predicts the held-out runs better.
    missing: What is missing where the verdict is not_enough_data.
    left_out: What was left out of the record, with its share and why; the worst first.
    unexplained: By how much the error of the model found exceeds the noise in the held-out runs, where that is far.
    """

    verdict: Verdict
    units: tuple[str, ...]
    signal: str
    effects: tuple[FoundEffect, ...] = ()
    unreplicated: tuple[FoundEffect, ...] = ()
    holdout: Holdout | None = None
    error: ErrorTable | None = None
    noise: NoiseCoefficients | None = None
    declared_noise: NoiseCoefficients | None = None
    noise_excess: float | None = None
    detection_limits: dict[str, DetectionLimit] = {}
    not_tested: dict[str, str] = {}
    limits: tuple[str, ...] = ()
    replication: Literal["runs", "within_run"] = "runs"
    training_runs: tuple[str, ...] = ()
    runs: tuple[str, ...] = ()
    declared: ErrorModel | None = None
    model: ErrorModel | None = None
    judged: ErrorModel | None = None
    missing: tuple[str, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    unexplained: str | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects found."""
        return tuple(effect.name for effect in self.effects)

    @property
    def losses(self) -> tuple[str, ...]:
        """What was left out and is a limit before anything else is said."""
        return tuple(each.sentence for each in self.left_out if each.is_grave)

    @property
    def confounded(self) -> tuple[ConfoundedEffect, ...]:
        """Every other effect that the data cannot tell from one that was found."""
        return tuple(other for effect in self.effects for other in effect.confounded)

    def document(self) -> dict[str, Any]:
        """Return it as it stands in JSON."""
        return {
            "verdict": self.verdict.value,
            "units": list(self.units),
            "signal": self.signal,
            "effects": [effect.document() for effect in self.effects],
            "confounded": [_confounded(effect.name, other) for effect in self.effects for other in effect.confounded],
            "unreplicated": [effect.document() for effect in self.unreplicated],
            "holdout": _holdout(self.holdout),
            "error": None if self.error is None else self.error.document(),
            "noise": self._noise(),
            "detection_limits": msgspec.to_builtins(self.detection_limits),
            "not_tested": dict(self.not_tested),
            "limits": list(self.limits),
            "missing": list(self.missing),
            "left_out": [each.document() for each in self.left_out],
            "replication": self.replication,
            "training_runs": list(self.training_runs),
            "model": None if self.model is None else {"text": str(self.model), **msgspec.to_builtins(self.model)},
        }

    def to_json(self) -> str:
        """Return it as JSON."""
        return msgspec.json.encode(self.document()).decode()

    def _noise(self) -> dict[str, Any] | None:
        if self.noise is None:
            return None
        declared = None if self.declared_noise is None else msgspec.to_builtins(self.declared_noise)
        return {**msgspec.to_builtins(self.noise), "declared": declared, "excess": self.noise_excess}


def _confounded(beside: str, other: ConfoundedEffect) -> dict[str, Any]:
    return {
        "name": other.name,
        "beside": beside,
        "parameters": other.parameters,
        "role": other.role,
        "recorded": other.recorded,
        "separating_test": other.separating_test,
        "implied": _implied(other),
    }


def _implied(other: ConfoundedEffect) -> dict[str, Any] | None:
    if other.implied is None:
        return None
    return {
        "value": other.implied,
        "most": other.most,
        "unit_of_measure": other.implied_unit,
        "plausible": other.is_plausible,
    }


def _holdout(holdout: Holdout | None) -> dict[str, Any] | None:
    if holdout is None:
        return None
    return {
        "runs": list(holdout.runs),
        "slope": holdout.total.slope,
        "slope_se": holdout.total.slope_se,
        "accepted": holdout.accepted,
        "answer": holdout.overall.value,
        "effects": [msgspec.to_builtins(each) for each in holdout.effects],
    }
