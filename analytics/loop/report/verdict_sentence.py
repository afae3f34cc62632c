"""The verdict in one sentence; in English or Chinese."""

from collections.abc import Sequence

from analytics.loop.effects.turn_on import TURN_ON
from analytics.loop.report.wording import Wording, number
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from analytics.loop.tracing.result.error_table import ErrorGain
from analytics.loop.tracing.result.finding import ConfoundedEffect, FoundEffect
from analytics.loop.tracing.result.holdout import HeldOutAnswer, HoldoutSlope
from analytics.loop.tracing.search.fitted_candidates import JUMP

_OR, _AND = ("or", "或"), ("and", "和")


def verdict_sentence(diagnosis: Diagnosis, words: Wording) -> str:
    """Say in one sentence what the data say of the declared model.

    Examples
    --------
    >>> none = Diagnosis(verdict=ModelVerdict.NOT_ENOUGH_DATA, units=("FOG-1",), signal="rate", missing=("9 blocks",))
    >>> verdict_sentence(none, Wording("en"))
    'Not enough data for a verdict: 9 blocks.'
    """
    match diagnosis.verdict:
        case ModelVerdict.NOT_ENOUGH_DATA:
            missing = words.of("; ", "；").join(map(words.remark, diagnosis.missing))
            return words.of(f"Not enough data for a verdict: {missing}.", f"数据不足，无法判定：{missing}。")
        case ModelVerdict.NOTHING_MISSING:
            return _nothing_missing(diagnosis, words)
        case ModelVerdict.EFFECT_FOUND:
            return _found(diagnosis, words)
        case ModelVerdict.CONFOUNDED:
            return _confounded(diagnosis, words)
        case ModelVerdict.UNKNOWN_FUNCTION:
            return _unknown_function(diagnosis, words)
        case ModelVerdict.UNREPLICATED:
            return _unreplicated(diagnosis, words)
        case ModelVerdict.UNEXPLAINED:
            return _unexplained(diagnosis, words)


def _nothing_missing(diagnosis: Diagnosis, words: Wording) -> str:
    looked_for, what = len(diagnosis.detection_limits), _data(diagnosis, words)
    if diagnosis.declared_noise is None:
        return words.of(
            f"Nothing is shown to be missing: beside noise of the size that {what} themselves suggest, none of "
            f"{looked_for} effects stands out.",
            f"未显示缺项：以{what}自身估计的噪声衡量，所查{looked_for}种效应均不显著。",
        )
    return words.of(
        f"Nothing is missing: what the declared model leaves of {what} is noise, and none of {looked_for} effects that "
        "were looked for is in it.",
        f"无缺项：已声明模型在{what}中的残差为噪声，所查{looked_for}种效应均不存在。",
    )


def _data(diagnosis: Diagnosis, words: Wording) -> str:
    count = len(diagnosis.runs)
    if diagnosis.replication == "within_run":
        return words.of(f"{count} segments of the only run", f"唯一一次试验的{count}段")
    return words.of(f"{count} runs", f"{count}次试验")


def _found(diagnosis: Diagnosis, words: Wording) -> str:
    confirmed = [each for each in diagnosis.effects if each.confirmed]
    others = [each for each in diagnosis.effects if not each.confirmed]
    told = _joined([_told(each, words) for each in confirmed], _AND, words)
    count = len(confirmed)
    rest = f"{_confirmation(diagnosis, words)}{_gain(diagnosis, words)}"
    if others:
        seen = _joined([_seen_once(each, diagnosis, words) for each in others], _AND, words)
        rest += words.of(f"; beside it, {seen}", f"；另{seen}")
    return words.of(
        f"The declared model lacks {'one effect' if count == 1 else f'{count} effects'}: {told}{rest}.",
        f"已声明模型缺少{count}种效应：{told}{rest}。",
    )


def _told(found: FoundEffect, words: Wording) -> str:
    return f"{words.effect(found)}{words.of(': ', '：')}{words.coefficient(found)}"


def _joined(parts: Sequence[str], last: tuple[str, str], words: Wording) -> str:
    """Join parts that have commas of their own."""
    if len(parts) < 2:
        return "".join(parts)
    return words.of("; ", "；").join([*parts[:-1], f"{words.of(f'{last[0]} ', last[1])}{parts[-1]}"])


def _confounded(diagnosis: Diagnosis, words: Wording) -> str:
    choices, clear, once = [], [], []
    for each in diagnosis.effects:
        others = [_alternative(other, words) for other in each.confounded]
        if each.name == TURN_ON:
            choices.append(_runs_differ(each, others, diagnosis, words))
        elif not each.replicates:
            once.append(_seen_once(each, diagnosis, words))
        elif others:
            choices.append(_joined([_told(each, words), *others], _OR, words))
        else:
            clear.append(_told(each, words))
    which = words.of("; and also ", "；另有").join(choices)
    if all(each.name == TURN_ON for each in diagnosis.effects):
        return words.of(f"{which[0].upper()}{which[1:]}.", f"{which}。")
    if clear:
        which += words.of("; beside it, clearly, ", "；另可确定") + _joined(clear, _AND, words)
    if once:
        which += words.of("; beside it, ", "；另") + _joined(once, _AND, words)
    where = ""
    if diagnosis.replication == "within_run":
        where = words.of("going by the only run, ", "就唯一一次试验而言，")
    rest = f"{_confirmation(diagnosis, words)}{_gain(diagnosis, words)}"
    text = words.of(
        f"{where}the declared model lacks an effect, and these data cannot tell which: {which}{rest}.",
        f"{where}已声明模型缺少一种效应，但现有数据无法区分是哪一种：{which}{rest}。",
    )
    return text[0].upper() + text[1:]


def _alternative(other: ConfoundedEffect, words: Wording) -> str:
    if not other.is_plausible and other.implied is not None:
        needed = f"{number(other.implied)} {other.implied_unit}"
        return words.of(
            f"hardly {words.effect(other)} (of {needed})", f"{words.effect(other)}（须达{needed}，不大可能）"
        )
    return words.effect(other) + ("" if other.recorded else words.of(" (not recorded)", "（未记录）"))


def _runs_differ(found: FoundEffect, others: Sequence[str], diagnosis: Diagnosis, words: Wording) -> str:
    size = words.coefficient(found)
    what = words.listed([*others, words.effect(found)])
    runs = len(diagnosis.runs)
    return words.of(
        f"the runs differ by {size}; {what} differ between them, and {runs} runs cannot tell",
        f"各次试验相差{size}；其间{what}均不同，{runs}次试验无法区分",
    )


def _unknown_function(diagnosis: Diagnosis, words: Wording) -> str:
    strange = [each for each in diagnosis.effects if each.unknown_function_of]
    channels = list(dict.fromkeys(name for each in strange for name in each.unknown_function_of))
    nearest = _joined([words.effect(each) for each in strange], _AND, words)
    depends = words.listed(channels) or words.of("something", "某通道")
    return words.of(
        f"The error depends on {depends}, but not as any effect of the library says; nearest comes {nearest}"
        f"{_confirmation(diagnosis, words)}{_gain(diagnosis, words)}.",
        f"误差随{depends}变化，但不符合库中任何效应的形式；最接近的是{nearest}"
        f"{_confirmation(diagnosis, words)}{_gain(diagnosis, words)}。",
    )


def _unreplicated(diagnosis: Diagnosis, words: Wording) -> str:
    lasting = [each for each in diagnosis.effects if each.replicates]
    if diagnosis.replication == "within_run" and lasting:
        told, gain = _joined([_told(each, words) for each in lasting], _AND, words), _gain(diagnosis, words)
        return words.of(
            f"The only run shows {told}, and its segments repeat it; another run must show whether it is an effect or "
            f"of this run alone{gain}.",
            f"唯一一次试验显示{told}，其各段均重现；是效应还是仅属本次试验，须由另一次试验证实{gain}。",
        )
    seen = (*diagnosis.effects, *diagnosis.unreplicated)
    parts = [_seen_once(each, diagnosis, words) for each in seen]
    if lasting:
        return words.of(f"Seen and not confirmed: {'; '.join(parts)}.", f"见到但未证实：{'；'.join(parts)}。")
    return words.of(f"Nothing that repeats: {'; '.join(parts)}.", f"未发现可重现的效应：{'；'.join(parts)}。")


def _seen_once(found: FoundEffect, diagnosis: Diagnosis, words: Wording) -> str:
    name = words.effect(found)
    if found.name == JUMP:
        return words.of(
            f"a {name} of {words.coefficient(found)} happened once", f"{name}（{words.coefficient(found)}）仅出现一次"
        )
    if found.confirmed is False:
        slope = _slope_of(diagnosis, found.name)
        how = "" if slope is None else words.of(f" (slope {_slope(slope)})", f"（斜率{_slope(slope)}）")
        return words.of(
            f"{name} was seen in the training runs, and the held-out runs do not confirm it{how}",
            f"训练试验中见到{name}，但留出试验未予证实{how}",
        )
    if found.replicates:
        told = f"{name}{words.of(': ', '：')}{words.coefficient(found)}"
        if diagnosis.holdout is None:
            return words.of(f"{told}; no runs were held out to confirm it", f"{told}；无留出试验可供证实")
        return words.of(
            f"{told}; the held-out runs do not excite it, so that they neither confirm nor refuse it",
            f"{told}；留出试验未激励该效应，既不能证实也不能否定",
        )
    return words.of(
        f"{name} was seen, but {found.largest_share:.0%} of its evidence comes from one run",
        f"见到{name}，但其证据的{found.largest_share:.0%}来自同一次试验",
    )


def _unexplained(diagnosis: Diagnosis, words: Wording) -> str:
    if diagnosis.unexplained is not None:
        why = words.remark(diagnosis.unexplained)
        return words.of(
            f"Something is missing, and nothing in the channels explains it: {why}.",
            f"存在缺项，但通道中无可解释者：{why}。",
        )
    if diagnosis.effects:
        told = _joined([words.effect(each) for each in diagnosis.effects], _AND, words)
        return words.of(
            f"The error changes in ways that happened once each and that nothing in the channels explains: {told}.",
            f"误差有若干仅出现一次的变化，通道中无可解释者：{told}。",
        )
    ratio = number(diagnosis.noise_excess)
    return words.of(
        f"At averages of 300 to 3600 s the variance is {ratio} times what the declared noise allows, and nothing in "
        "the channels explains it.",
        f"在300至3600 s平均时间上方差为已声明噪声的{ratio}倍，通道中无可解释者。",
    )


def _confirmation(diagnosis: Diagnosis, words: Wording) -> str:
    if diagnosis.holdout is None:
        return words.of("; no runs were held out to confirm it", "；无留出试验可供证实")
    count = len(diagnosis.holdout.runs)
    slope = _slope(diagnosis.holdout.total)
    if diagnosis.holdout.overall is HeldOutAnswer.NO_POWER:
        return words.of(
            f"; the held-out runs do not excite it and cannot confirm it (slope {slope})",
            f"；留出试验未激励该效应，不能证实（斜率{slope}）",
        )
    if diagnosis.replication == "within_run":
        return words.of(
            f"; the {count} segments that were held out confirm it (slope {slope})",
            f"；留出的{count}段予以证实（斜率{slope}）",
        )
    runs = words.of("run confirms" if count == 1 else "runs confirm", "")
    return words.of(f"; {count} held-out {runs} it (slope {slope})", f"；{count}次留出试验予以证实（斜率{slope}）")


def _gain(diagnosis: Diagnosis, words: Wording) -> str:
    row = None if diagnosis.error is None else diagnosis.error.reference
    if diagnosis.error is None or row is None or row.gain is None:
        return ""
    unit = diagnosis.error.unit_of_measure
    seconds = f"{row.averaging_s:g} s"
    where = ("there", "其") if diagnosis.error.is_held_out else ("in the training runs", "训练试验的")
    raw = words.of(
        f"{number(row.before)} to {number(row.after)} {unit}{_significance(row.gain, words)}",
        f"{number(row.before)}变为{number(row.after)} {unit}{_significance(row.gain, words)}",
    )
    falls = "falls" if row.gain.is_significant else "goes"
    told = words.of(
        f", and the RMS error over {seconds} {where[0]} {falls} from {raw}", f"，{where[1]}{seconds}均方根误差由{raw}"
    )
    if row.gain.runs < 2 or row.gain_within is None:
        return told
    within, noise = (number(row.before_within), number(row.after_within)), number(row.floor_within)
    return told + words.of(
        f"; about the mean of each run from {within[0]} to {within[1]}{_significance(row.gain_within, words)} (noise "
        f"alone {noise})",
        f"；去除各次试验均值后由{within[0]}变为{within[1]}{_significance(row.gain_within, words)}（仅噪声{noise}）",
    )


def _significance(gain: ErrorGain, words: Wording) -> str:
    if gain.lo is None:
        return words.of(" (one run: no limits)", "（仅一次试验：无置信限）")
    if gain.is_significant or gain.is_loss:
        return ""
    return words.of(" (not significant here)", "（此处不显著）")


def _slope_of(diagnosis: Diagnosis, name: str) -> HoldoutSlope | None:
    slopes = () if diagnosis.holdout is None else diagnosis.holdout.effects
    return next((each for each in slopes if each.effect == name), None)


def _slope(found: HoldoutSlope) -> str:
    return f"{found.slope:.2f} ± {found.slope_se:.2f}"
