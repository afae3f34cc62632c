"""The next test as a sentence and a table."""

from analytics.loop.effects.channel_names import channel_name
from analytics.loop.next_test.decisions import AT_REST, DRIVEN
from analytics.loop.next_test.plans import WANTED_POWER, TestPlan
from analytics.loop.next_test.recommendation import NextTest
from analytics.loop.report.report_tables import TextTable
from analytics.loop.report.wording import Wording


def next_test_sentence(found: NextTest, words: Wording) -> str:
    """What the next test has to decide, and the cheapest one."""
    asked = _asked(found, words)
    if found.why_not is not None:
        return f"{asked} {words.text(found.why_not)}"
    first = found.plans[0]
    hours = f"{first.hours:.3g} h"
    times = f"{first.test.repeats} x " if first.test.repeats > 1 else ""
    what, powers = words.text(first.test.what), _powers(first, words)
    if not first.is_enough:
        answer = words.of(
            f"No test within the bounds of the station reaches a power of {WANTED_POWER:.0%} for each of them. The "
            f"most powerful: {times}{what}: {hours}, decides with {powers}.",
            f"试验台能力范围内没有试验能对每一种情形都达到{WANTED_POWER:.0%}的判别功效。功效最高者：{times}{what}：{hours}，"
            f"判别功效{powers}。",
        )
    else:
        answer = words.of(
            f"The cheapest: {times}{what}: {hours}, decides with {powers}.",
            f"耗时最短者：{times}{what}：{hours}，判别功效{powers}。",
        )
    if found.question == "excess":
        return f"{asked} {answer}"
    if found.repeat is None:
        more = words.of("No repetition of a run decides it.", "重复已做的试验均不能判别。")
    else:
        more = words.of(
            f"Repeating what was run takes {found.repeat.hours:.3g} h.", f"重复已做的试验需{found.repeat.hours:.3g} h。"
        )
    return f"{asked} {answer} {more}"


def _asked(found: NextTest, words: Wording) -> str:
    """The question."""
    if found.question == "none":
        return words.of("Next test:", "下一项试验：")
    if found.question == "excess":
        return words.of(
            "Next test: is the unexplained noise there at rest, with everything held, or only in runs that move "
            "something?",
            "下一项试验：未能解释的噪声在一切保持不变的静止状态下是否仍存在，还是仅在有变化的试验中出现？",
        )
    names = words.of(" or ", "还是").join(_named(each, found, words) for each in found.rivals)
    if found.question == "which":
        text = words.of(f"which of these is at work: {names}", f"起作用的是{names}？")
    elif found.question == "form":
        channels = words.of(", ", "、").join(words.of(*channel_name(each)) for each in found.channels)
        text = words.of(
            f"no known form fits the dependence on {channels}; is its curve ({names}) seen again while the rest is "
            "held?",
            f"已知形式均不符合对{channels}的依赖；其他条件不变时，该曲线（{names}）能否重现？",
        )
    else:
        text = words.of(f"is {names} seen again in other runs?", f"{names}能否在其他试验中重现？")
    units = len(found.units)
    whose = words.of(f" (with {units} units)", f"（{units}个产品）") if units else ""
    end = words.of("." if found.question == "which" else "", "")
    return words.of(f"Next test{whose}: {text}{end}", f"下一项试验{whose}：{text}")


def _powers(plan: TestPlan, words: Wording) -> str:
    """Power if each of the rivals is true, such as ``93% if A, 88% if B``; what it does not promise comes last."""
    if len(plan.by_truth) < 2:
        return words.of(f"a power of {plan.power:.0%}", f"{plan.power:.0%}")
    parts, not_counted = [], []
    for name, power in plan.by_truth.items():
        whose = _truth(name, words)
        if power < plan.assured:
            not_counted.append(words.of(f"{whose} ({power:.0%})", f"{whose}（{power:.0%}）"))
        else:
            parts.append(words.of(f"{power:.0%} if {whose}", f"{power:.0%}（若为{whose}）"))
    text = words.of(", ", "、").join(parts)
    if not not_counted:
        return text
    rest = words.of(", ", "、").join(not_counted)
    return text + words.of(
        f"; it does not count on {rest}, of a weight below 5 % so far", f"；未计入目前权重低于5 %的{rest}"
    )


def _truth(name: str, words: Wording) -> str:
    """A rival as the truth."""
    if name == AT_REST:
        return words.of("it is there at rest", "静止时也存在")
    if name == DRIVEN:
        return words.of("it is not", "静止时不存在")
    return words.name(name)


def _named(rival: str, found: NextTest, words: Wording) -> str:
    """A rival with those that no run separates from it."""
    if not (others := found.twins.get(rival)):
        return words.name(rival)
    listed = words.of(", ", "、").join(map(words.name, others))
    return words.of(
        f"{words.name(rival)} (or, alike in every run, {listed})",
        f"{words.name(rival)}（或任何试验中均相同的{listed}）",
    )


def next_test_rows(found: NextTest, words: Wording) -> TextTable:
    """The plans, the first one recommended."""
    head = words.each(
        ("procedure", "试验方法"), ("what is done", "内容"), ("runs", "次数"), ("hours", "小时"), ("power", "功效"),
        ("least power", "最小功效"), ("power if it is", "各情形的功效"), ("separation", "区分度"),
    )  # fmt: skip
    rows = [
        (each.test.name, words.text(each.test.what), str(each.test.repeats), f"{each.hours:.3g}", f"{each.power:.2f}",
         f"{each.assured:.2f}", _by_truth(each, words),
         f"{each.separation:.3g}")
        for each in found.plans
    ]  # fmt: skip
    return TextTable(words.of("Plans of the next test", "下一项试验的方案"), head, tuple(rows))


def _by_truth(plan: TestPlan, words: Wording) -> str:
    return words.of(", ", "、").join(f"{_truth(name, words)}: {power:.2f}" for name, power in plan.by_truth.items())


def bounds_sentence(found: NextTest, words: Wording) -> str | None:
    """What the plans keep to, and where each bound comes from."""
    if found.bounds is None:
        return None
    sources = {
        "runs": words.of("the runs so far", "已做试验"),
        "station": words.of("the station file", "试验台文件"),
        "given": "--bounds",
        "default": words.of("default", "默认值"),
    }
    parts = [
        f"{name} {each['value']:g} {each['unit_of_measure']} ({sources[each['from']]})"
        for name, each in found.bounds.document().items()
    ]
    text = words.of("Bounds of the station: ", "试验台能力范围：") + words.of(", ", "、").join(parts)
    if any(each["from"] == "station" for each in found.bounds.document().values()):
        text += words.of(
            "; what the station file gives may be more than the unit withstands: compare it with its specification",
            "；试验台文件所给范围可能超出产品承受能力：请与产品技术指标核对",
        )
    return text + words.of(".", "。")


def afterwards(found: NextTest, words: Wording) -> str:
    """How to diagnose with the new runs."""
    if found.question == "excess":
        return words.of(
            "After it: `gyrofleet diagnose` with the same noise and --run NEW-RUN alone: unexplained means that it is "
            "there at rest (more noise than declared, or a cause that is not recorded), nothing_missing that what the "
            "other runs move brings it: record that.",
            "完成后：以相同噪声单独诊断新试验（--run 新试验）：结论为unexplained则静止时也存在"
            "（噪声大于声明值，或成因未记录）；为nothing_missing则由其他试验中变化的量引起，应加以记录。",
        )
    holdout = f" --holdout runs={','.join(found.holdout)}" if found.holdout else ""
    if found.question in ("again", "form"):
        holdout = words.of(" --holdout runs=NEW-RUN", " --holdout runs=新试验")
    return words.of(
        f"After it: the same `gyrofleet diagnose` command{holdout}.",
        f"完成后：再次执行同一`gyrofleet diagnose`命令{holdout}。",
    )
