"""The next test as a sentence and a table."""

from analytics.loop.next_test.plans import WANTED_POWER
from analytics.loop.next_test.recommendation import NextTest
from analytics.loop.report.report_tables import TextTable
from analytics.loop.report.wording import Wording


def next_test_sentence(found: NextTest, words: Wording) -> str:
    """What the next test has to decide, and the cheapest one."""
    names = words.of(" or ", "还是").join(_named(each, found, words) for each in found.rivals)
    if found.question == "which":
        asked = words.of(f"Next test: which of these is at work: {names}.", f"下一项试验：起作用的是{names}？")
    else:
        asked = words.of(
            f"Next test: is {names} seen again in other runs?", f"下一项试验：{names}能否在其他试验中重现？"
        )
    if found.why_not is not None:
        return f"{asked} {words.text(found.why_not)}"
    first = found.plans[0]
    hours, power = f"{first.hours:.3g} h", f"{first.power:.0%}"
    times = f"{first.test.repeats} x " if first.test.repeats > 1 else ""
    what = words.text(first.test.what)
    if first.power < WANTED_POWER:
        answer = words.of(
            f"No test within the bounds of the station reaches a power of {WANTED_POWER:.0%}. The most powerful: "
            f"{times}{what}: {hours}, power {power}.",
            f"台站能力范围内没有试验能达到{WANTED_POWER:.0%}的判别功效。功效最高者：{times}{what}：{hours}，功效{power}。",
        )
    else:
        answer = words.of(
            f"The cheapest: {times}{what}: {hours}, decides with a power of {power}.",
            f"耗时最短者：{times}{what}：{hours}，判别功效{power}。",
        )
    if found.repeat is None:
        more = words.of("No repetition of a run decides it.", "重复已做的试验均不能判别。")
    else:
        more = words.of(
            f"Repeating what was run takes {found.repeat.hours:.3g} h.", f"重复已做的试验需{found.repeat.hours:.3g} h。"
        )
    return f"{asked} {answer} {more}"


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
        ("procedure", "试验程序"), ("what is done", "内容"), ("runs", "次数"), ("hours", "小时"), ("power", "功效"),
        ("separation", "区分度"),
    )  # fmt: skip
    rows = [
        (each.test.name, words.text(each.test.what), str(each.test.repeats), f"{each.hours:.3g}", f"{each.power:.2f}",
         f"{each.separation:.3g}")
        for each in found.plans
    ]  # fmt: skip
    return TextTable(words.of("Plans of the next test", "下一项试验的方案"), head, tuple(rows))


def afterwards(found: NextTest, words: Wording) -> str:
    """How to diagnose with the new runs."""
    holdout = f" --holdout runs={','.join(found.holdout)}" if found.holdout else ""
    return words.of(
        f"After it: the same `gyrofleet diagnose` command{holdout}.",
        f"完成后：再次执行同一`gyrofleet diagnose`命令{holdout}。",
    )
