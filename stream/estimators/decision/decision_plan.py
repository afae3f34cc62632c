"""Plan and result of an early decision (`decision`)."""

import math
from dataclasses import dataclass
from enum import StrEnum

from stream.errors import EstimatorError
from stream.estimators.decision.decision_bounds import LOOKS, PROMISES

ROUNDING = 1e-9


class Outcome(StrEnum):
    """The decision."""

    PASS = "PASS"  # noqa: S105  not a password
    FAIL = "FAIL"
    UNDECIDED = "UNDECIDED"


class DecisionRule(StrEnum):
    """Rule of a decision, which defines its error probability.

    CURTAILED: the finished test would decide otherwise (0). BOUNDS: this outcome where the true deviation is at the
    limit, per side. FINISHED: the point compared with the limit at the end (0: it is the finished test).
    """

    CURTAILED = "curtailed"
    BOUNDS = "bounds"
    FINISHED = "finished"
    NONE = "none"


@dataclass(frozen=True)
class DecisionPlan:
    """The plan, made before the test begins; it must not be changed because of the data.

    The limit holds at the averaging time `tau_s`, one that the estimator has; `limit`, in the unit of the points, is an
    upper one. The test lasts `duration_s` from the first sample, at least 2 tau. `error_probability` is the promised
    probability of a wrong PASS, and of a wrong FAIL, by the bounds: 0.01 or 0.05.

    `looks` are in 24ths of the duration: hours of a test of 24 h. The end is always one. Fewer looks use the same
    bounds, which can only lower the error. `windows_per_tau` is tau over the distance of neighbouring windows: 16 in
    `AllanDeviation` at one point per octave from tau = 16 sample intervals on, tau over the interval below that.

    If `point_decides` the finished test compares the point with the limit. If not, it judges the true deviation: a
        FAIL then always keeps the promised probability, and a test may end UNDECIDED.
    """

    tau_s: float
    limit: float
    duration_s: float
    error_probability: float = 0.01
    looks: tuple[int, ...] = tuple(range(1, LOOKS + 1))
    windows_per_tau: int = 16
    point_decides: bool = True

    def __post_init__(self) -> None:
        for name, number in (("tau_s", self.tau_s), ("limit", self.limit), ("duration_s", self.duration_s)):
            if not (math.isfinite(number) and number > 0.0):
                raise EstimatorError(f"early decision: {name} is {number}; a positive finite number is needed")
        if self.duration_s < 2.0 * self.tau_s:
            raise EstimatorError(
                f"early decision: a test of {self.duration_s:g} s holds no two averages of {self.tau_s:g} s; "
                "plan a longer one"
            )
        if self.error_probability not in PROMISES:
            raise EstimatorError(
                f"early decision: error probability {self.error_probability}; bounds exist for "
                + " and ".join(f"{promise:g}" for promise in PROMISES)
            )
        if not set(self.looks) <= set(range(1, LOOKS + 1)):
            raise EstimatorError(f"early decision: looks {self.looks}; they are 24ths of the duration, 1 to {LOOKS}")
        if self.windows_per_tau < 1:
            raise EstimatorError(f"early decision: {self.windows_per_tau} windows per tau; at least 1 is needed")

    def windows(self, elapsed_s: float) -> int:
        """Largest possible number of Allan windows after `elapsed_s`: gaps can only lower it."""
        stride_s = self.tau_s / self.windows_per_tau
        return max(0, math.floor((elapsed_s - 2.0 * self.tau_s) / stride_s * (1.0 + ROUNDING) + ROUNDING) + 1)

    def averages(self, elapsed_s: float) -> int:
        """Largest possible number of finished averages after `elapsed_s`."""
        return math.floor(elapsed_s / self.tau_s * (1.0 + ROUNDING))


@dataclass(frozen=True)
class Decision:
    """Result of a look.

    `reason_en` and `reason_zh` say why, for people. `error_probability` is the promised probability of a wrong decision
    per side, in the sense of `rule`; while undecided, that of an early PASS or FAIL. `looked_at_fraction` is the part
    of the planned duration that had passed, at most 1. `forecast_s` is the expected time of the decision, seconds from
    the start, if the rest of the test shows the present deviation, None if that is not before the end, or decided;
    `forecast_latest_s` is the same for the less favourable end of the estimate's interval.
    """

    outcome: Outcome
    reason_en: str
    reason_zh: str
    error_probability: float
    looked_at_fraction: float
    forecast_s: float | None = None
    forecast_latest_s: float | None = None
    rule: DecisionRule = DecisionRule.NONE
