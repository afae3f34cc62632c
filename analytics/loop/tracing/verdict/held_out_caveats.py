"""Caveats of the held-out runs: effects that they excite too little, show with another size, or do not confirm."""

import math
from collections.abc import Iterator, Sequence

from analytics.loop.bilingual import Bilingual, listed
from analytics.loop.effects import registry
from analytics.loop.tracing.result.diagnosis_result import FoundEffect
from analytics.loop.tracing.result.holdout import HeldOutAnswer, Holdout, HoldoutSlope
from analytics.loop.tracing.search.fitted_candidates import LINE

LIKELY_DIFFERENT, SURELY_DIFFERENT = 1.96, 3.29  # standard errors: by chance in 1 of 20, 1 of 1000 true effects


def holdout_caveats(holdout: Holdout | None, effects: Sequence[FoundEffect]) -> Iterator[Bilingual]:
    """Effects that the held-out runs excite too little, or show with another size."""
    for effect in effects:
        slope = None if holdout is None else holdout.slope(effect.name)
        if slope is None:
            continue
        name, size = registry.effect_name(effect.name), f"{slope.slope:.3g} ± {slope.slope_se:.2g}"
        if slope.sole_run is not None:
            en, zh = (f" (slope {size})", f"（斜率{size}）") if effect.is_sized else ("", "")
            yield Bilingual(
                f"{name}: run {slope.sole_run} alone shows it, which may differ for any reason; the other runs do not "
                f"confirm it{en}: measure more runs like that one",
                f"{name.zh}：仅试验{slope.sole_run}显示该效应，该次试验可能因其他原因而不同；其余试验不能予以证实"
                f"{zh}：请补测与其条件相同的试验",
            )
        elif slope.raises_error:
            yield Bilingual(
                f"{name}: the held-out runs contradict it, since their RMS error is larger with it, although its slope "
                f"is {size}: its form or its size is not right there",
                f"{name.zh}：尽管斜率为{size}，加入后留出试验的均方根误差更大，故与之相矛盾：其形式或大小在该处不成立",
            )
        elif slope.may_be_walk:
            yield _walk_caveat(slope)
        elif not slope.is_independent:
            yield Bilingual(
                f"{name}: only all runs together show it, so that the held-out runs, which are among them, do "
                f"not confirm it (slope {size}): measure more runs",
                f"{name.zh}：须合并全部试验才能见到，留出试验亦在其中，因此不能予以证实（斜率{size}）：请测量更多试验",
            )
        elif slope.answer is HeldOutAnswer.NO_POWER:
            advice = _better_holdout(effect)
            yield Bilingual(
                f"{name}: the held-out runs excite it too little and can neither confirm nor refuse it (slope "
                f"{size}); {advice}",
                f"{name.zh}：留出试验对该效应激励不足，既不能证实也不能否定（斜率{size}）；{advice.zh}",
            )
        elif effect.name != LINE and (why := _wrong_size(slope)) is not None:
            yield Bilingual(
                f"{name}: the held-out runs show {size} times the prediction{why}",
                f"{name.zh}：留出试验所示为预测值的{size}倍{why.zh}",
            )


def refit_caveats(
    judged: Sequence[FoundEffect], refitted: Sequence[FoundEffect], refused: Sequence[FoundEffect]
) -> Iterator[Bilingual]:
    """Effects whose size is another one without those that the held-out runs refused."""
    without = listed(registry.effect_name(each.name) for each in refused)
    for before, after in zip(judged, refitted, strict=True):
        name = registry.effect_name(after.name)
        for old, new in zip(before.coefficients, after.coefficients, strict=True):
            if not old.lo <= new.value <= old.hi:
                label, unit = f" ({new.name})" if new.name else "", new.unit_of_measure
                yield Bilingual(
                    f"{name}{label} is {new.value:.3g} {unit} without {without}, which the held-out runs refuse, and "
                    f"was {old.value:.3g} {unit} beside it: they judged the latter",
                    f"{name.zh}{label}在去掉被留出试验否定的{without.zh}后为{new.value:.3g} {unit}，"
                    f"与其一并拟合时为{old.value:.3g} {unit}：留出试验所判别的是后者",
                )


def _walk_caveat(slope: HoldoutSlope) -> Bilingual:
    name, odds = registry.effect_name(slope.effect), f"{math.exp(slope.walk_log_odds or 0.0):.2g}"
    return Bilingual(
        f"{name}: it shifts whole runs, and a bias that walks from run to run explains them about as well or better "
        f"(likelihood ratio {odds}; 20 is needed): measure more runs, in random order if the effect can be set",
        f"{name.zh}：该效应只使各次试验整体偏移，而零偏在各次试验之间随机游走的解释同样好或更好（似然比{odds}，需要20）："
        "请测量更多试验，若该效应可设定则随机安排次序",
    )


def _wrong_size(slope: HoldoutSlope) -> Bilingual | None:
    apart = abs(slope.slope - 1) / math.hypot(slope.slope_se, slope.training_se)
    if apart >= SURELY_DIFFERENT:
        return Bilingual(
            ", more than chance: its form is not exact, or it changes from run to run",
            "，超出偶然范围：其形式不精确，或随试验而变",
        )
    if apart >= LIKELY_DIFFERENT:
        return Bilingual(
            ": its form is likely not exact, or it changes from run to run", "：其形式可能不精确，或随试验而变"
        )
    return None


def _better_holdout(effect: FoundEffect) -> Bilingual:
    """The runs with most information on an effect, if there are others to find it in."""
    exciting = sorted(effect.by_run, key=lambda run: effect.by_run[run][1])
    if len(exciting) < 3:
        return Bilingual("measure more runs that excite it", "请测量更多激励它的试验")
    option = f"--holdout runs={','.join(sorted(exciting[: len(exciting) // 3]))}"
    return Bilingual(f"hold out runs that do: {option}", f"请留出能激励它的试验：{option}")
