"""The answer of the held-out runs: confirmed, refused, or no power."""

from enum import StrEnum
from typing import Any

import msgspec


class HeldOutAnswer(StrEnum):
    """The answer of the held-out runs on an effect."""

    CONFIRMED = "confirmed"
    REFUSED = "refused"
    NO_POWER = "no_power"
    """They hardly excite the effect: they would miss a true effect of this size too often."""


class HoldoutSlope(msgspec.Struct, frozen=True):
    """Whitened regression of the held-out residual on the prediction; 1 if the prediction is right.

    Parameters
    ----------
    effect: Name of the effect; ``all`` for the sum of all.
    training_se: Relative standard error of the frozen coefficient.
    accepted: 1.64*SE < 1 and slope - 1.64*SE > 0, and either abs(slope - 1) < 3.29*sqrt(SE^2 + training_se^2) or, of a
        large effect, the prediction gains at least 0.9 of its gain at the right size: (slope - 1)^2 < 0.1*slope^2.
    answer: Confirmed if accepted; no power if 1.64*SE > 1 and the slope agrees with one, or if 2.48*SE > 1 and the
        slope agrees with zero and with one; else refused.
    """

    effect: str
    slope: float
    slope_se: float
    training_se: float
    accepted: bool
    answer: HeldOutAnswer = HeldOutAnswer.REFUSED


class Holdout(msgspec.Struct, frozen=True):
    """The answers of the held-out runs, or segments; coefficients were frozen before.

    Parameters
    ----------
    total: For the sum of all effects.
    effects: For each effect.
    """

    runs: tuple[str, ...]
    total: HoldoutSlope
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
