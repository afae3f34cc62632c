"""What speaks for a finding and what could be meant instead, as sentences."""

from analytics.effects.registry import effect
from analytics.error_model import ErrorModel
from analytics.report.wording import Wording, number
from analytics.tracing.fleet import FleetDiagnosis
from analytics.tracing.result import ConfoundedEffect, Diagnosis, FoundEffect

WRONG_FORM = 1e-4
_CLOCKS = {
    "temperature_time_offset": ("temperature_rate", "temperature"),
    "rate_time_offset": ("angular_acceleration", "scale_factor"),
}
"""Errors of a clock, the effect with the same regressor, and the declared term whose coefficient tells the offset."""


def evidence(found: FoundEffect, diagnosis: Diagnosis | FleetDiagnosis, words: Wording) -> list[str]:
    """Sentences that say how sure a finding is."""
    told = [
        words.of(
            f"Significance z = {found.significance:.1f} as one test of one degree of freedom, with the noise fitted "
            f"anew with and without it; after the price of the search {number(found.evidence)} of chi-square are left.",
            f"显著性z = {found.significance:.1f}（单自由度等效，噪声在有无该效应时分别重拟合）；扣除搜索代价后余卡方"
            f"{number(found.evidence)}。",
        )
    ]
    if found.by_run:
        told.append(_by_run(found, diagnosis, words))
    slopes = () if diagnosis.holdout is None else diagnosis.holdout.effects
    for each in slopes:
        if each.effect == found.name:
            said = words.of("confirmed", "予以证实") if each.accepted else words.of("not confirmed", "未予证实")
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


def alternative(
    other: ConfoundedEffect, beside: FoundEffect, diagnosis: Diagnosis | FleetDiagnosis, words: Wording
) -> str:
    """Say what else could be meant, how far behind it is, and what it would take."""
    behind = words.of(f"{other.evidence_behind:.1f} of chi-square behind", f"证据少卡方{other.evidence_behind:.1f}")
    if abs(other.evidence_behind) < 0.05:
        behind = words.of("exactly as likely", "可能性相同")
    offset_s = implied_offset_s(other.name, beside, diagnosis.declared if isinstance(diagnosis, Diagnosis) else None)
    took = (
        ""
        if offset_s is None
        else words.of(f"; it would take an offset of {number(offset_s)} s", f"；须有{number(offset_s)} s的时间偏移")
    )
    return f"{words.effect(other)}: {behind}{took}"


def implied_offset_s(alias: str, beside: FoundEffect, declared: ErrorModel | None) -> float | None:
    """Size of the clock offset that would look like an effect, seconds; None for what is no clock's error."""
    if alias not in _CLOCKS or declared is None:
        return None
    twin, term = _CLOCKS[alias]
    labels = declared.labels()
    if beside.name != twin or term not in labels:
        return None
    sensitivity = declared.coefficients[labels.index(term)]
    return abs(beside.coefficients[0].value / sensitivity) if sensitivity else None


def separating_test(found: FoundEffect | ConfoundedEffect, words: Wording) -> str:
    """The measurement that tells an effect from its like."""
    known = effect(found.name)
    return words.of(known.separating_test, known.separating_test_zh)
