"""What speaks for a finding and what could be meant instead, as sentences."""

from analytics.loop.effects.registry import effect
from analytics.loop.effects.turn_on import TURN_ON
from analytics.loop.report.wording import Wording, number
from analytics.loop.tracing.fleet import FleetDiagnosis
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.tracing.result.finding import ConfoundedEffect, FoundEffect
from analytics.loop.tracing.result.holdout import HeldOutAnswer

WRONG_FORM = 1e-4
_ANSWERS = {
    HeldOutAnswer.CONFIRMED: ("confirmed", "予以证实"),
    HeldOutAnswer.REFUSED: ("refused", "予以否定"),
    HeldOutAnswer.NO_POWER: ("these runs do not excite it and cannot tell", "这些试验未激励该效应，无法判别"),
}


def evidence(found: FoundEffect, diagnosis: Diagnosis | FleetDiagnosis, words: Wording) -> list[str]:
    """Sentences that say how sure a finding is."""
    told = [
        words.of(
            f"Significance z = {found.significance:.1f} as one test of one degree of freedom, with the noise fitted "
            f"with and without it; after the multiplicity penalty {number(found.evidence)} of chi-square are left.",
            f"显著性z = {found.significance:.1f}（单自由度等效，噪声在有无该效应时分别重拟合）；扣除搜索代价后余卡方"
            f"{number(found.evidence)}。",
        )
    ]
    if found.by_run and found.name != TURN_ON:
        told.append(_by_run(found, diagnosis, words))
    slopes = () if diagnosis.holdout is None else diagnosis.holdout.effects
    for each in slopes:
        if each.effect == found.name:
            said = words.of(*_ANSWERS[each.answer])
            slope = f"{each.slope:.3f} ± {each.slope_se:.3f}"
            told.append(
                words.of(
                    f"Held out, with frozen coefficients: slope {slope} of the residual "
                    f"on the prediction (1 if right): {said}.",
                    f"留出数据、系数冻结：残差对预测的斜率为{slope}（正确时为1）：{said}。",
                )
            )
    if found.companions:
        names = words.listed([words.name(name) for name in found.companions])
        told.append(words.of(f"Proxies that follow it: {names}.", f"随其变化的代理量：{names}。"))
    if found.unknown_function_of:
        channels = words.listed(list(found.unknown_function_of))
        told.append(
            words.of(
                f"Its form does not fit: the residual depends on {channels} in another way.",
                f"其形式不符：残差以其他方式随{channels}变化。",
            )
        )
    return told


def _by_run(found: FoundEffect, diagnosis: Diagnosis | FleetDiagnosis, words: Wording) -> str:
    p_value = found.heterogeneity_p_value
    same = p_value >= WRONG_FORM
    is_within = isinstance(diagnosis, Diagnosis) and diagnosis.replication == "within_run"
    where = words.of("segments", "段") if is_within else words.of("runs", "次试验")
    agree = words.of("agree", "一致") if same else words.of("do not agree", "不一致")
    share = words.of(
        f"; the best one gives {found.largest_share:.0%} of what it predicts in those left out",
        f"；对被留一者的预测增益中，最大者占{found.largest_share:.0%}",
    )
    return words.of(
        f"Its coefficients in {len(found.by_run)} {where} {agree} (p = {number(p_value)}){share}.",
        f"其在{len(found.by_run)}{where}中的系数{agree}（p = {number(p_value)}）{share}。",
    )


def alternative(other: ConfoundedEffect, words: Wording) -> str:
    """Say what else could be meant, how far behind it is, and what it would take."""
    if not other.recorded:
        return f"{words.effect(other)}: {words.of('not recorded', '未记录')}"
    if other.evidence_behind is None:
        behind = words.of(
            "it is followed by the proxy that was found, which explains more than its channel does",
            "所发现的代理量随其变化，但代理量的解释力强于该通道",
        )
    elif abs(other.evidence_behind) < 0.05:
        behind = words.of("exactly as likely", "可能性相同")
    else:
        behind = words.of(f"{other.evidence_behind:.1f} of chi-square behind", f"证据少卡方{other.evidence_behind:.1f}")
    if other.implied is None or other.most is None:
        return f"{words.effect(other)}: {behind}"
    needed, most = f"{number(other.implied)} {other.implied_unit}", f"{number(other.most)} {other.implied_unit}"
    if other.is_plausible:
        took = words.of(f"it would take {needed} at least", f"至少须有{needed}")
        return f"{words.effect(other)}: {behind}{words.of('; ', '；')}{took}"
    took = words.of(
        f"it would take {needed} at least, and clocks are off by {most} at most: hardly",
        f"至少须有{needed}，而时钟偏差至多{most}：不大可能",
    )
    return f"{words.effect(other)}: {took}"


def separating_test(found: FoundEffect | ConfoundedEffect, words: Wording) -> str:
    """The measurement that tells an effect from its like."""
    known = effect(found.name)
    return words.of(known.separating_test, known.separating_test_zh)
