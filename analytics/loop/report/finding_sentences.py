"""The evidence of a finding and its alternatives, as sentences."""

from analytics.loop.effects.registry import effect
from analytics.loop.effects.turn_on import TURN_ON
from analytics.loop.report.wording import Wording, number
from analytics.loop.tracing.fleet import FleetDiagnosis
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.tracing.result.finding import ConfoundedEffect, FoundEffect
from analytics.loop.tracing.result.holdout import HeldOutAnswer
from analytics.loop.tracing.verdict.adequacy import WRONG_FORM

_ANSWERS = {
    HeldOutAnswer.CONFIRMED: ("confirmed", "予以证实"),
    HeldOutAnswer.REFUSED: ("refused", "予以否定"),
    HeldOutAnswer.NO_POWER: ("these runs do not excite it and cannot tell", "这些试验未激励该效应，无法判别"),
}


def evidence(found: FoundEffect, diagnosis: Diagnosis | FleetDiagnosis, words: Wording) -> list[str]:
    """The evidence of a finding."""
    left = number(found.evidence)
    texts = [
        words.of(
            f"Significance z = {found.significance:.1f} (one degree of freedom; noise fitted with and without the "
            f"effect); chi-square less the multiplicity penalty: {left}.",
            f"显著性z = {found.significance:.1f}（单自由度等效，噪声在有无该效应时分别拟合）；"
            f"扣除多重性惩罚后的卡方：{left}。",
        )
    ]
    if found.by_run and found.name != TURN_ON:
        texts.append(_by_run(found, diagnosis, words))
    slope = None if diagnosis.holdout is None else diagnosis.holdout.slope(found.name)
    if slope is not None:
        value, answer = f"{slope.slope:.3f} ± {slope.slope_se:.3f}", words.of(*_ANSWERS[slope.answer])
        texts.append(
            words.of(
                f"Held-out runs, coefficients frozen: slope {value} of the residual on the prediction (1 if right): "
                f"{answer}.",
                f"留出数据、系数冻结：残差对预测的斜率为{value}（正确时为1）：{answer}。",
            )
        )
    if found.error_share is not None:
        share = f"{found.error_share:.1%}"
        texts.append(words.of(f"It explains {share} of the squared error.", f"它解释误差平方的{share}。"))
    if found.companions:
        names = words.listed([words.name(name) for name in found.companions])
        texts.append(words.of(f"Proxies that follow it: {names}.", f"随其变化的代理量：{names}。"))
    if found.unknown_function_of:
        channels = words.listed(found.unknown_function_of)
        texts.append(
            words.of(
                f"Its form does not fit: the residual depends on {channels} in another way.",
                f"其形式不符：残差以其他方式随{channels}变化。",
            )
        )
    return texts


def _by_run(found: FoundEffect, diagnosis: Diagnosis | FleetDiagnosis, words: Wording) -> str:
    is_within = isinstance(diagnosis, Diagnosis) and diagnosis.replication == "within_run"
    where = words.of("segments", "段") if is_within else words.of("runs", "次试验")
    is_same = found.heterogeneity_p_value >= WRONG_FORM
    agree = words.of("agree", "一致") if is_same else words.of("do not agree", "不一致")
    count, p_value, share = len(found.by_run), number(found.heterogeneity_p_value), f"{found.largest_share:.0%}"
    return words.of(
        f"Its coefficients in {count} {where} {agree} (p = {p_value}); the best one contributes {share} of the "
        "leave-one-out gain.",
        f"其在{count}{where}中的系数{agree}（p = {p_value}）；留一法增益中最大者占{share}。",
    )


def alternative(other: ConfoundedEffect, words: Wording) -> str:
    """An alternative, its evidence relative to the finding, and the size that it would need."""
    name = words.effect(other)
    if not other.recorded:
        return f"{name}: {words.of('not recorded', '未记录')}"
    if other.evidence_behind is None:
        behind = words.of(
            "the proxy that was found follows it, but explains more than its channel",
            "所发现的代理量随其变化，但代理量的解释力强于该通道",
        )
    elif abs(other.evidence_behind) < 0.05:
        behind = words.of("equally likely", "可能性相同")
    else:
        size = f"{other.evidence_behind:.1f}"
        behind = words.of(f"chi-square lower by {size}", f"卡方少{size}")
    if other.implied is None or other.most is None:
        return f"{name}: {behind}"
    needed, most = (f"{number(each)} {other.implied_unit}" for each in (other.implied, other.most))
    if other.is_plausible:
        return f"{name}: {behind}{words.of(f'; it would need at least {needed}', f'；至少须有{needed}')}"
    return f"{name}: " + words.of(
        f"it would need at least {needed}, but clocks are off by {most} at most: unlikely",
        f"至少须有{needed}，而时钟偏差至多{most}：不大可能",
    )


def separating_test(found: FoundEffect | ConfoundedEffect, words: Wording) -> str:
    """The measurement that separates an effect from similar ones."""
    known = effect(found.name)
    return words.of(known.separating_test, known.separating_test_zh)
