"""The early decisions on one signal: one for each limit of its run, looked at whenever its estimates are published."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import msgspec

from stream.errors import GyrofleetError
from stream.estimators.decision import AllanDecision, BiasStabilityDecision, Decision, DecisionPlan, Outcome
from stream.events import EarlyDecision, EstimatePoint, EstimatePublished, Limit, LimitsApplied
from stream.quantities import conversion

ALLAN_DEVIATION, BIAS_STABILITY = "allan_deviation", "bias_stability"
_SAME_TAU = 1e-6
_STRIDES = 32


class DecisionLook(NamedTuple):
    """What a look at one limit found."""

    limit: Limit
    decision: Decision

    def document(self, head: dict[str, Any]) -> EarlyDecision:
        """Return it as a run document with that head."""
        decision = self.decision
        return EarlyDecision(
            **head,
            limit=self.limit,
            outcome=decision.outcome.value,
            rule=decision.rule.value,
            error_probability=decision.error_probability,
            looked_at_fraction=decision.looked_at_fraction,
            reason=decision.reason_en,
            reason_zh=decision.reason_zh,
            forecast_s=decision.forecast_s,
            forecast_latest_s=decision.forecast_latest_s,
        )


class EarlyDecisions:
    """Early decisions on the limits that a run sets one signal.

    Limits on the Allan deviation are decided where the estimator has their averaging time, those on the bias stability
    where it is estimated; an angle random walk is judged at the end.

    Parameters
    ----------
    signal : str
        Which signal.
    """

    def __init__(self, signal: str) -> None:
        self._signal = signal
        self._planned_s: float | None = None
        self._limits: tuple[Limit, ...] = ()
        self._tests: dict[int, AllanDecision | BiasStabilityDecision] = {}
        self._saved: dict[str, Any] = {}

    def apply(self, limits: LimitsApplied) -> None:
        """Take the limits of the run; they do nothing without its planned duration. The first ones stand."""
        if limits.planned_s is None or self._planned_s is not None:
            return
        self._planned_s = limits.planned_s
        self._limits = tuple(
            limit
            for limit in limits.limits
            if limit.signal == self._signal and limit.characteristic in {ALLAN_DEVIATION, BIAS_STABILITY}
        )

    def look(self, elapsed_s: float, estimates: Mapping[str, EstimatePublished]) -> list[DecisionLook]:
        """Hold the estimates after `elapsed_s` against each limit; estimates by the key of their estimator."""
        return [
            DecisionLook(limit, self._look(number, limit, elapsed_s, estimates))
            for number, limit in enumerate(self._limits)
        ]

    def _look(
        self, number: int, limit: Limit, elapsed_s: float, estimates: Mapping[str, EstimatePublished]
    ) -> Decision:
        is_allan = limit.characteristic == ALLAN_DEVIATION
        key = ALLAN_DEVIATION if is_allan else f"{BIAS_STABILITY}_{limit.tau_s:g}s"
        estimate = estimates.get(key)
        tau_s = limit.tau_s or 0.0
        if estimate is None:
            return _cannot(f"{key} is not estimated while the signal flows", f"运行中不估计 {key}")
        point = next((each for each in estimate.points if abs(each.tau_s - tau_s) <= _SAME_TAU * tau_s), None)
        try:
            if number not in self._tests:
                if estimate.points and point is None and estimate.points[-1].tau_s > tau_s:
                    near = ", ".join(f"{each.tau_s:g} s" for each in _around(estimate.points, tau_s))
                    return _cannot(
                        f"the estimator has no averaging time of {tau_s:g} s, but {near}; judged at the end",
                        f"估计器没有 {tau_s:g} s 的平均时间(有 {near});结束时判定",
                    )
                if not estimate.sample_interval_s:
                    return _cannot("no sample yet", "尚无样本")
                self._tests[number] = self._begin(number, limit, estimate)
            return self._tests[number].look(elapsed_s, point)
        except GyrofleetError as error:
            return _cannot(str(error), str(error))

    def _begin(self, number: int, limit: Limit, estimate: EstimatePublished) -> AllanDecision | BiasStabilityDecision:
        assert limit.tau_s is not None
        assert self._planned_s is not None
        factor, offset = conversion(limit.unit_of_measure, estimate.unit_of_measure)
        windows_per_tau = round(limit.tau_s / estimate.sample_interval_s)
        while windows_per_tau >= _STRIDES:
            windows_per_tau //= 2
        plan = DecisionPlan(
            tau_s=limit.tau_s,
            limit=limit.upper * factor + offset,
            duration_s=self._planned_s,
            windows_per_tau=max(1, windows_per_tau),
        )
        test = AllanDecision(plan) if limit.characteristic == ALLAN_DEVIATION else BiasStabilityDecision(plan)
        if str(number) in self._saved:
            test.import_state(self._saved[str(number)])
        return test

    def export_state(self) -> dict[str, Any]:
        """Everything that is kept, in plain values."""
        tests = {str(number): test.export_state() for number, test in self._tests.items()}
        return {
            "planned_s": self._planned_s,
            "limits": [msgspec.to_builtins(limit) for limit in self._limits],
            "tests": {**self._saved, **tests},
        }

    @classmethod
    def from_state(cls, signal: str, state: dict[str, Any]) -> "EarlyDecisions":
        """Go on from what another one has exported."""
        decisions = cls(signal)
        decisions._planned_s = state["planned_s"]
        decisions._limits = tuple(msgspec.convert(limit, Limit) for limit in state["limits"])
        decisions._saved = state["tests"]
        return decisions


def _around(points: tuple[EstimatePoint, ...], tau_s: float) -> list[EstimatePoint]:
    below = [point for point in points if point.tau_s < tau_s][-1:]
    return below + [point for point in points if point.tau_s > tau_s][:1]


def _cannot(en: str, zh: str) -> Decision:
    return Decision(Outcome.UNDECIDED, f"no early decision: {en}", f"不能提前判定:{zh}", 0.0, 0.0)
