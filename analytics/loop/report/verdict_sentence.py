"""The verdict of a diagnosis in one sentence, in English or Chinese."""

from collections.abc import Sequence

from analytics.loop.effects.channel_names import channel_name
from analytics.loop.effects.events import STATION, TURN_ON
from analytics.loop.report.wording import LEAST_SHARE, Wording, number, percent, slope_text, sole_run
from analytics.loop.tracing.result.diagnosis_result import (
    BiasTest,
    ConfoundedEffect,
    Diagnosis,
    FoundEffect,
    ModelVerdict,
)
from analytics.loop.tracing.result.holdout import ErrorGain, HeldOutAnswer, HoldoutSlope
from analytics.loop.tracing.search.fitted_candidates import JUMP

_OR, _AND = ("or", "或"), ("and", "和")
# ratio of the squared errors that fall within runs and in their means, below which an effect acts on the means
_OF_MEANS = 0.1
_FROM_ONE = 0.9  # share of the evidence from one run that is the reason why an effect does not replicate


def verdict_sentence(diagnosis: Diagnosis, words: Wording) -> str:
    """The verdict in one sentence; of several effects the one that explains most of the held-out error comes first.

    >>> none = Diagnosis(verdict=ModelVerdict.NOT_ENOUGH_DATA, units=("FOG-1",), signal="rate", missing=("9 blocks",))
    >>> verdict_sentence(none, Wording("en"))
    'Not enough data for a verdict: 9 blocks.'
    """
    match diagnosis.verdict:
        case ModelVerdict.NOT_ENOUGH_DATA:
            missing = words.of("; ", "；").join(map(words.text, diagnosis.missing))
            text = words.of(f"not enough data for a verdict: {missing}", f"数据不足，无法判定：{missing}")
        case ModelVerdict.NOTHING_MISSING:
            text = _nothing_missing(diagnosis, words)
        case ModelVerdict.UNREPLICATED:
            text = _unreplicated(diagnosis, words)
        case ModelVerdict.UNEXPLAINED:
            text = _unexplained(diagnosis, words)
        case ModelVerdict.EFFECT_FOUND | ModelVerdict.CONFOUNDED | ModelVerdict.UNKNOWN_FUNCTION:
            text = _lacking(diagnosis, words)
    return text[0].upper() + text[1:] + words.of(".", "。")


def _nothing_missing(diagnosis: Diagnosis, words: Wording) -> str:
    tested, count = len(diagnosis.detection_limits), len(diagnosis.runs)
    data = words.of(f"{count} runs", f"{count}次试验")
    if diagnosis.replication == "within_run":
        data = words.of(f"{count} segments of the only run", f"唯一一次试验的{count}段")
    scatter = "" if diagnosis.scatter is None else f"{words.of('; ', '；')}{words.text(diagnosis.scatter)}"
    if diagnosis.declared_noise is None:
        return words.of(
            f"no missing effect is detected: relative to the noise estimated from {data}, none of {tested} effects is "
            f"significant{scatter}",
            f"未检出缺项：以{data}自身估计的噪声衡量，所检验的{tested}种效应均不显著{scatter}",
        )
    if scatter:
        return words.of(
            f"nothing is found to be missing: within the runs the residual of the declared model is noise, and none of "
            f"the {tested} effects tested is seen{scatter}",
            f"未检出缺项：已声明模型在各次试验内的残差为噪声，所检验的{tested}种效应均未见到{scatter}",
        )
    return words.of(
        f"nothing is missing: the residual of the declared model in {data} is the noise declared, or else "
        f"that of the unit's own Allan curves, and none of the {tested} effects that were tested was found; the table "
        "has the size above which each is excluded",
        f"未检出缺项：已声明模型在{data}中的残差即为所声明的噪声（未声明时为产品自身Allan曲线的噪声），"
        f"所检验的{tested}种效应均未检出；各效应可排除的大小下限见表",
    )


def _lacking(diagnosis: Diagnosis, words: Wording) -> str:
    """The missing effects, the largest first, then what was seen once, the answer of the held-out runs, the gain."""
    lasting = [each for each in diagnosis.by_size if each.replicates]
    if diagnosis.verdict is ModelVerdict.EFFECT_FOUND:
        lasting = [each for each in lasting if each.confirmed] or lasting
    others = [each for each in diagnosis.by_size if each not in lasting]
    once = [each for each in diagnosis.unreplicated if not each.replicates]
    rest = "".join(words.of("; also, ", "；另") + _seen_once(each, diagnosis, words) for each in others)
    if lasting[0].name == TURN_ON:
        return f"{_runs_differ(lasting[0], diagnosis, words)}{rest}"
    where = ""
    if diagnosis.replication == "within_run":
        where = words.of("judging by the only run, ", "就唯一一次试验而言，")
    them = "it" if len(lasting) == 1 else "them"
    rest = f"{rest}{_confirmation(diagnosis, them, words)}{_gain(diagnosis, words)}"
    rest += "".join(words.of("; also, ", "；另") + _seen_once(each, diagnosis, words) for each in once)
    return f"{where}{_effects(lasting, words)}{rest}"


def _effects(lasting: Sequence[FoundEffect], words: Wording) -> str:
    """The missing effects; a single one in a form of its own."""
    first, count = lasting[0], len(lasting)
    if count > 1:
        listed = _joined([_one_of_several(each, words) for each in lasting], _AND, words)
        return words.of(
            f"the declared model lacks {count} effects, the largest first: {listed}",
            f"已声明模型缺少{count}种效应（按大小排列）：{listed}",
        )
    if first.unknown_function_of:
        channels, nearest = words.listed(first.unknown_function_of), words.effect(first)
        return words.of(
            f"the error depends on {channels}, but not in the form of any effect of the library; the nearest is "
            f"{nearest}",
            f"误差随{channels}变化，但不符合库中任何效应的形式；最接近的是{nearest}",
        )
    if first.confounded:
        choices = [_sized(first, words), *(_alternative(other, words) for other in first.confounded)]
        listed = _joined(choices, _OR, words)
        return words.of(
            f"the declared model lacks one of several effects, which these data cannot separate: {listed}",
            f"已声明模型缺少下列效应之一，现有数据无法区分：{listed}",
        )
    one = _sized(first, words)
    return words.of(f"the declared model lacks one effect: {one}", f"已声明模型缺少1种效应：{one}")


def _one_of_several(found: FoundEffect, words: Wording) -> str:
    text = _sized(found, words)
    if found.error_share is not None:
        share = f"{found.error_share:.0%}"
        text += words.of(f", {share} of the squared error", f"，占误差平方的{share}")
    if found.unknown_function_of:
        channels = words.listed(found.unknown_function_of)
        text += words.of(
            f" (of unknown form: the error depends on {channels} in another way)",
            f"（形式未知：误差以其他方式随{channels}变化）",
        )
    if found.confounded:
        others = words.listed([_alternative(other, words) for other in found.confounded], _OR)
        text += words.of(f" (these data cannot separate it from {others})", f"（现有数据无法与{others}区分）")
    return text


def _sized(found: FoundEffect, words: Wording) -> str:
    return f"{words.effect(found)}{words.of(': ', '：')}{words.coefficient(found)}"


def _joined(parts: Sequence[str], last: tuple[str, str], words: Wording) -> str:
    """Join parts that contain commas."""
    if len(parts) < 2:
        return "".join(parts)
    return words.of("; ", "；").join([*parts[:-1], f"{words.of(f'{last[0]} ', last[1])}{parts[-1]}"])


def _alternative(other: ConfoundedEffect, words: Wording) -> str:
    name = words.effect(other)
    if not other.is_plausible and other.implied is not None:
        needed = f"{number(other.implied)} {other.implied_unit}"
        return words.of(f"{name} (unlikely: it would need {needed})", f"{name}（须达{needed}，不大可能）")
    return name + ("" if other.recorded else words.of(" (not recorded)", "（未记录）"))


def _runs_differ(found: FoundEffect, diagnosis: Diagnosis, words: Wording) -> str:
    size, runs = words.coefficient(found), len(diagnosis.runs)
    causes = words.listed([*(_alternative(other, words) for other in found.confounded), words.effect(found)])
    return words.of(
        f"the runs differ by {size}; {causes} differ between them, and {runs} runs cannot separate these causes",
        f"各次试验相差{size}；其间{causes}均不同，{runs}次试验无法区分",
    )


def _unreplicated(diagnosis: Diagnosis, words: Wording) -> str:
    lasting = [each for each in diagnosis.by_size if each.replicates]
    if diagnosis.replication == "within_run" and lasting:
        effects, gain = _joined([_sized(each, words) for each in lasting], _AND, words), _gain(diagnosis, words)
        return words.of(
            f"the only run shows {effects}, repeated in its segments; another run is needed to show whether this is an "
            f"effect or specific to this run{gain}",
            f"唯一一次试验显示{effects}，其各段均重现；是效应还是仅属本次试验，须由另一次试验证实{gain}",
        )
    seen = (*diagnosis.by_size, *diagnosis.unreplicated)
    listed = words.of("; ", "；").join(_seen_once(each, diagnosis, words) for each in seen)
    if lasting or any(each.of_biases for each in seen):
        return words.of(f"seen but not confirmed: {listed}", f"见到但未证实：{listed}")
    return words.of(f"no effect that repeats: {listed}", f"未发现可重现的效应：{listed}")


def _seen_once(found: FoundEffect, diagnosis: Diagnosis, words: Wording) -> str:
    alternatives = found.confounded if not found.replicates else ()
    name = words.listed([words.effect(found), *(_alternative(other, words) for other in alternatives)], _OR)
    sized = _sized(found, words)
    if found.name == JUMP:
        return _jumped(found, name, words)
    slope = None if diagnosis.holdout is None else diagnosis.holdout.slope(found.name)
    if found.of_biases is not None:
        return _followed(found, found.of_biases, slope, words)
    if found.sole_run is not None:
        return f"{sized}{words.of('; ', '；')}{sole_run(found.sole_run, words)}"
    if found.confirmed is False:
        if slope is not None and slope.tells_nothing:
            return words.of(
                f"{name} was seen in the training runs, but the held-out runs have nothing that tells of it",
                f"训练试验中见到{name}，但留出试验没有可供判别的数据",
            )
        if slope is not None and slope.may_be_walk:
            return words.of(
                f"{name} was seen in the training runs, but a bias that walks from run to run explains all runs better",
                f"训练试验中见到{name}，但零偏在各次试验之间随机游走能更好地解释全部试验",
            )
        size = "" if slope is None else words.of(f" (slope {slope_text(slope)})", f"（斜率{slope_text(slope)}）")
        return words.of(
            f"{name} was seen in the training runs, but the held-out runs do not confirm it{size}",
            f"训练试验中见到{name}，但留出试验未予证实{size}",
        )
    if not found.replicates and found.largest_share < _FROM_ONE:
        return words.of(
            f"{name} was seen, but fitted to the other runs it does not predict a run better than the model without it",
            f"见到{name}，但由其他试验拟合后，对一次试验的预测并不优于不含它的模型",
        )
    if not found.replicates:
        share = f"{found.largest_share:.0%}"
        return words.of(
            f"{name} was seen, but {share} of its evidence comes from one run",
            f"见到{name}，但其证据的{share}来自同一次试验",
        )
    if slope is not None and slope.raises_error:
        return f"{sized}{words.of('; ', '；')}{_contradicted(diagnosis, slope, words)}"
    if diagnosis.holdout is None:
        return words.of(f"{sized}; no runs were held out to confirm it", f"{sized}；无留出试验可供证实")
    if slope is not None and slope.may_be_walk:
        return words.of(
            f"{sized}; a bias that walks from run to run explains the runs about as well",
            f"{sized}；零偏在各次试验之间随机游走的解释同样好",
        )
    return words.of(
        f"{sized}; the held-out runs excite it too little and can neither confirm nor refuse it",
        f"{sized}；留出试验对该效应激励不足，既不能证实也不能否定",
    )


def _jumped(found: FoundEffect, name: str, words: Wording) -> str:
    """A jump, and the channels that step with it."""
    size = words.coefficient(found)
    once = words.of(f"a {name} of {size} happened once", f"{name}（{size}）仅出现一次")
    if not found.coincides:
        return once
    en, zh = (words.listed([channel_name(each)[n] for each in found.coincides], _OR) for n in (0, 1))
    return once + words.of(
        f", which these data cannot separate from the steps of {en} at that time", f"，无法与{zh}同时发生的阶跃区分"
    )


def _followed(found: FoundEffect, test: BiasTest, slope: HoldoutSlope | None, words: Wording) -> str:
    """An effect that the biases of all runs follow, and why nothing confirms it."""
    size, p_value = words.size(test, found.coefficients[0].unit_of_measure), number(test.p_value)
    if found.name == STATION:
        size = words.coefficient(found)
        return words.of(
            f"the biases of the {test.runs} runs differ by station: {size} (p = {p_value}); whether it is the station "
            "or the unit, other units measured at both show",
            f"{test.runs}次试验的零偏随试验台而异：{size}（p = {p_value}）；"
            "是试验台还是产品所致，须由在两处均测量的其他产品判别",
        )
    names = words.listed([words.effect(found), *(_alternative(other, words) for other in found.confounded)], _OR)
    text = words.of(
        f"the biases of the {test.runs} runs follow {names}: {size} over all of them (p = {p_value})",
        f"{test.runs}次试验的零偏随{names}变化：全部试验的系数为{size}（p = {p_value}）",
    )
    if found.sole_run is not None:
        text += words.of("; ", "；") + sole_run(found.sole_run, words)
        if test.within is None:
            return text
    if test.within is not None:
        inside = f"{number(test.within[0])} ± {number(test.within[1])}"
        why = words.of(
            f"within the runs the output does not follow it ({inside}), so that it is not their cause as it stands",
            f"但各次试验内部的输出不随其变化（{inside}），故其本身不是原因",
        )
    elif slope is None:
        why = words.of("no runs were held out to confirm it", "无留出试验可供证实")
    elif slope.may_be_walk:
        why = words.of(
            "a bias that walks from run to run explains the runs about as well",
            "零偏在各次试验之间随机游走的解释同样好",
        )
    elif found.confirmed is False and slope.tells_nothing:
        why = words.of("the held-out runs have nothing that tells of it", "留出试验没有可供判别的数据")
    elif found.confirmed is False and not found.is_sized:
        why = words.of(
            "the training runs alone give no size of it that the held-out runs could confirm",
            "仅由训练试验得不出可供留出试验证实的大小",
        )
    elif found.confirmed is False:
        why = words.of(
            f"the held-out runs do not confirm the size that the training runs give (slope {slope_text(slope)})",
            f"留出试验未证实由训练试验得出的大小（斜率{slope_text(slope)}）",
        )
    elif not slope.is_independent:
        why = words.of(
            "only all runs together show it, so that none is left to confirm it",
            "须合并全部试验才能见到，没有余下的试验可供证实",
        )
    else:
        why = words.of("the held-out runs excite it too little to confirm it", "留出试验对其激励不足，不能证实")
    return f"{text}{words.of('; ', '；')}{why}"


def _unexplained(diagnosis: Diagnosis, words: Wording) -> str:
    seen = [_seen_once(each, diagnosis, words) for each in (*diagnosis.effects, *diagnosis.unreplicated)]
    beside = "".join(words.of("; also, ", "；另") + each for each in seen)
    if diagnosis.unexplained is not None:
        why = words.text(diagnosis.unexplained)
        return words.of(
            f"the declared model lacks something that no effect tested explains: {why}{beside}",
            f"存在缺项，但所检验的效应均不能解释：{why}{beside}",
        )
    if len(diagnosis.effects) > 1:
        effects = _joined(seen[: len(diagnosis.effects)], _AND, words)
        return words.of(
            f"the error has changes that happened once each and that no channel explains in all runs alike: {effects}",
            f"误差有若干仅出现一次的变化，没有通道能在各次试验中一致地解释：{effects}",
        )
    ratio = number(diagnosis.noise_excess)
    return words.of(
        f"at averages of 300 to 3600 s the variance is {ratio} times that of the noise declared, or else fitted to the "
        f"unit's own Allan curves, and no channel explains it{beside}",
        f"在300至3600 s平均时间上方差为已声明（或由产品自身Allan曲线拟合）噪声的{ratio}倍，通道中无可解释者{beside}",
    )


def _confirmation(diagnosis: Diagnosis, them: str, words: Wording) -> str:
    if diagnosis.holdout is None:
        return words.of(f"; no runs were held out to confirm {them}", "；无留出试验可供证实")
    count, slope = len(diagnosis.holdout.runs), slope_text(diagnosis.holdout.total)
    if diagnosis.holdout.overall is HeldOutAnswer.NO_POWER:
        undecided = [each for each in diagnosis.holdout.effects if each.answer is HeldOutAnswer.NO_POWER]
        alone = [each.sole_run for each in undecided if each.sole_run is not None]
        if alone:
            return f"{words.of('; ', '；')}{sole_run(alone[0], words)}"
        if any(each.raises_error for each in undecided):
            return f"{words.of('; ', '；')}{_contradicted(diagnosis, diagnosis.holdout.total, words)}"
        if any(each.may_be_walk for each in undecided):
            return words.of(
                f"; the held-out runs do not confirm {them}: a bias that walks from run to run explains the runs about "
                "as well",
                "；留出试验不能证实：零偏在各次试验之间随机游走的解释同样好",
            )
        return words.of(
            f"; the held-out runs excite {them} too little to confirm {them} (slope {slope})",
            f"；留出试验对该效应激励不足，不能证实（斜率{slope}）",
        )
    if diagnosis.replication == "within_run":
        return words.of(
            f"; the {count} held-out segments confirm {them} (slope {slope})",
            f"；留出的{count}段予以证实（斜率{slope}）",
        )
    runs = "run confirms" if count == 1 else "runs confirm"
    return words.of(f"; {count} held-out {runs} {them} (slope {slope})", f"；{count}次留出试验予以证实（斜率{slope}）")


def _contradicted(diagnosis: Diagnosis, slope: HoldoutSlope, words: Wording) -> str:
    """The held-out runs contradict an effect: their error rises with it."""
    row, size = None if diagnosis.error is None else diagnosis.error.reference, slope_text(slope)
    if diagnosis.error is None or row is None:
        return words.of("the held-out runs contradict it", "留出试验与之相矛盾")
    before, after = number(row.before), f"{number(row.after)} {diagnosis.error.unit_of_measure}"
    return words.of(
        f"the held-out runs contradict it: with it their RMS error over {row.averaging_s:g} s goes from {before} to "
        f"{after} (slope {size})",
        f"留出试验与之相矛盾：加入后其{row.averaging_s:g} s均方根误差由{before}变为{after}（斜率{size}）",
    )


def _gain(diagnosis: Diagnosis, words: Wording) -> str:
    table = diagnosis.error
    row = None if table is None else table.reference
    if table is None or row is None or row.gain is None:
        return ""
    seconds, falls = f"{row.averaging_s:g} s", "falls" if row.gain.is_significant else "goes"
    where = ("there", "其") if table.is_held_out else ("in the training runs", "训练试验的")
    before, after = number(row.before), f"{number(row.after)} {table.unit_of_measure}"
    mark = _significance(row.gain, words)
    text = words.of(
        f", and the RMS error over {seconds} {where[0]} {falls} from {before} to {after}{mark}",
        f"，{where[1]}{seconds}均方根误差由{before}变为{after}{mark}",
    )
    most = table.most_gained
    if most is not None and row.after > row.before:  # it acts within less time
        text = words.of(
            f", and the RMS error over {most.averaging_s:g} s {where[0]} falls from {number(most.before)} to "
            f"{number(most.after)} {table.unit_of_measure}; over {seconds} it goes from {before} to {after}{mark}",
            f"，{where[1]}{most.averaging_s:g} s均方根误差由{number(most.before)}变为{number(most.after)} "
            f"{table.unit_of_measure}；{seconds}的由{before}变为{after}{mark}",
        )
    if row.gain.runs < 2 or row.gain_within is None:
        return text
    before, after, noise = (number(each) for each in (row.before_within, row.after_within, row.floor_within))
    mark = _significance(row.gain_within, words)
    text += words.of(
        f"; about the mean of each run from {before} to {after}{mark} (noise alone {noise})",
        f"；去除各次试验均值后由{before}变为{after}{mark}（仅噪声{noise}）",
    )
    expected = table.gain
    if expected is None or expected.lo is None or expected.hi is None or not mark or not table.is_held_out:
        return text
    within = row.before_within**2 - row.after_within**2
    of_means = row.before**2 - row.after**2 - within
    shifts = abs(expected.fraction) < LEAST_SHARE or all(each.of_biases for each in diagnosis.effects)
    if shifts or within < _OF_MEANS * of_means:  # whole runs
        return text
    falls, lo, hi = (f"{percent(each)} %" for each in (expected.fraction, expected.lo, expected.hi))
    its = ("its square", "其平方")
    if expected.averaging_s != row.averaging_s:
        over = f"{expected.averaging_s:g} s"
        its = (f"the square of that over {over}, where the effect acts most,", f"{over}（效应作用最强处）误差的平方")
    return text + words.of(
        f"; in new runs like these {its[0]} is expected to fall by {falls} ({lo} to {hi})",
        f"；对同类新试验，预期{its[1]}下降{falls}（{lo}至{hi}）",
    )


def _significance(gain: ErrorGain, words: Wording) -> str:
    if gain.lo is None:
        return words.of(" (one run: no confidence bounds)", "（仅一次试验：无置信限）")
    if gain.is_significant or gain.is_loss:
        return ""
    return words.of(" (not significant)", "（不显著）")
