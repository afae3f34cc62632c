"""The verdict in one sentence; in English or Chinese."""

from collections.abc import Sequence

from analytics.report.wording import Wording, number
from analytics.tracing.contenders import JUMP
from analytics.tracing.result import Diagnosis, ErrorAt, ErrorTable, FoundEffect, HoldoutSlope, Verdict

_OR, _AND = ("or", "或"), ("and", "和")


def verdict_sentence(diagnosis: Diagnosis, words: Wording) -> str:
    """Say in one sentence what the data say of the declared model.

    Examples
    --------
    >>> none = Diagnosis(verdict=Verdict.NOT_ENOUGH_DATA, units=("FOG-1",), signal="rate", missing=("9 blocks",))
    >>> verdict_sentence(none, Wording("en"))
    'Not enough data for a verdict: 9 blocks.'
    """
    match diagnosis.verdict:
        case Verdict.NOT_ENOUGH_DATA:
            missing = words.of("; ", "；").join(map(words.remark, diagnosis.missing))
            return words.of(f"Not enough data for a verdict: {missing}.", f"数据不足，无法判定：{missing}。")
        case Verdict.NOTHING_MISSING:
            return _nothing_missing(diagnosis, words)
        case Verdict.EFFECT_FOUND:
            return _found(diagnosis, words)
        case Verdict.CONFOUNDED:
            return _confounded(diagnosis, words)
        case Verdict.UNKNOWN_FUNCTION:
            return _unknown_function(diagnosis, words)
        case Verdict.UNREPLICATED:
            return _unreplicated(diagnosis, words)
        case Verdict.UNEXPLAINED:
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
    told = _joined([_told(each, words) for each in diagnosis.effects], _AND, words)
    count = len(diagnosis.effects)
    rest = f"{_confirmation(diagnosis, words)}{_gain(diagnosis, words)}"
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
        others = [words.effect(other) for other in each.confounded]
        if not each.replicates:
            once.append(_seen_once(each, diagnosis, words))
        elif others:
            choices.append(_joined([_told(each, words), *others], _OR, words))
        else:
            clear.append(_told(each, words))
    which = words.of("; and also ", "；另有").join(choices)
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
    return words.of(
        f"Nothing that repeats: {'; '.join(parts)}.",
        f"未发现可重现的效应：{'；'.join(parts)}。",
    )


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
    return words.of(
        f"{name} was seen, but {found.largest_share:.0%} of its evidence comes from one run",
        f"见到{name}，但其证据的{found.largest_share:.0%}来自同一次试验",
    )


def _unexplained(diagnosis: Diagnosis, words: Wording) -> str:
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
    if diagnosis.replication == "within_run":
        return words.of(
            f"; the {count} segments that were held out confirm it (slope {slope})",
            f"；留出的{count}段予以证实（斜率{slope}）",
        )
    runs = words.of("run confirms" if count == 1 else "runs confirm", "")
    return words.of(f"; {count} held-out {runs} it (slope {slope})", f"；{count}次留出试验予以证实（斜率{slope}）")


def _gain(diagnosis: Diagnosis, words: Wording) -> str:
    row = best_row(diagnosis.error)
    if diagnosis.error is None or row is None:
        return ""
    unit = diagnosis.error.unit_of_measure
    before, after, floor = (number(each) for each in (row.before, row.after, row.floor))
    seconds = f"{row.averaging_s:g} s"
    where = ("there", "其") if diagnosis.error.is_held_out else ("in the training runs", "训练试验的")
    return words.of(
        f", and the RMS error over {seconds} {where[0]} falls from {before} to {after} {unit} (noise alone {floor})",
        f"，{where[1]}{seconds}均方根误差由{before}降至{after} {unit}（仅噪声{floor}）",
    )


def best_row(table: ErrorTable | None) -> ErrorAt | None:
    """Averaging time at which the model found wins most; None where it wins nowhere."""
    rows = [] if table is None else [row for row in table.rows if row.after < row.before]
    return max(rows, key=lambda row: 1 - (row.after / row.before) ** 2, default=None)


def _slope_of(diagnosis: Diagnosis, name: str) -> HoldoutSlope | None:
    slopes = () if diagnosis.holdout is None else diagnosis.holdout.effects
    return next((each for each in slopes if each.effect == name), None)


def _slope(found: HoldoutSlope) -> str:
    return f"{found.slope:.2f} ± {found.slope_se:.2f}"
