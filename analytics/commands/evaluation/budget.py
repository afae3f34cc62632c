"""The command `gyrofleet budget`: the uncertainty budget of a unit's measured values."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from analytics.commands.evaluation.metrics import METRIC, language_option, opened_catalog
from storage.commands.stored_names import RUN, UNIT
from stream.errors import BadInput
from stream.quantities import format_unit
from stream.terminal.console import notes, print_json, reporting, results, store_option
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from analytics.evaluation.budgets import ValueBudget
    from analytics.uncertainty.budget import Expanded
    from analytics.uncertainty.monte_carlo import Propagated

_TITLES = {
    "en": ("component", "type", "distribution", "u", "sensitivity", "contribution", "nu"),
    "zh": ("不确定度来源", "类别", "分布", "标准不确定度", "灵敏系数", "分量", "自由度"),
}
_WORDS = {
    "en": ("combined", "unknown", "no expanded uncertainty", "over several runs"),
    "zh": ("合成", "未知", "无扩展不确定度", "几次试验合计"),
}


@click.command("budget")
@store_option
@click.option("--unit", type=UNIT, required=True, help="The unit.")
@click.option("--metric", type=METRIC, required=True, help="The metric, as scale_factor.")
@click.option("--run", type=RUN, help="Only values that rest on this run; the latest first otherwise.")
@click.option("--standard", help="Only values of this standard: GJB2426A, JJF2014, JJF1536.")
@click.option("--k", "factor", type=float, help="Coverage factor; by default that of p = 95.45 %, 2 for large nu.")
@click.option("--p", "probability", type=float, help="Coverage probability, as 0.95, in place of --k.")
@click.option("--monte-carlo", is_flag=True, help="Check it by propagation of distributions (JCGM 101).")
@language_option
@reporting
def budget(
    folder: Path, unit: str, metric: str, run: str | None, standard: str | None, factor: float | None,
    probability: float | None, language: str, *, monte_carlo: bool, as_json: bool,
) -> None:  # fmt: skip
    """Uncertainty budget of a measured value: components of type A and B, u, nu, k, p and U (JJF 1059.1, JCGM 100).

    Type B components are those that the station's file states of its instruments. Where a component is unknown, there
    is no U, and the reason says why.

    \b
    gyrofleet budget --unit FOG-0231 --metric scale_factor
    gyrofleet budget --unit FOG-0231 --metric bias --run 2026-11-21-A --k 2 --json
    """  # noqa: D301  click's mark for lines that are not to be joined
    from analytics.evaluation.budgets import budget_document, value_budgets
    from analytics.evaluation.selection import standard_named
    from analytics.metric_registry.registry import check_metrics
    from analytics.uncertainty.monte_carlo import propagate

    check_metrics([metric])
    if factor is not None and probability is not None:
        raise BadInput("--k and --p exclude each other: one follows from the other and the degrees of freedom")
    if probability is not None and 1 < probability < 100:
        raise BadInput(f"--p {probability:g}: a probability is below 1, did you mean {probability / 100:g}?")
    with opened_catalog(folder, quiet=as_json) as catalog:
        found = value_budgets(catalog, unit, metric, run)
    if standard is not None:
        wanted = standard_named(standard)
        found = [each for each in found if wanted in each.standard.split(", ")]
        if not found:
            raise BadInput(f"unit {unit}, {metric}: no value of {standard}; leave out --standard")
    found.reverse()  # the latest first
    expanded = [each.expand(factor, probability) for each in found]
    checks = [
        propagate(each.budget, result.p) if monte_carlo and result is not None else None
        for each, result in zip(found, expanded, strict=True)
    ]
    if as_json:
        documents = [budget_document(*each) for each in zip(found, expanded, checks, strict=True)]
        print_json({"unit": unit, "metric": metric, **documents[0], "others": documents[1:]})
        return
    for each, result, check in zip(found, expanded, checks, strict=True):
        _print(unit, each, result, check, language)


def _print(
    unit: str, found: "ValueBudget", expanded: "Expanded | None", check: "Propagated | None", language: str
) -> None:
    from analytics.evaluation.reasons import in_chinese
    from analytics.evaluation.selection import with_year
    from analytics.evaluation.table import format_number, format_parameters
    from analytics.uncertainty.rounding import round_with

    combined, unknown, no_expanded, several = _WORDS[language]
    of, measure, is_zh = found.budget, format_unit(found.budget.unit), language == "zh"
    console = results()
    clause = f"{with_year(found.standard)} {found.clause}"
    console.print(f"{unit}  {of.zh if is_zh else of.en}  {found.run or several}  {clause}")
    console.print(format_parameters(found.parameters, language), style="dim")
    table = ResultTable(*_TITLES[language])
    for each in of.components:
        distribution = each.distribution.zh if is_zh else each.distribution.en
        table.add_row(
            each.zh if is_zh else each.en, each.evaluation, distribution, f"{each.u:.3g} {format_unit(each.unit)}",
            f"{each.sensitivity:.3g}", f"{each.contribution:.3g}", _freedom(each.freedom),
        )  # fmt: skip
    for lacking in of.unknown:
        table.add_row(lacking.zh if is_zh else lacking.en, "", unknown, "", "", "", "")
    if expanded is not None:
        table.add_row(combined, "", "", "", "", f"{expanded.u:.3g}", _freedom(expanded.freedom))
    console.print(table)
    if expanded is None:
        why = (f"{e.zh}：{in_chinese(e.reason)}" if is_zh else f"{e.en}: {e.reason}" for e in of.unknown)
        shown, colon, apart = (
            format_number(of.value, of.standard_uncertainty()),
            "：" if is_zh else ": ",
            "；" if is_zh else "; ",
        )
        measured = f"{shown} {measure}".strip()
        console.print(f"{measured}{apart}{no_expanded}{colon}{apart.join(why)}")
    else:
        value, half = round_with(of.value, expanded.expanded)
        stated, half = f"{value} {measure}".strip(), f"{half} {measure}".strip()
        line = f"{stated}, U = {half} (k = {expanded.k:.2f}, p = {100 * expanded.p:.2f} %)"
        console.print(f"{line}, {expanded.method}")
    if check is not None and expanded is not None:
        verdict = "confirms" if check.confirms(expanded) else "does not confirm"
        console.print(
            f"JCGM 101: u = {check.u:.3g}, "
            + f"{of.value + check.lo:.9g} .. {of.value + check.hi:.9g} {measure}".strip()
            + f", {check.trials:,} trials: {verdict} the first order"
        )
    for source in dict.fromkeys(each.source for each in of.components if each.evaluation == "B" and each.source):
        notes().print(f"type B: {source}", soft_wrap=True)


def _freedom(freedom: float) -> str:
    return "∞" if freedom == float("inf") else f"{freedom:.3g}"
