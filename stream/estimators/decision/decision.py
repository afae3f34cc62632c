"""Early decision of a screening test against an upper limit, while the data flow.

An ordinary interval looked at again and again decides wrongly in 10 to 26 % of runs at a nominal 1 %. Two rules do not:

Curtailment (Alling 1963). A sum of squares can only grow. Once it exceeds what the finished test allows, the finished
test must fail, whatever comes, whatever the noise.

Group-sequential bounds (Pocock 1977; alpha spending, Lan and DeMets 1983). At a few planned looks the estimate is
compared with bounds so wide that all looks together err with the promised probability (`decision_bounds`).

The only input is the `EstimatePoint` of an estimator at one tau. Of an Allan deviation with n windows the sum of
squares is S = 2 n value**2; of a standard deviation of n averages it is M2 = (n - 1) value**2.
"""

import math
from collections.abc import Callable
from typing import Any

import msgspec

from stream.decoding import converted
from stream.errors import EstimatorError
from stream.estimators.confidence import least_edf
from stream.estimators.decision.decision_bounds import LOOKS, Bounds, bounds
from stream.estimators.decision.decision_plan import ROUNDING, Decision, DecisionPlan, DecisionRule, Outcome
from stream.events import EstimatePoint

__all__ = ["AllanDecision", "BiasStabilityDecision", "Decision", "DecisionPlan", "DecisionRule", "Outcome"]

_SAME_TAU = 1e-6


class _Looks:
    """Base of both kinds of decision. State: time and count of the last look, and the decision once given.

    While there is a `doubt` nothing passes.
    """

    def __init__(self, plan: DecisionPlan) -> None:
        self.plan = plan
        self.decision: Decision | None = None
        self.doubt: tuple[str, str] | None = None  # why it must not pass now, in English and Chinese
        self._elapsed_s = 0.0
        self._last_n = 0

    def export_state(self) -> dict[str, Any]:
        """The state between looks, in plain values."""
        state = {name: value for name, value in vars(self).items() if name in {"_elapsed_s", "_last_n", "_used"}}
        return {**state, "decision": msgspec.to_builtins(self.decision)}

    def import_state(self, state: dict[str, Any]) -> None:
        """Take over the state of another one of the same plan."""
        vars(self).update(state, decision=converted(state["decision"], Decision | None))

    def _enter(self, elapsed_s: float, point: EstimatePoint | None, most: Callable[[float], int]) -> None:
        plan = self.plan
        if elapsed_s < self._elapsed_s:
            raise EstimatorError(
                f"early decision: a look at {elapsed_s:g} s after one at {self._elapsed_s:g} s; looks go forwards"
            )
        self._elapsed_s = elapsed_s
        if point is None:
            return
        if abs(point.tau_s - plan.tau_s) > _SAME_TAU * plan.tau_s:
            raise EstimatorError(
                f"early decision: the plan is for {plan.tau_s:g} s, the point is of {point.tau_s:g} s; "
                "plan for an averaging time that the estimator has"
            )
        possible = most(elapsed_s + plan.tau_s)
        if not self._last_n <= point.n <= possible:
            raise EstimatorError(
                f"early decision: n = {point.n} after {elapsed_s:g} s is not between that of the look before, "
                f"{self._last_n}, and {possible}, the most the plan allows; check elapsed_s and windows_per_tau"
            )
        self._last_n = point.n

    def _decide(self, outcome: Outcome, rule: DecisionRule, promise: float, en: str, zh: str) -> Decision:
        fraction = min(1.0, self._elapsed_s / self.plan.duration_s)
        if outcome is Outcome.PASS and self.doubt is not None:
            return self._doubtful(promise, self.doubt)
        self.decision = Decision(outcome, en, zh, promise, fraction, rule=rule)
        return self.decision

    def _doubtful(self, promise: float, doubt: tuple[str, str]) -> Decision:
        fraction = min(1.0, self._elapsed_s / self.plan.duration_s)
        return Decision(Outcome.UNDECIDED, f"undecided; {doubt[0]}", f"未判定;{doubt[1]}", promise, fraction)

    def _finish(self, point: EstimatePoint) -> Decision:
        """Compare the point with the limit, as the finished test does."""
        limit = self.plan.limit
        outcome, sign, word = (Outcome.FAIL, ">", "高于") if point.value > limit else (Outcome.PASS, "<=", "不高于")
        return self._decide(
            outcome, DecisionRule.FINISHED, 0.0, f"the test is finished: {point.value:.4g} {sign} limit {limit:.4g}",
            f"测试已完成:{point.value:.4g} {word}限值 {limit:.4g}",
        )  # fmt: skip

    def _curtail(self, sum_share: float) -> Decision:
        exact, promise = self.plan.point_decides, self.plan.error_probability
        must_en = "the finished test must fail" if exact else "without gaps the last look must cross the FAIL bound"
        must_zh = "完整测试必不合格" if exact else "若无缺失,末次查看必越过 FAIL 界限"
        return self._decide(
            Outcome.FAIL, DecisionRule.CURTAILED, 0.0 if exact else promise,
            f"the sum of squares is {sum_share:.4g} times what the finished test allows and can only grow: {must_en}",
            f"平方和已达完整测试允许值的 {sum_share:.4g} 倍,且只增不减:{must_zh}",
        )  # fmt: skip

    def _undecided(self, promise: float, point: EstimatePoint | None, expect: Callable[[float], float]) -> Decision:
        fraction = min(1.0, self._elapsed_s / self.plan.duration_s)
        if self.doubt is not None:
            return self._doubtful(promise, self.doubt)
        if point is None:
            en, zh = "no estimate at this averaging time yet", "该平均时间尚无估计值"
            return Decision(Outcome.UNDECIDED, en, zh, promise, fraction)
        likely = expect(point.value)
        # both ends of an interval around the limit may be decided early, with opposite outcomes
        is_open = point.lo <= self.plan.limit <= point.hi
        latest = math.inf if is_open else max(likely, expect(point.lo), expect(point.hi))
        first = likely if math.isfinite(likely) else None
        last = latest if math.isfinite(latest) else None
        if first is None:
            en, zh = "not before the end by the present estimate", "按当前估计,结束前不会有结论"
        else:
            end_en = f"{last:.0f} s" if last is not None else "the end"
            end_zh = f"{last:.0f} s" if last is not None else "测试结束"
            en = f"expected at {first:.0f} s by the present estimate, by its interval as late as {end_en}"
            zh = f"按当前估计预计在 {first:.0f} s 判定,按其区间最迟到{end_zh}"
        return Decision(Outcome.UNDECIDED, f"undecided; {en}", f"未判定;{zh}", promise, fraction, first, last)


class AllanDecision(_Looks):
    """Early decision on the Allan deviation at one tau.

    Notes
    -----
    Curtailment: with S_n = sum D**2 = 2 n value**2 and C the largest possible number of windows in the finished test,
    value_final**2 = S_final/(2 C_final) >= S_n/(2 C), hence FAIL once S_n > 2 L**2 C. Gaps only lower C_final. Without
    `point_decides` L**2 is multiplied by the last FAIL bound: the last look must then cross it.

    Bounds: (value/L)**2 at the first look after each planned time. A look counts as look k only if n has reached the
    number of windows that k/24 of the test has without gaps; each is used once. A look later than planned, or after
    losses, is compared with the bound of the planned time, which is wider. Looks in between can only curtail.

    Examples
    --------
    >>> test = AllanDecision(DecisionPlan(tau_s=100.0, limit=1.0, duration_s=86400.0))
    >>> point = EstimatePoint(tau_s=100.0, value=0.5, lo=0.42, hi=0.62, edf=50.0, n=1121)
    >>> decision = test.look(7200.0, point)
    >>> decision.outcome.value, decision.rule.value, decision.error_probability, decision.reason_en
    ('PASS', 'bounds', 0.01, 'look 2 of 24: 0.5 is at or below the PASS bound 0.6806 (limit 1)')
    """

    def __init__(self, plan: DecisionPlan) -> None:
        super().__init__(plan)
        self._windows = plan.windows(plan.duration_s)
        stride = plan.windows_per_tau
        self._bounds: Bounds = bounds(least_edf(stride, self._windows, stride), plan.error_probability)
        self._allowed = 1.0 if plan.point_decides else self._bounds.fails[-1]
        self._looks = tuple((k, plan.windows(plan.duration_s * k / LOOKS)) for k in sorted({*plan.looks, LOOKS}))
        self._used = 0

    def look(self, elapsed_s: float, point: EstimatePoint | None) -> Decision:
        """Look at the test; a decision once given stands.

        `elapsed_s` is the time since the first sample, gaps included, seconds; an EstimatorError if it, or n, runs
        backwards. `point` is the estimate at the plan's tau; None if there is none.
        """
        if self.decision is not None:
            return self.decision
        plan = self.plan
        self._enter(elapsed_s, point, plan.windows)
        if point is None:
            return self._undecided(plan.error_probability, point, lambda _: math.inf)
        ratio = (point.value / plan.limit) ** 2
        crossed = self._cross(elapsed_s, point, ratio)
        if crossed is not None:
            return crossed
        share = ratio * point.n / (self._windows * self._allowed)
        if elapsed_s < plan.duration_s and share > 1.0 + ROUNDING:
            return self._curtail(share)
        if elapsed_s >= plan.duration_s:
            if plan.point_decides:
                return self._finish(point)
            en = f"the test is finished and does not tell {point.value:.4g} from limit {plan.limit:.4g}"
            zh = f"测试已完成,无法区分 {point.value:.4g} 与限值 {plan.limit:.4g}"
            return self._decide(Outcome.UNDECIDED, DecisionRule.FINISHED, plan.error_probability, en, zh)
        return self._undecided(plan.error_probability, point, lambda value: self._expected_s(ratio, point.n, value))

    def _cross(self, elapsed_s: float, point: EstimatePoint, ratio: float) -> Decision | None:
        plan = self.plan
        due = [k for k, n in self._looks if plan.duration_s * k / LOOKS <= elapsed_s * (1 + ROUNDING) and n <= point.n]
        if not due or due[-1] <= self._used or point.n == 0:
            return None
        self._used = k = due[-1]
        upper, lower = self._bounds.fails[k - 1], self._bounds.passes[k - 1]
        where_en, where_zh = f"look {k} of {LOOKS}: {point.value:.4g}", f"第 {k}/{LOOKS} 次查看:{point.value:.4g}"
        for outcome, hit, bound, side_en, side_zh in (
            (Outcome.FAIL, ratio >= upper, upper, "above", "高于"),
            (Outcome.PASS, 0.0 < lower >= ratio, lower, "below", "低于"),
        ):
            if hit:
                at, limit = f"{math.sqrt(bound) * plan.limit:.4g}", f"{plan.limit:.4g}"
                en = f"{where_en} is at or {side_en} the {outcome} bound {at} (limit {limit})"
                zh = f"{where_zh} 等于或{side_zh} {outcome} 界限 {at}(限值 {limit})"
                return self._decide(outcome, DecisionRule.BOUNDS, plan.error_probability, en, zh)
        return None

    def _expected_s(self, ratio: float, n: int, value: float) -> float:
        """When the test is decided if all further squares average 2 value**2; infinite if not before the end."""
        plan = self.plan
        future = (value / plan.limit) ** 2
        missing = self._windows * self._allowed - ratio * n
        curtailed_n = n + missing / future if future > 0.0 else math.inf
        at_s = plan.tau_s * (2.0 + curtailed_n / plan.windows_per_tau)
        expected = at_s if at_s < plan.duration_s else math.inf
        for k, windows in self._looks:
            if k <= self._used or k == LOOKS or windows <= n:
                continue
            then = (ratio * n + future * (windows - n)) / windows
            if then >= self._bounds.fails[k - 1] or then <= self._bounds.passes[k - 1]:
                return min(expected, plan.duration_s * k / LOOKS)
        return expected


class BiasStabilityDecision(_Looks):
    """Early FAIL of bias stability, the standard deviation of averages; it never passes before the end.

    Notes
    -----
    Of the plan, error probability, looks and windows per tau are not used.
    By Welford's recurrence M2_(n+1) = M2_n + (n/(n+1)) (F_(n+1) - mean_n)**2: M2 only grows. With N the largest
    possible number of averages in the test, and n_final <= N of them not lost to gaps,

        B_final**2 = M2_final/(n_final - 1) >= M2_n/(N - 1),

    hence the finished test must fail once M2_n > L**2 (N - 1). A PASS has no such rule: a later drift can raise the
    deviation without bound, and a sequential test that assumes white averages passed 61 % of drifting units wrongly.

    Examples
    --------
    >>> test = BiasStabilityDecision(DecisionPlan(tau_s=10.0, limit=1.0, duration_s=86400.0))
    >>> point = EstimatePoint(tau_s=10.0, value=2.0, lo=1.95, hi=2.05, edf=2200.0, n=2200)
    >>> test.look(22000.0, point).reason_en
    'the sum of squares is 1.018 times what the finished test allows and can only grow: the finished test must fail'
    """

    def look(self, elapsed_s: float, point: EstimatePoint | None) -> Decision:
        """Look at the test, any number of times; see `AllanDecision.look`."""
        if self.decision is not None:
            return self.decision
        plan = self.plan
        self._enter(elapsed_s, point, plan.averages)
        if point is None:
            return self._undecided(0.0, point, lambda _: math.inf)
        if elapsed_s >= plan.duration_s:
            return self._finish(point)
        most = plan.averages(plan.duration_s)
        squares = (point.value / plan.limit) ** 2 * (point.n - 1)
        if squares > (most - 1) * (1.0 + ROUNDING):
            return self._curtail(squares / (most - 1))
        return self._undecided(0.0, point, lambda value: self._expected_s(squares, point.n, most, value))

    def _expected_s(self, squares: float, n: int, most: int, value: float) -> float:
        """When further averages with a standard deviation of `value` exceed what is allowed."""
        future = (value / self.plan.limit) ** 2
        at_n = n + (most - 1 - squares) / future if future > 0.0 else math.inf
        return at_n * self.plan.tau_s if at_n < most else math.inf
