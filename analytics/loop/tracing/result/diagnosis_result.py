"""The verdict on a declared error model, with its evidence."""

from enum import StrEnum
from typing import Any, Literal

import msgspec

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.left_out import LeftOut
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.noise import ModelNoise
from analytics.loop.tracing.result.error_table import ErrorTable
from analytics.loop.tracing.result.finding import ConfoundedEffect, DetectionLimit, FoundEffect
from analytics.loop.tracing.result.holdout import Holdout


class ModelVerdict(StrEnum):
    """The verdict of the measured data on a declared error model."""

    NOTHING_MISSING = "nothing_missing"
    EFFECT_FOUND = "effect_found"
    CONFOUNDED = "confounded"
    """An effect is present; the data cannot separate several candidates."""
    UNREPLICATED = "unreplicated"
    """Seen once, refused by the held-out runs, or not tested by them: none were held out, or they do not excite it."""
    UNKNOWN_FUNCTION = "unknown_function"
    """The error depends on a channel, but not in the form of any effect of the library."""
    UNEXPLAINED = "unexplained"
    """More noise than declared, or a larger error in the held-out runs than the noise, without an explanation."""
    NOT_ENOUGH_DATA = "not_enough_data"


class Diagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """The result of a trace.

    Parameters
    ----------
    effects: Missing effects, largest evidence first; confirmed by the held-out runs if there are any.
    unreplicated: Seen, but not repeated in other runs, or refused by the held-out runs.
    holdout: None if no runs were held out or nothing was found.
    noise, declared_noise: Fitted with the model found; as declared, None if it was estimated from these data.
    noise_excess: Largest ratio of fitted to declared noise variance at averages of 300 and 3600 s.
    detection_limits: Of the effects that were tested and not found.
    not_tested: Effects that could not be tested, and why.
    limits: Caveats of the verdict.
    replication: The replicates: runs, or contiguous segments of one run.
    training_runs, runs: The fitted runs; all runs.
    declared, model: The declared model and the model found, both fitted to the training runs with their own noise.
    judged: The declared model as `error` compares it: fitted with the noise of the model found or by ordinary least
        squares, whichever predicts the held-out runs better.
    missing: What is missing if the verdict is not_enough_data.
    left_out: Parts of the record that were left out, the worst first.
    unexplained: By how much the error exceeds the noise in the held-out runs, if it is far above.
    """

    verdict: ModelVerdict
    units: tuple[str, ...]
    signal: str
    effects: tuple[FoundEffect, ...] = ()
    unreplicated: tuple[FoundEffect, ...] = ()
    holdout: Holdout | None = None
    error: ErrorTable | None = None
    noise: ModelNoise | None = None
    declared_noise: ModelNoise | None = None
    noise_excess: float | None = None
    detection_limits: dict[str, DetectionLimit] = {}
    not_tested: dict[str, Bilingual] = {}
    limits: tuple[Bilingual, ...] = ()
    replication: Literal["runs", "within_run"] = "runs"
    training_runs: tuple[str, ...] = ()
    runs: tuple[str, ...] = ()
    declared: ErrorModel | None = None
    model: ErrorModel | None = None
    judged: ErrorModel | None = None
    missing: tuple[Bilingual, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    unexplained: Bilingual | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects found."""
        return tuple(effect.name for effect in self.effects)

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
            "effects": [effect.document() for effect in self.effects],
            "confounded": [other.document(effect.name) for effect in self.effects for other in effect.confounded],
            "unreplicated": [effect.document() for effect in self.unreplicated],
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
