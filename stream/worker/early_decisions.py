"""The early decisions on one signal: one for each limit of its run, updated whenever its estimates are published."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any, Self

import msgspec
import numpy as np

from stream.batch import SampleBatch
from stream.decoding import converted, decode_json
from stream.defects.stillness import Stillness, remark_on_stillness
from stream.errors import GyrofleetError
from stream.estimators.allan_variance import OVERLAP, AllanDeviation
from stream.estimators.base import NoEstimate, PointEstimator
from stream.estimators.bias_stability import BiasStability
from stream.estimators.block_means import BlockMeans
from stream.estimators.decision.decision import AllanDecision, BiasStabilityDecision, Decision, DecisionPlan, Outcome
from stream.estimators.snapshot import restore, take_snapshot
from stream.events import EarlyDecision, EstimatePoint, EstimatePublished, Limit, LimitsApplied
from stream.quantities import conversion
from stream.worker.limit_checks import ALLAN_DEVIATION, ANGLE_RANDOM_WALK, estimator_key, remark_on_lack
from stream.worker.recent_samples import RecentSamples

_SAME = 1e-6
_STEPS = OVERLAP
_EVEN = 6.0


def decision_document(head: dict[str, Any], limit: Limit, decision: Decision) -> EarlyDecision:
    """The run document of a look at a limit."""
    return EarlyDecision(
        **head, limit=limit, outcome=decision.outcome.value, rule=decision.rule.value,
        error_probability=None if decision.outcome is Outcome.UNDECIDED else decision.error_probability,
        looked_at_fraction=decision.looked_at_fraction, reason=decision.reason_en, reason_zh=decision.reason_zh,
        forecast_s=decision.forecast_s, forecast_latest_s=decision.forecast_latest_s,
    )  # fmt: skip


class _ExactTau:
    """The Allan deviation at one averaging time that is no octave, from means over a sixteenth of it."""

    def __init__(self, tau_s: float) -> None:
        self._means = BlockMeans(tau_s / _STEPS)
        self.allan = AllanDeviation()

    def update(self, batch: SampleBatch) -> None:
        means = self._means.push(batch)
        if means is not None:
            self.allan.update(means)

    def export_state(self) -> dict[str, Any]:
        return {"means": self._means.export_state(), "allan": take_snapshot(self.allan)}

    def import_state(self, state: dict[str, Any]) -> None:
        self._means.import_state(state["means"])
        allan = restore(state["allan"])
        assert isinstance(allan, AllanDeviation)
        self.allan = allan


class EarlyDecisions:
    """Early decisions on the limits that a run sets one signal.

    Limits on the Allan deviation and on the angle random walk (at 1 s) are decided at any averaging time of at least 96
    sample intervals, and at any multiple of 16, from means over a sixteenth of it; where such a mean is no whole number
    of samples, some have one sample more than others, which raises the deviation by less than 0.3 %. At shorter times
    they are decided if these are an octave of the interval. Limits on the bias stability are decided where it is
    estimated.

    Limits on one record of the run (`LimitsApplied.since_ns`) have `estimators` of their own, which see the samples of
    that record only, from `since_ns` on, also those that came a little before the limits. A record that is begun again
    replaces the one before it. Samples of the record that came too long before the limits are not judged: `unseen_s`.
    """

    def __init__(self, signal: str) -> None:
        self._signal = signal
        self._planned_s: float | None = None
        self._limits: tuple[Limit, ...] = ()
        self._tests: dict[int, AllanDecision | BiasStabilityDecision] = {}
        self._exact: dict[int, _ExactTau] = {}
        self._next: LimitsApplied | None = None
        self._recent = RecentSamples()
        self.since_ns: int | None = None
        self.unseen_s = 0.0
        self.still = Stillness()
        self.estimators: list[PointEstimator] = []

    def apply(self, limits: LimitsApplied) -> None:
        """Set limits with a planned duration: the first on the whole run, or those on a record from its start on."""
        if limits.planned_s is None:
            return
        if limits.since_ns is not None:
            self._next = limits if limits.since_ns != self.since_ns else None
            for batch in self._recent.since(limits.since_ns) if self._next else ():
                self._take(batch)
        elif self._planned_s is None:
            self._planned_s = limits.planned_s
            self._set(self._own(limits))

    def _own(self, limits: LimitsApplied) -> tuple[Limit, ...]:
        return tuple(limit for limit in limits.limits if limit.signal == self._signal)

    def _set(self, limits: tuple[Limit, ...], since_ns: int | None = None) -> None:
        self._limits, self.since_ns = limits, since_ns
        self._tests, self.still = {}, Stillness()
        self._exact = {i: _ExactTau(_tau_s(limit)) for i, limit in enumerate(limits) if _is_allan(limit)}
        of_record = {} if since_ns is None else {estimator_key(limit): limit for limit in limits}
        self.estimators = [
            AllanDeviation() if _is_allan(limit) else BiasStability(_tau_s(limit)) for limit in of_record.values()
        ]

    def update(self, batch: SampleBatch) -> None:
        """Take in the next batch of the signal."""
        self._take(batch)
        self._recent.add(batch)  # at last, since it lets go of the times that were derived

    def _take(self, batch: SampleBatch) -> None:
        for part in self._of_record(batch) if self._limits or self._next else ():
            for estimator in self.estimators:
                estimator.update(part)
            self._update_exact(part)
            if self._limits:
                self.still.follow(part.value_array)

    def _of_record(self, batch: SampleBatch) -> Iterator[SampleBatch]:
        """The samples of a batch that belong to the record that the limits are on."""
        following = self._next
        if following is not None and following.since_ns is not None and batch.last_ns >= following.since_ns:
            self._next, self._planned_s = None, following.planned_s
            self._set(self._own(following), following.since_ns)
            self.unseen_s = self._recent.unseen_s(following.since_ns)
        if self.since_ns is None:
            yield batch
            return
        assert self._planned_s is not None
        until_ns = self.since_ns + round(self._planned_s * 1e9)
        times_ns = batch.time_array
        inside = np.flatnonzero((times_ns >= self.since_ns) & (times_ns < until_ns))
        if len(inside):
            yield batch.part(int(inside[0]), int(inside[-1]) + 1)

    def _update_exact(self, batch: SampleBatch) -> None:
        for number, exact in list(self._exact.items()):
            samples = _tau_s(self._limits[number]) * 1e9 / _STEPS / batch.dt_ns
            # means of few samples, now one more and now one less, would have another deviation
            is_uneven = samples < 1.0 - _SAME or abs(samples - round(samples)) > _SAME * samples
            is_done = self.since_ns is None and self._decided(number) is not None
            if (samples < _EVEN and is_uneven) or is_done:
                del self._exact[number]  # an octave, not possible, or already decided
            else:
                exact.update(batch)

    def exact_points(self) -> tuple[EstimatePoint, ...]:
        """Allan deviation at the averaging times of limits on a record, where they are not interpolated."""
        found: list[EstimatePoint] = []
        for number, exact in self._exact.items() if self.since_ns is not None else ():
            points, tau_s = exact.allan.estimate(), _tau_s(self._limits[number])
            if not isinstance(points, NoEstimate):
                found += [each for each in points if abs(each.tau_s - tau_s) <= _SAME * tau_s]
        return tuple(found)

    def _decided(self, number: int) -> Decision | None:
        return self._tests[number].decision if number in self._tests else None

    @property
    def unseen(self) -> tuple[str, str] | None:
        """What of the record is not judged, in English and Chinese; None where all of it is."""
        if not self.unseen_s:
            return None
        assert self._planned_s is not None
        first, planned, share = f"{self.unseen_s:.4g} s", f"{self._planned_s:g} s", self.unseen_s / self._planned_s
        of_record = f"the first {first} of {planned} ({share:.2g} of the record)"
        return (
            f"{of_record} are not judged: the limits came later than that",
            f"记录的前{first}(共{planned},占{share:.2g})未参与判定:限值到达过晚",
        )

    def look(self, elapsed_s: float, estimates: Mapping[str, EstimatePublished]) -> list[tuple[Limit, Decision]]:
        """Compare the estimates after `elapsed_s`, by the key of their estimator, with each limit."""
        looks = [(limit, self._look(i, limit, elapsed_s, estimates)) for i, limit in enumerate(self._limits)]
        if self.unseen is None:
            return looks
        en, zh = self.unseen
        return [
            (limit, replace(look, reason_en=f"{look.reason_en}; {en}", reason_zh=f"{look.reason_zh};{zh}"))
            for limit, look in looks
        ]

    def _look(
        self, number: int, limit: Limit, elapsed_s: float, estimates: Mapping[str, EstimatePublished]
    ) -> Decision:
        decided = self._decided(number)
        if decided is not None:
            return decided
        tau_s, key = _tau_s(limit), estimator_key(limit)
        estimate = estimates.get(key)
        if estimate is None:
            return _cannot(f"{key} is not estimated while the signal flows", f"运行中不估计 {key}")
        points = estimate.points
        if (exact := self._exact.get(number)) is not None:
            found = exact.allan.estimate()
            points = () if isinstance(found, NoEstimate) else found
        point = next((each for each in points if abs(each.tau_s - tau_s) <= _SAME * tau_s), None)
        try:
            if point is None and points and points[-1].tau_s > tau_s:
                below, above = [p for p in points if p.tau_s < tau_s], [p for p in points if p.tau_s > tau_s]
                near = ", ".join(f"{each.tau_s:g} s" for each in below[-1:] + above[:1])
                return _cannot(
                    f"the estimator has no averaging time of {tau_s:g} s, but {near}; judged at the end",
                    f"估计器没有 {tau_s:g} s 的平均时间(有 {near});结束时判定",
                )
            if number not in self._tests:
                if not estimate.unit_of_measure:
                    return _cannot("no sample yet", "尚无样本")
                self._begin(number, self._plan(number, limit, estimate))
            self._tests[number].doubt = self._doubt(elapsed_s, estimate.sample_interval_s)
            return self._tests[number].look(elapsed_s, point)
        except GyrofleetError as error:
            return _cannot(str(error), str(error))

    def _doubt(self, elapsed_s: float, sample_interval_s: float) -> tuple[str, str] | None:
        """Why no limit must pass now."""
        still = remark_on_stillness(self.still.longest, self.still.samples)
        if still is not None or self._planned_s is None or elapsed_s < self._planned_s:
            return still
        return remark_on_lack(self.still.samples * sample_interval_s, self._planned_s)

    def _begin(self, number: int, plan: DecisionPlan) -> None:
        is_allan = _is_allan(self._limits[number])
        self._tests[number] = AllanDecision(plan) if is_allan else BiasStabilityDecision(plan)

    def _plan(self, number: int, limit: Limit, estimate: EstimatePublished) -> DecisionPlan:
        assert self._planned_s is not None
        if limit.characteristic == ANGLE_RANDOM_WALK:
            # Allan deviation at 1 s in deg/h is 60 times the angle random walk in deg/sqrt(h)
            factor, offset = conversion(limit.unit_of_measure, "deg/sqrt(h)")[0] * 60.0, 0.0
        else:
            factor, offset = conversion(limit.unit_of_measure, estimate.unit_of_measure)
        lag = _STEPS if number in self._exact else round(_tau_s(limit) / estimate.sample_interval_s)
        limit_value = limit.upper * factor + offset
        return DecisionPlan(_tau_s(limit), limit_value, self._planned_s, windows_per_tau=max(1, lag))

    def export_state(self) -> dict[str, Any]:
        """The state, in plain values."""
        tests = {str(n): {"plan": asdict(test.plan), "state": test.export_state()} for n, test in self._tests.items()}
        return {
            "planned_s": self._planned_s, "limits": [msgspec.to_builtins(limit) for limit in self._limits],
            "tests": tests, "exactly": {str(number): exact.export_state() for number, exact in self._exact.items()},
            "since_ns": self.since_ns, "estimators": [take_snapshot(estimator) for estimator in self.estimators],
            "next": None if self._next is None else msgspec.json.encode(self._next),
            "recent": self._recent.export_state(), "unseen_s": self.unseen_s, "still": self.still.export_state(),
        }  # fmt: skip

    @classmethod
    def from_state(cls, signal: str, state: dict[str, Any]) -> Self:
        """Resume from the state of another one."""
        decisions = cls(signal)
        decisions._planned_s = state["planned_s"]
        decisions._set(tuple(converted(limit, Limit) for limit in state["limits"]), state.get("since_ns"))
        restored = [restore(snapshot) for snapshot in state.get("estimators", ())]
        decisions.estimators = [each for each in restored if each.has_points]
        following = state.get("next")
        decisions._next = None if following is None else decode_json(following, LimitsApplied)
        decisions._recent.import_state(state.get("recent", ()))
        decisions.unseen_s = state.get("unseen_s", 0.0)
        decisions.still.import_state(state.get("still", [0, 0, 0, 0.0]))
        for number, saved in state["tests"].items():
            decisions._begin(int(number), converted(saved["plan"], DecisionPlan))
            decisions._tests[int(number)].import_state(saved["state"])
        decisions._exact = {int(n): decisions._exact[int(n)] for n in state["exactly"]}
        for number, saved in state["exactly"].items():
            decisions._exact[int(number)].import_state(saved)
        return decisions


def _is_allan(limit: Limit) -> bool:
    return limit.characteristic in {ALLAN_DEVIATION, ANGLE_RANDOM_WALK}


def _tau_s(limit: Limit) -> float:
    return 1.0 if limit.characteristic == ANGLE_RANDOM_WALK or limit.tau_s is None else limit.tau_s


def _cannot(en: str, zh: str) -> Decision:
    return Decision(Outcome.UNDECIDED, f"no early decision: {en}", f"不能提前判定:{zh}", 0.0, 0.0)
