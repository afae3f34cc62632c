"""Yields on the terminal: the table, and sentences on what is not in it."""

from collections.abc import Iterable
from typing import Any

from analytics.commands.evaluation.verdict_words import ZH, group_name, name_of_metric, table_of
from stream.terminal.console import results
from stream.terminal.result_table import ResultTable

_SHOWN_PARTLY = 12


def print_yield(shares: list[dict[str, Any]], by: str, language: str) -> None:
    """Print the yield of each group, and what is not in it."""
    from analytics.evaluation.table import reason_of

    console = results()
    console.print(_yield_table(shares, by, language))
    if without := sum(row["no_data"] for row in shares):
        of = sum(row["units"] for row in shares)
        text = f"The yield is of units that were judged: {without} of {of} are NO_DATA and not in it"
        zh = f"合格率仅统计已判定的产品：{of} 个中有 {without} 个无数据，未计入"
        if by != "all":
            text += f"; a unit counts in each {by} in which it was measured"
            zh += f"；产品在其测量过的每个{ZH[by]}中各计一次"
        console.print(text if language == "en" else zh)
    for line in _of_repeats(shares, by, language):
        console.print(line)
    if unjudged := sorted({unit for row in shares for unit in row["unjudged"]}):
        console.print(_unjudged(unjudged, language))
    for text in sorted({text for row in shares for text in row["withdrawn"]}):
        console.print(reason_of({"reason": f"{text}, and still judges this, which was recorded before"}, language))
    partly = [row for row in shares if row["not_all_limits"]]
    for row in partly[:_SHOWN_PARTLY]:
        console.print(_not_all_limits(row, by, language))
    if len(partly) > _SHOWN_PARTLY:
        rest = len(partly) - _SHOWN_PARTLY
        console.print(
            f"以及另外 {rest} 组（--json 给出全部）" if language == "zh" else f"and {rest} more (--json gives all)"
        )


def _of_repeats(shares: list[dict[str, Any]], by: str, language: str) -> list[str]:
    """How many units pass by the first, and by the last, value of each limit, where this is not the same."""
    found = []
    for row in shares:
        name, counts = _group_of(row, by, language), {"first": "", "latest": ""}
        for which in counts if {row["first_passed"], row["latest_passed"]} != {row["passed"]} else ():
            passed, of = row[f"{which}_passed"], row[f"{which}_judged"]
            among = f"{passed}/{of}" if language == "zh" else f"{passed} of {of}"
            counts[which] = f"{among} ({passed / of:.1%})" if of else among
        if not counts["first"]:
            continue
        if language == "zh":
            found.append(f"{name}：首次测量合格 {counts['first']}，最近测量合格 {counts['latest']}")
        else:
            found.append(f"{name}: {counts['first']} pass by their first values, {counts['latest']} by their latest")
    more = len(found) - _SHOWN_PARTLY
    if more > 0:
        rest = f"以及另外 {more} 组（--json 给出全部）" if language == "zh" else f"and {more} more (--json gives all)"
        return [*found[:_SHOWN_PARTLY], rest]
    return found


def _unjudged(units: list[str], language: str) -> str:
    """That units have values that nothing judges."""
    names = ", ".join(units[:_SHOWN_PARTLY]) + (", ..." if len(units) > _SHOWN_PARTLY else "")
    if language == "zh":
        return f"{len(units)} 个产品有已测但无从判定的数值，因而不判为合格：{names}（原因见 `gyrofleet verdicts`）"
    have = "1 unit has values" if len(units) == 1 else f"{len(units)} units have values"
    return f"{have} that nothing judges, so that no PASS stands: {names} (`gyrofleet verdicts` has the reason)"


def _not_all_limits(row: dict[str, Any], by: str, language: str) -> str:
    """That units passed by some of their limits only."""
    metrics = ", ".join(name_of_metric(metric, language) for metric in row["not_judged"])
    n, passed = row["not_all_limits"], row["passed"]
    if language == "zh":
        return f"{_group_of(row, by, language)}：{passed} 个合格产品中有 {n} 个在该处未按其全部限值判定（{metrics}）"
    return (
        f"{_group_of(row, by, language)}: {n} of {passed} units that passed were not judged there by every limit "
        f"that they were judged by elsewhere ({metrics})"
    )


def _group_of(row: dict[str, Any], by: str, language: str) -> str:
    """The name of a group at the head of a sentence."""
    name = group_name(row, language)
    if by == "all":
        return name.removesuffix("all") + ("全部产品" if language == "zh" else "all units")
    return name if language == "zh" else f"{by} {name}"


def _yield_table(rows: Iterable[dict[str, Any]], by: str, language: str) -> ResultTable:
    counted_as = ("passed units", "failed units", "marginal units", "units without data")
    titles = (by, "units", *counted_as, "yield", "95 % interval") if language == "zh" else (
        by, "units", "passed", "failed", "marginal", "no data", "yield", "95 % interval"
    )  # fmt: skip
    table = table_of(titles, language)
    for row in rows:
        counts = (str(row[name]) for name in ("units", "passed", "failed", "marginal", "no_data"))
        share = ("", "") if row["yield"] is None else (
            f"{row['yield']:.1%}", f"{row['yield_lo']:.1%} .. {row['yield_hi']:.1%}"
        )  # fmt: skip
        table.add_row(group_name(row, language), *counts, *share)
    return table
