"""The effects common to several units, and the units that differ: one sentence and tables."""

from collections.abc import Sequence

from analytics.loop.report.report_tables import TextTable
from analytics.loop.report.wording import Wording, number
from analytics.loop.tracing.fleet import FleetDiagnosis, UnitCoefficient
from analytics.loop.tracing.result.diagnosis_result import ModelVerdict
from analytics.loop.tracing.result.finding import FoundEffect
from analytics.loop.unit_diagnosis import UnitsDiagnosis

_ZH_VERDICTS = {
    ModelVerdict.NOTHING_MISSING: "无缺项",
    ModelVerdict.EFFECT_FOUND: "发现效应",
    ModelVerdict.CONFOUNDED: "无法区分",
    ModelVerdict.UNREPLICATED: "未重现",
    ModelVerdict.UNKNOWN_FUNCTION: "未知函数",
    ModelVerdict.UNEXPLAINED: "未解释",
    ModelVerdict.NOT_ENOUGH_DATA: "数据不足",
}


def fleet_sentence(fleet: FleetDiagnosis, words: Wording) -> str:
    """The common effects, and how many units differ."""
    units = len(fleet.units)
    if fleet.verdict is ModelVerdict.NOT_ENOUGH_DATA:
        why = words.of("; ", "；").join(map(words.text, fleet.limits))
        return words.of(f"Not enough data to pool: {why}.", f"数据不足，无法汇总：{why}。")
    if not fleet.effects:
        return words.of(
            f"The {units} units have no missing effect in common that repeats in their runs.",
            f"{units}个产品合并分析未见可重现的共同缺项。",
        )
    effects = words.of("; and ", "；以及").join(_common(each, fleet, words) for each in fleet.effects)
    return words.of(
        f"The declared model lacks, in {units} units together: {effects}.",
        f"{units}个产品合并分析，已声明模型缺少：{effects}。",
    )


def _common(found: FoundEffect, fleet: FleetDiagnosis, words: Wording) -> str:
    text = f"{words.effect(found)}{words.of(': ', '：')}{words.coefficient(found)}"
    if found.confounded:
        others = words.listed([words.effect(other) for other in found.confounded], ("or", "或"))
        text += words.of(f", which these data cannot separate from {others}", f"（现有数据无法与{others}区分）")
    rows = fleet.by_unit.get(found.name, ())
    differing = words.listed([each.unit for each in rows if each.differs])
    if rows and all(each.differs for each in rows):
        text += words.of(", which differs from unit to unit", "（各产品不一致）")
    elif differing:
        text += words.of(f"; {differing} differs from the others", f"（{differing}与其他产品不同）")
    return text


def fleet_rows(name: str, rows: Sequence[UnitCoefficient], words: Wording) -> TextTable:
    """A common effect in each unit."""
    yes = words.of("yes", "是")
    return TextTable(
        words.of(f"{words.name(name)} in each unit", f"各产品的{words.name(name)}"),
        (
            words.of("unit", "产品"),
            words.of("coefficient", "系数"),
            "±",
            words.of("p that it equals that of the others", "与其他产品相同的p值"),
            words.of("differs", "不同"),
        ),
        tuple(
            (each.unit, number(each.coefficient), number(each.se), number(each.p_value), yes if each.differs else "")
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
    return TextTable(
        words.of("Each unit alone", "各产品单独诊断"),
        (
            words.of("unit", "产品"),
            words.of("verdict", "判定"),
            words.of("found", "发现"),
            words.of("significant among so many units", "多重比较后显著"),
        ),
        tuple(rows),
    )
