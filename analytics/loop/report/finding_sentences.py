"""The evidence of a finding and its alternatives; the effects common to several units, and the units that differ."""

from collections.abc import Iterator, Sequence

from analytics.loop.effects.events import STATION, TURN_ON
from analytics.loop.effects.registry import effect
from analytics.loop.effects.temperature import SENSOR_LAG
from analytics.loop.report.report_tables import TextTable
from analytics.loop.report.wording import LEAST_SHARE, Wording, number, slope_text, sole_run
from analytics.loop.tracing.fleet import FleetDiagnosis, UnitCoefficient
from analytics.loop.tracing.result.diagnosis_result import (
    BiasTest,
    ConfoundedEffect,
    Diagnosis,
    FoundEffect,
    ModelVerdict,
)
from analytics.loop.tracing.result.holdout import HeldOutAnswer, HoldoutSlope
from analytics.loop.tracing.verdict.adequacy import WRONG_FORM
from analytics.loop.unit_diagnosis import UnitsDiagnosis

_ANSWERS = {
    HeldOutAnswer.CONFIRMED: ("confirmed", "予以证实"),
    HeldOutAnswer.REFUSED: ("refused", "予以否定"),
    HeldOutAnswer.NO_POWER: ("these runs excite it too little to tell", "这些试验对该效应激励不足，无法判别"),
}
_WALKS = {
    HeldOutAnswer.REFUSED: (
        "refused; a bias that walks from run to run explains the runs better",
        "予以否定；零偏在各次试验之间随机游走的解释更好",
    ),
    HeldOutAnswer.NO_POWER: (
        "not confirmed; a bias that walks from run to run explains the runs about as well",
        "未证实；零偏在各次试验之间随机游走的解释同样好",
    ),
}
_ZH_VERDICTS = {
    ModelVerdict.NOTHING_MISSING: "未检出缺项",
    ModelVerdict.EFFECT_FOUND: "发现效应",
    ModelVerdict.CONFOUNDED: "无法区分",
    ModelVerdict.UNREPLICATED: "未重现",
    ModelVerdict.UNKNOWN_FUNCTION: "未知函数",
    ModelVerdict.UNEXPLAINED: "未解释",
    ModelVerdict.NOT_ENOUGH_DATA: "数据不足",
}
_PRESENT = 0.5  # probability from which on a unit is counted among those with a common effect
_MOST_NAMED = 8
_ABSENT = 0.05  # probability below which a unit is named as one without a common effect


def evidence(found: FoundEffect, diagnosis: Diagnosis | FleetDiagnosis, words: Wording) -> Iterator[str]:
    """The evidence of a finding."""
    left = number(found.evidence)
    if found.of_biases is not None:
        yield _of_biases(found, found.of_biases, words)
    else:
        yield words.of(
            f"Significance z = {found.significance:.1f} (one degree of freedom; noise fitted with and without the "
            f"effect); chi-square less the multiplicity penalty: {left}.",
            f"显著性z = {found.significance:.1f}（单自由度等效，噪声在有无该效应时分别拟合）；"
            f"扣除多重性惩罚后的卡方：{left}。",
        )
    if found.by_run and found.name != TURN_ON:
        yield _by_run(found, diagnosis, words)
    slope = None if diagnosis.holdout is None else diagnosis.holdout.slope(found.name)
    if slope is not None and slope.tells_nothing:
        yield words.of("The held-out runs have nothing that tells of it.", "留出试验没有可供判别的数据。")
    elif slope is not None:
        value, answer = slope_text(slope, 3), _answer(found, slope, words)
        yield words.of(
            f"Held-out runs, coefficients frozen: slope {value} of the residual on the prediction (1 if right): "
            f"{answer}.",
            f"留出数据、系数冻结：残差对预测的斜率为{value}（正确时为1）：{answer}。",
        )
    if found.error_share is not None and abs(found.error_share) >= LEAST_SHARE:
        share = f"{found.error_share:.1%}"
        yield words.of(
            f"Of the squared error about the mean of each run it takes away {share}.",
            f"它使去除各次试验均值后的误差平方减少{share}。",
        )
    if found.companions:
        names = words.listed([words.name(name) for name in found.companions])
        yield words.of(f"Proxies that follow it: {names}.", f"随其变化的代理量：{names}。")
    if found.unknown_function_of:
        channels = words.listed(found.unknown_function_of)
        yield words.of(
            f"Its form does not fit: the residual depends on {channels} in another way.",
            f"其形式不符：残差以其他方式随{channels}变化。",
        )


def _answer(found: FoundEffect, slope: HoldoutSlope, words: Wording) -> str:
    """The answer of the held-out runs on an effect."""
    if slope.sole_run is not None:
        return words.of("no confirmation, since ", "不作为证实，因") + sole_run(slope.sole_run, words)
    if slope.raises_error:
        return words.of("contradicted, since the RMS error is larger with it", "与之相矛盾，因加入后均方根误差更大")
    if slope.may_be_walk:
        return words.of(*_WALKS[slope.answer])
    if not slope.is_independent:
        return words.of(
            "no confirmation, since the training runs alone do not show it", "不作为证实，因训练试验单独未显示该效应"
        )
    if slope.answer is HeldOutAnswer.CONFIRMED and found.has_no_size:
        return words.of("no confirmation, since its bounds contain zero", "不作为证实，因其区间含零")
    return words.of(*_ANSWERS[slope.answer])


def _of_biases(found: FoundEffect, test: BiasTest, words: Wording) -> str:
    """The test of an effect that only the biases of all runs show."""
    size, p_value = words.size(test, found.coefficients[0].unit_of_measure), number(test.p_value)
    if found.name == STATION:
        size = words.coefficient(found)
        return words.of(
            f"The biases of {test.runs} runs differ by station: {size}, p = {p_value} (F test).",
            f"{test.runs}次试验的零偏随试验台而异：{size}，p = {p_value}（F检验）。",
        )
    return words.of(
        f"The biases of all {test.runs} runs follow it: {size} over all of them, p = {p_value} (Student's t, for "
        f"biases that are independent from run to run; causes that differ between runs, of which {test.tests} could be "
        "tested).",
        f"全部{test.runs}次试验的零偏随其变化：全部试验的系数为{size}，p = {p_value}"
        f"（t检验，设各次试验的零偏相互独立；共检验{test.tests}种仅在试验之间不同的原因）。",
    )


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
        size = f"{abs(other.evidence_behind):.1f}"
        behind = words.of(f"chi-square lower by {size}", f"卡方少{size}")
        if other.evidence_behind < 0.0:
            behind = words.of(f"chi-square higher by {size}", f"卡方多{size}")
    if other.implied is None or other.most is None:
        return f"{name}: {behind}"
    needed, most = (f"{number(each)} {other.implied_unit}" for each in (other.implied, other.most))
    if other.is_plausible:
        return f"{name}: {behind}{words.of(f'; it would need at least {needed}', f'；至少须有{needed}')}"
    if other.name == SENSOR_LAG:
        bound = words.of(f"sensors lag by {most} at most", f"传感器滞后至多{most}")
    else:
        bound = words.of(f"clocks are off by {most} at most", f"时钟偏差至多{most}")
    return f"{name}: " + words.of(
        f"it would need at least {needed}, but {bound}: unlikely", f"至少须有{needed}，而{bound}：不大可能"
    )


def separating_test(found: FoundEffect | ConfoundedEffect, words: Wording) -> str:
    """The measurement that separates an effect from similar ones."""
    known = effect(found.name)
    return words.of(known.separating_test, known.separating_test_zh)


def fleet_sentence(fleet: FleetDiagnosis, words: Wording) -> str:
    """The common effects, and how many units differ."""
    units = len(fleet.units)
    if fleet.verdict is ModelVerdict.NOT_ENOUGH_DATA:
        why = words.of("; ", "；").join(map(words.text, fleet.limits))
        return words.of(f"Not enough data to pool: {why}.", f"数据不足，无法汇总：{why}。")
    if not fleet.effects:
        alone = words.of("; ", "；").join(_of_single_units(fleet, words))
        beside = words.of(f"; {alone}", f"；{alone}") if alone else ""
        en = f"The {units} units have no missing effect in common that repeats in their runs{beside}."
        return words.of(en, f"{units}个产品合并分析未见可重现的共同缺项{beside}。")
    effects = words.of("; and ", "；以及").join(_common(each, fleet, words) for each in fleet.effects)
    if any(_showing(fleet.by_unit.get(each.name, ())) < units for each in fleet.effects):
        en = f"In {units} units pooled, not all of which show it, the declared model lacks: {effects}."
        return words.of(en, f"{units}个产品合并分析（并非每个产品均有），已声明模型缺少：{effects}。")
    return words.of(
        f"The declared model lacks, in {units} units together: {effects}.",
        f"{units}个产品合并分析，已声明模型缺少：{effects}。",
    )


def _of_single_units(fleet: FleetDiagnosis, words: Wording) -> Iterator[str]:
    """What single units lack by themselves, and which have more noise than declared."""
    units_of: dict[str, list[str]] = {}
    for unit, names in fleet.own_findings.items():
        for name in names:
            units_of.setdefault(name, []).append(unit)
    for name, units in units_of.items():
        some = _some(units, words)
        yield words.of(
            f"of the units alone, {words.name(name)} is missing in {some}", f"单独诊断时{some}缺少{words.name(name)}"
        )
    noisy = [unit for unit, each in fleet.units.items() if each.verdict is ModelVerdict.UNEXPLAINED]
    if noisy:
        yield words.of(
            f"in {_some(noisy, words)} something is left that no effect explains",
            f"{_some(noisy, words)}尚有任何效应均不能解释的误差",
        )


def _some(units: Sequence[str], words: Wording) -> str:
    """The names of a few units; of many the first ones."""
    return words.listed(units[:_MOST_NAMED]) + (words.of(", ...", "……") if len(units) > _MOST_NAMED else "")


def _showing(rows: Sequence[UnitCoefficient]) -> int:
    """How many units have a common effect rather than not."""
    return sum(each.presence >= _PRESENT for each in rows)


def _common(found: FoundEffect, fleet: FleetDiagnosis, words: Wording) -> str:
    rows = fleet.by_unit.get(found.name, ())
    showing = _showing(rows)
    if showing < len(rows):
        named = _some([each.unit for each in rows if each.presence >= _PRESENT], words)
        text = words.effect(found) + words.of(
            f", shown by {showing} of {len(rows)} units{f' ({named})' if named else ''}; the mean over all of them is ",
            f"，{len(rows)}个产品中{showing}个有此效应{f'（{named}）' if named else ''}；全部产品的平均为",
        )
    else:
        text = f"{words.effect(found)}{words.of(': ', '：')}"
    text += words.coefficient(found)
    if found.confounded:
        others = words.listed([words.effect(other) for other in found.confounded], ("or", "或"))
        text += words.of(f", which these data cannot separate from {others}", f"（现有数据无法与{others}区分）")
    differing = words.listed([each.unit for each in rows if each.differs])
    if showing == len(rows) and rows and all(each.differs for each in rows):
        text += words.of(", which differs from unit to unit", "（各产品不一致）")
    elif showing == len(rows) and differing:
        text += words.of(f"; {differing} differs from the others", f"（{differing}与其他产品不同）")
    without = words.listed([each.unit for each in rows if each.presence < _ABSENT])
    if without:
        text += words.of(f"; probably none of it in {without}", f"（{without}很可能没有该效应）")
    if (over := fleet.over_units.get(found.name)) is not None:
        bounds = f"{number(over.spread_lo)} … {number(over.spread_hi)}"
        text += words.of(
            f"; over units it varies by {number(over.spread)} (standard deviation, 95 %: {bounds})",
            f"（产品间标准差{number(over.spread)}，95 %：{bounds}）",
        )
    return text


def fleet_rows(name: str, rows: Sequence[UnitCoefficient], words: Wording) -> TextTable:
    """A common effect in each unit."""
    yes = words.of("yes", "是")
    same = ("p that it equals that of the others", "与其他产品相同的p值")
    return TextTable(
        words.of(f"{words.name(name)} in each unit", f"各产品的{words.name(name)}"),
        words.each(
            ("unit", "产品"), ("coefficient", "系数"), ("±", "±"), same, ("differs", "不同"), ("has it", "有此效应")
        ),
        tuple(
            (
                each.unit,
                number(each.coefficient),
                number(each.se),
                number(each.p_value),
                yes if each.differs else "",
                f"{each.presence:.0%}",
            )
            for each in rows
        ),
    )


def unit_rows(found: UnitsDiagnosis, words: Wording) -> TextTable:
    """The verdict of each unit, and whether its findings are significant among so many units."""
    rows = []
    for unit, each in found.units.items():
        diagnosis, own = each.diagnosis, Wording(words.language, each.data.runs[0])
        effects = "; ".join(f"{own.effect(effect)}: {own.coefficient(effect)}" for effect in diagnosis.by_size)
        verdict = words.of(diagnosis.verdict.value.replace("_", " "), _ZH_VERDICTS[diagnosis.verdict])
        significant = words.of("yes", "是") if unit in found.own_findings else words.of("no", "否")
        rows.append((unit, verdict, effects, significant if effects else ""))
    rows += [(unit, words.of("failed", "失败"), why, "") for unit, why in found.failed.items()]
    significant_head = ("significant among so many units", "多重比较后显著")
    head = words.each(("unit", "产品"), ("verdict", "判定"), ("found", "发现"), significant_head)
    return TextTable(words.of("Each unit alone", "各产品单独诊断"), head, tuple(rows))
