"""The held-out runs: their answer on each effect, and the error before and after beside that of noise alone."""

from enum import StrEnum
from typing import Any

import msgspec

REFERENCE_S = 1800.0  # averaging time at which errors are compared, if the runs are long enough
WALK_LOG_ODDS = 3.0  # odds of 20 that decide between an effect and a bias that walks from run to run
LEAST_ERROR = 1e-100  # of a slope; below it nothing was predicted
MUCH_GAINED = 0.5  # of the squared error
_PARTS = ("before", "after", "floor", "before_within", "after_within", "floor_within")


class HeldOutAnswer(StrEnum):
    """The answer of the held-out runs on an effect."""

    CONFIRMED = "confirmed"
    REFUSED = "refused"
    # they cannot tell: they excite it too little, a bias that walks resembles it, or it was named with their help
    NO_POWER = "no_power"


class HoldoutSlope(msgspec.Struct, frozen=True):
    """Whitened regression of the held-out residual on the prediction; 1 if the prediction is right.

    Accepted if slope - 1.64*SE > 0, and either abs(slope - 1) < 3.29*sqrt(SE^2 + training_se^2) or, of a large effect,
    the prediction gains at least 0.9 of its gain at the right size: (slope - 1)^2 < 0.1*slope^2. Confirmed if accepted
    and 1.64*SE <= 1. Refused if the slope is three times as likely without the effect as with it, or differs from
    one by 3.29 standard errors; else no power. An effect that raises the error far is refused whatever its slope,
    and one that raises it to 1.25 times is not confirmed. An effect that shifts whole runs is confirmed only if it
    is 20 times as likely as a bias that walks from run to run.
    """

    effect: str  # name; ``all`` for the sum of all
    slope: float
    slope_se: float
    training_se: float  # relative standard error of the frozen coefficient
    accepted: bool
    answer: HeldOutAnswer = HeldOutAnswer.REFUSED
    # log likelihood less that of a bias that walks from run to run; None if the runs themselves show the effect
    walk_log_odds: float | None = None
    is_independent: bool = True  # whether the training runs name the effect without them
    sole_run: str | None = None  # the only run that shows the effect
    raises_error: bool = False  # the RMS error of the held-out runs is larger with it: they contradict it

    @property
    def tells_nothing(self) -> bool:
        """Whether the effect predicts nothing in the held-out runs."""
        return self.slope == 0.0 and self.slope_se < LEAST_ERROR

    @property
    def may_be_walk(self) -> bool:
        """Whether a bias that walks from run to run explains the runs about as well as the effect, or better."""
        return self.walk_log_odds is not None and self.walk_log_odds < WALK_LOG_ODDS


def _refused(slope: HoldoutSlope) -> HoldoutSlope:
    return msgspec.structs.replace(slope, accepted=False, answer=HeldOutAnswer.REFUSED)


def _beside_walk(slope: HoldoutSlope, log_odds: float) -> HoldoutSlope:
    judged = msgspec.structs.replace(slope, walk_log_odds=log_odds)
    if not judged.may_be_walk or slope.answer is HeldOutAnswer.REFUSED:
        return judged
    answer = HeldOutAnswer.REFUSED if log_odds < -WALK_LOG_ODDS else HeldOutAnswer.NO_POWER
    return msgspec.structs.replace(judged, accepted=False, answer=answer)


def _not_independent(slope: HoldoutSlope) -> HoldoutSlope:
    judged = msgspec.structs.replace(slope, is_independent=False)
    if slope.answer is not HeldOutAnswer.CONFIRMED:
        return judged
    return msgspec.structs.replace(judged, accepted=False, answer=HeldOutAnswer.NO_POWER)


def _resting_on(slope: HoldoutSlope, run: str) -> HoldoutSlope:
    judged = msgspec.structs.replace(slope, sole_run=run)
    if slope.answer is not HeldOutAnswer.CONFIRMED:
        return judged
    return msgspec.structs.replace(judged, accepted=False, answer=HeldOutAnswer.NO_POWER)


def _raising(slope: HoldoutSlope) -> HoldoutSlope:
    if slope.answer is not HeldOutAnswer.CONFIRMED:
        return slope
    return msgspec.structs.replace(slope, accepted=False, answer=HeldOutAnswer.NO_POWER, raises_error=True)


class Holdout(msgspec.Struct, frozen=True):
    """The answers of the held-out runs, or segments; coefficients were frozen before."""

    runs: tuple[str, ...]
    total: HoldoutSlope  # for the sum of all effects
    effects: tuple[HoldoutSlope, ...]

    @property
    def accepted(self) -> bool:
        """Whether all effects are confirmed."""
        return self.total.accepted and all(each.accepted for each in self.effects)

    @property
    def overall(self) -> HeldOutAnswer:
        """Confirmed if all effects are, refused if any is, else no power."""
        answers = [self.total.answer, *(each.answer for each in self.effects)]
        if self.accepted:
            return HeldOutAnswer.CONFIRMED
        return HeldOutAnswer.REFUSED if HeldOutAnswer.REFUSED in answers else HeldOutAnswer.NO_POWER

    def slope(self, name: str) -> HoldoutSlope | None:
        """The slope of an effect; None if it was not tested, such as a jump."""
        return next((each for each in self.effects if each.effect == name), None)

    def answer(self, name: str) -> HeldOutAnswer | None:
        """The answer on an effect; None if it was not tested."""
        slope = self.slope(name)
        return None if slope is None else slope.answer

    def may_be_walk(self, name: str) -> bool:
        """Whether a bias that walks from run to run explains the runs about as well as an effect, or better."""
        slope = self.slope(name)
        return slope is not None and slope.may_be_walk

    def refusing(self, name: str) -> "Holdout":
        """The answers with this effect, and so the sum of all, refused."""
        return msgspec.structs.replace(
            self,
            total=_refused(self.total),
            effects=tuple(_refused(e) if e.effect == name else e for e in self.effects),
        )

    def beside_walk(self, name: str, log_odds: float) -> "Holdout":
        """The answers with the odds of this effect over a bias that walks from run to run."""
        is_only = self.total.effect == name
        return msgspec.structs.replace(
            self,
            total=_beside_walk(self.total, log_odds) if is_only else self.total,
            effects=tuple(_beside_walk(e, log_odds) if e.effect == name else e for e in self.effects),
        )

    def not_independent(self, name: str) -> "Holdout":
        """The answers on an effect that the training runs alone do not name: these runs cannot confirm it."""
        is_only = self.total.effect == name
        return msgspec.structs.replace(
            self,
            total=_not_independent(self.total) if is_only else self.total,
            effects=tuple(_not_independent(e) if e.effect == name else e for e in self.effects),
        )

    def resting_on(self, name: str, run: str) -> "Holdout":
        """The answers on an effect that one run alone shows: other runs cannot confirm it."""
        is_only = self.total.effect == name
        return msgspec.structs.replace(
            self,
            total=_resting_on(self.total, run) if is_only else self.total,
            effects=tuple(_resting_on(e, run) if e.effect == name else e for e in self.effects),
        )

    def raising_error(self) -> "Holdout":
        """The answers where the RMS error rises with the effects: none is confirmed."""
        effects = tuple(map(_raising, self.effects))
        return msgspec.structs.replace(self, total=_raising(self.total), effects=effects)

    def raises_error(self, name: str) -> bool:
        """Whether the RMS error of the held-out runs is larger with an effect that would else be confirmed."""
        slope = self.slope(name)
        return slope is not None and slope.raises_error

    def confirms(self, name: str) -> bool | None:
        """Whether an effect is confirmed; None without power or test."""
        answers = {HeldOutAnswer.CONFIRMED: True, HeldOutAnswer.REFUSED: False}
        return answers.get(self.answer(name) or HeldOutAnswer.NO_POWER)

    def document(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "runs": list(self.runs),
            "slope": self.total.slope,
            "slope_se": self.total.slope_se,
            "accepted": self.accepted,
            "answer": self.overall.value,
            "effects": [msgspec.to_builtins(each) for each in self.effects],
        }


class ErrorGain(msgspec.Struct, frozen=True):
    """Relative decrease of the squared error, with its 95 % confidence bounds."""

    fraction: float  # 1 - MSE after / MSE before; negative if the error rises
    lo: float | None  # bounds; None for a single run
    hi: float | None
    runs: int

    @property
    def is_significant(self) -> bool:
        """Whether the error falls significantly."""
        return self.lo is not None and self.lo > 0

    @property
    def is_loss(self) -> bool:
        """Whether the error rises significantly."""
        return self.hi is not None and self.hi < 0


class ExpectedGain(ErrorGain, frozen=True, kw_only=True):
    """The decrease that is expected of new runs, of averages over a time."""

    averaging_s: float


class ErrorAt(msgspec.Struct, frozen=True):
    """RMS of the residual at one averaging time, in the signal's unit."""

    averaging_s: float
    before: float  # with the declared model; coefficients from the training runs
    after: float  # with the model found
    floor: float  # left by the fitted noise alone, including the error of the declared coefficients
    averages: int  # their number
    allowed: float = 0.0  # at most, by that noise and the errors of the sizes of the effects in the training
    excited_before: float | None = None  # the same over averages that excite the effect
    excited_after: float | None = None
    excited_floor: float | None = None
    before_within: float = 0.0  # the same about the mean of each run, without turn-on scatter
    after_within: float = 0.0
    floor_within: float = 0.0
    gain: ErrorGain | None = None  # observed, bounds over runs; None if nothing was found
    gain_within: ErrorGain | None = None  # of the error within runs


class ErrorTable(msgspec.Struct, frozen=True):
    """The error before and after at several averaging times."""

    runs: tuple[str, ...]
    is_held_out: bool  # whether the runs were held out of the fit
    unit_of_measure: str
    rows: tuple[ErrorAt, ...]  # for the block and for 300, 1800 and 3600 s, as far as the runs are long enough
    # (MSE before - after) / (before - floor) at 1800 s; None if nothing exceeds the floor
    achievable_fraction: float | None = None
    achievable_fraction_excited: float | None = None  # over averages that excite the effect
    # of the error within runs, expected of new runs like these, at the averaging time at which the effects act most
    gain: ExpectedGain | None = None

    @property
    def reference(self) -> ErrorAt | None:
        """The errors at 1800 s, or at the longest shorter averaging time with several averages in a run."""
        rows = [row for row in self.rows if row.averaging_s <= REFERENCE_S]
        rows = [row for row in rows if row.before_within > 0] or rows
        return max(rows, key=lambda row: row.averaging_s, default=None)

    @property
    def most_gained(self) -> ErrorAt | None:
        """The averaging time at which the squared error falls most, if by half at least, beyond chance where known."""

        def gain(row: ErrorAt) -> float:
            if row.gain is None or (row.gain.lo is not None and not row.gain.is_significant):
                return -1.0
            return row.gain.fraction

        best = max(self.rows, key=gain, default=None)
        return best if best is not None and gain(best) >= MUCH_GAINED else None

    def document(self) -> dict[str, Any]:
        """JSON form."""
        by_time = {f"rms_{row.averaging_s:g}s": row for row in self.rows}
        return {
            **{part: {key: getattr(row, part) for key, row in by_time.items()} for part in _PARTS},
            "gain": self.gain and {**_document(self.gain), "averaging_s": self.gain.averaging_s},
            "gain_at": {key: row.gain and _document(row.gain) for key, row in by_time.items()},
            "gain_within_at": {key: row.gain_within and _document(row.gain_within) for key, row in by_time.items()},
            "achievable_fraction": self.achievable_fraction,
            "achievable_fraction_excited": self.achievable_fraction_excited,
            "unit_of_measure": self.unit_of_measure,
            "runs": list(self.runs),
            "held_out": self.is_held_out,
        }


def _document(gain: ErrorGain) -> dict[str, Any]:
    return {"value": gain.fraction, "lo": gain.lo, "hi": gain.hi, "runs": gain.runs, "significant": gain.is_significant}
