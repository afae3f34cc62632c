"""The command `gyrofleet verdicts`: which units are good by their specifications, and what the others fail by."""

import json
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from analytics.commands.evaluation.engine_option import compute_by_engine, engine_option
from analytics.commands.evaluation.metrics import language_option, warn_of_failed
from analytics.commands.evaluation.plants import named, of_plants, with_plant
from analytics.commands.evaluation.verdict_words import coloured, group_name, name_of_metric, table_of, verdict_text
from analytics.commands.evaluation.yields import print_yield
from storage.commands.stored_names import UNIT
from stream.errors import BadInput, NotFound
from stream.terminal.console import counted, notes, print_json, reporting, results, store_option
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from analytics.specifications.verdicts import Group, Verdicts
    from storage.sql.catalog import Catalog

_FAILED, _NOT_JUDGED = 3, 4
_KINDS = ("all", "product", "lot", "station", "fixture", "day", "week", "month")
_SHOWN = 200


def _not_empty(context: click.Context, option: click.Parameter, value: str) -> str:
    """Refuse an empty name, as of a shell variable that is not set: it would choose nothing and give all."""
    if not value and context.get_parameter_source(str(option.name)) is click.core.ParameterSource.COMMANDLINE:
        raise click.BadParameter(
            f"it is empty: leave it out for all, or give '(not given)' for what has no {option.name}", context, option
        )
    return value


@click.command("verdicts")
@store_option
@click.option(
    "--unit", "units", type=UNIT, multiple=True, help="Only this unit, with each of its values; may be repeated."
)
@click.option("--by", type=click.Choice(_KINDS), help="Yield of each of these instead; `all`: of all units.")
@click.option("--product", default="", callback=_not_empty, help="With --by: only what was measured of this product.")
@click.option("--lot", default="", callback=_not_empty, help="With --by: only this lot.")
@click.option("--station", default="", callback=_not_empty, help="With --by: only this station.")
@click.option("--fixture", default="", callback=_not_empty, help="With --by: only this fixture.")
@click.option(
    "--since", default="", help="With --by: only runs that began then or later, as 2026-11-21, a day of the station."
)
@click.option("--risks", is_flag=True, help="Consumer's and producer's risk of each limit over each lot instead.")
@click.option("--fail-on-fail", is_flag=True, help="End with exit code 3 where a unit fails.")
@click.option("--fail-on-no-data", is_flag=True, help="End with exit code 4 where a unit is NO_DATA.")
@engine_option
@language_option
@reporting
def verdicts(
    folder: Path, units: tuple[str, ...], by: Any, product: str, lot: str, station: str, fixture: str, since: str,
    engine: str | None, language: str, *, risks: bool, fail_on_fail: bool, fail_on_no_data: bool, as_json: bool,
) -> None:  # fmt: skip
    """PASS, FAIL, MARGINAL or NO_DATA by the product specifications (`gyrofleet limits`), and the reasons.

    A value passes or fails only where its whole 95 % interval lies on one side of the limit, unless the limit has
    another decision_rule. Each is judged by the
    revision that was valid when its run began. A unit's verdict is the worst of its limits.
    """
    from analytics.evaluation.selection import day_or_moment
    from analytics.specifications.risks import lot_risks
    from analytics.specifications.verdicts import Group, failures_in, verdicts_of, yield_by

    since_day, since_ns = day_or_moment(since)
    group = Group(
        product=product, lot=lot, station=station, fixture=fixture, since_ns=since_ns, since_day=since_day
    )  # fmt: skip
    if group != Group() and not by:
        raise BadInput(
            "--product, --lot, --station, --fixture and --since choose what a yield is of: give --by as well"
        )
    if by and units:
        raise BadInput("give --unit or --by, not both: the yield is that of all units")
    if risks and (units or by):
        raise BadInput("--risks stands alone: it is of all units, by lot")

    def ask(catalog: "Catalog") -> "tuple[Verdicts, list[dict[str, Any]], list[dict[str, Any]]]":
        compute_by_engine(catalog, engine)
        of_units = verdicts_of(catalog, units, with_values=bool(units) or (as_json and not by))
        warn_of_failed(catalog)
        if group != Group():
            of_units = of_units._replace(pareto=failures_in(catalog, group))
        shares = yield_by(catalog, by, group) if by else []
        if group != Group() and not shares:
            raise NotFound(_nothing_in(catalog, group))
        return of_units, shares, lot_risks(catalog) if risks else []

    answers = of_plants(folder, ask, quiet=as_json)
    found = _joined([(plant, of_units) for plant, (of_units, _, _) in answers])
    shares = [row for plant, (_, rows, _) in answers for row in with_plant(plant, rows)]
    of_lots = [row for plant, (_, _, rows) in answers for row in with_plant(plant, rows)]
    if risks:
        _print_risks(of_lots, language, as_json=as_json)
        return
    if as_json:
        rest = {"pareto": found.pareto, "warnings": found.warnings}
        if by:
            print_json({"by": by, "yield": shares, **rest})
        else:
            documents = [row | {"parameters": json.loads(row["parameters"] or "{}")} for row in found.verdicts]
            print_json({"units": found.units, "verdicts": documents, **rest})
    else:
        _print(found, shares, by, language, with_values=bool(units))
    if fail_on_fail and found.has("FAIL"):
        sys.exit(_FAILED)
    if fail_on_no_data and found.has("NO_DATA"):
        sys.exit(_NOT_JUDGED)


def _nothing_in(catalog: "Catalog", group: "Group") -> str:
    """That nothing was measured in a group, with the names that there are."""
    from analytics.metric_registry.registry import alike
    from analytics.specifications.verdicts import UNGIVEN

    for kind in ("product", "lot", "station", "fixture"):
        if name := getattr(group, kind):
            rows = catalog.rows(f"select distinct coalesce({kind}, $1) from verdicts order by all", [UNGIVEN])  # noqa: S608
            known = [str(each) for (each,) in rows]
            if name not in known:
                return f"nothing was judged of {kind} {name!r}; {alike(name, known, f'{kind}s are')}"
    return "nothing was judged in this group: leave out some of --product, --lot, --station, --fixture and --since"


def _joined(of_plants: "Iterable[tuple[str, Verdicts]]") -> "Verdicts":
    from analytics.specifications.verdicts import Verdicts

    joined = Verdicts([], [], [], [])
    for plant, found in of_plants:
        for rows, own in zip(joined, found, strict=True):
            rows += with_plant(plant, own)
    return joined


def _print_risks(rows: list[dict[str, Any]], language: str, *, as_json: bool) -> None:
    if as_json:
        print_json({"risks": rows})
        return
    from analytics.trends.words import words

    titles = ("lot", "characteristic", "revision", "rule", "accepted", "rejected", "consumer", "producer", "of process")
    table = table_of(titles, language)
    for row in rows:
        of = row["subject"].removeprefix(row["metric"])
        revision = f"{row['specification']}-{row['revision'] or '?'}"
        process = (row["process_consumer_risk"], row["process_producer_risk"])
        rule = words(f"rule_{row['decision_rule']}").zh if language == "zh" else row["decision_rule"]
        table.add_row(
            group_name(row, language, "lot"), name_of_metric(row["metric"], language) + of, revision,
            rule, str(row["accepted"]), str(row["rejected"]),
            _risk(row["specific_consumer_risk"], row["global_consumer_risk"]),
            _risk(row["specific_producer_risk"], row["global_producer_risk"]),
            "" if None in process else f"{process[0]:.2%} / {process[1]:.2%}",
        )  # fmt: skip
    if not rows:
        none = "No value is judged by a limit, so no risk is known: `gyrofleet verdicts` gives the reasons."
        results().print("没有按限值判定的数值，风险未知：原因见 `gyrofleet verdicts`。" if language == "zh" else none)
        return
    results().print(table)
    text = "Risks: largest of a unit / of the lot; of process: consumer / producer, true values taken as normal."
    zh = "风险：单件最大值 / 批次总体；过程：使用方 / 生产方，假设真值服从正态分布。"
    results().print(zh if language == "zh" else text)


def _risk(specific: float | None, overall: float) -> str:
    return f"{'-' if specific is None else f'{specific:.2%}'} / {overall:.2%}"


def _print(found: "Verdicts", shares: list[dict[str, Any]], by: Any, language: str, *, with_values: bool) -> None:
    console = results()
    if by:
        print_yield(shares, by, language)
    else:
        console.print(_unit_table(found.units[:_SHOWN], language))
        if with_values:
            console.print(_value_table(found.verdicts, language))
        counts = Counter(row["verdict"] for row in found.units)
        summary = ("，" if language == "zh" else ", ").join(
            f"{n} {verdict_text(name, language)}" for name, n in sorted(counts.items())
        )
        more = ""
        if len(found.units) > _SHOWN:
            more = (
                f"（显示前 {_SHOWN} 个，--json 给出全部）"
                if language == "zh"
                else f" (the first {_SHOWN} shown; --json gives all)"
            )
        units = counted(len(found.units), "unit") if language == "en" else f"{len(found.units)} 个产品"
        console.print(f"{units}：{summary}{more}" if language == "zh" else f"{units}: {summary}{more}")
    if found.pareto and not with_values:
        console.print(_pareto_table(found.pareto, language))
    for row in found.warnings:
        reason = row["reason_zh"] if language == "zh" else row["reason"]
        before = "警告：产品" if language == "zh" else "warning: unit"
        colon = "：" if language == "zh" else ": "
        notes().print(f"{before} {named(row, 'unit')}{colon}{reason}", soft_wrap=True)


def _conformity(row: dict[str, Any], language: str) -> str:
    """The probability of conformity, marked where nothing but the scatter of the value is in it."""
    if row["conformity"] is None:
        return ""
    of = {"en": " (type A)", "zh": "（A类）"}[language] if row["conformity_of"] == "type A only" else ""
    return f"{row['conformity']:.1%}{of}"


def _unit_table(units: Iterable[dict[str, Any]], language: str) -> ResultTable:
    from analytics.evaluation.table import reason_of

    counted_as = ("passed", "failed", "marginal", "no data")
    table = table_of(("unit", "product", "lot", "verdict", "latest", *counted_as, "reason"), language)
    for row in units:
        counts = (str(row[name]) for name in ("passed", "failed", "marginal", "no_data"))
        parts = (_reasons_text(row, language), reason_of(row, language) if row["reason"] else "")
        why = "; ".join(part for part in parts if part)
        table.add_row(
            named(row, "unit"), row["product"], row["lot"], coloured(row["verdict"], language),
            coloured(row["latest_verdict"], language), *counts, why,
        )  # fmt: skip
    return table


def _reasons_text(row: dict[str, Any], language: str) -> str:
    """What a unit fails by, what is undecided, and what is lacking."""
    parts = (("FAIL", row["failures"]), ("MARGINAL", row["undecided"]), ("NO_DATA", row["lacking"]))
    colon, comma, apart = ("：", "、", "；") if language == "zh" else (": ", ", ", "; ")
    return apart.join(
        f"{verdict_text(verdict, language)}{colon}{comma.join(name_of_metric(metric, language) for metric in which)}"
        for verdict, which in parts
        if which
    )


def _value_table(rows: Iterable[dict[str, Any]], language: str) -> ResultTable:
    from analytics.evaluation.selection import with_year
    from analytics.evaluation.table import format_limits, format_number, format_parameters, reason_of
    from stream.quantities import format_unit

    table = table_of(
        (
            "characteristic", "signal", "run", "value", "95 % interval", "limits", "verdict", "conformity", "standard",
            "revision", "reason",
        ),
        language,
    )  # fmt: skip
    several = "几次试验合计" if language == "zh" else "over several runs"
    for row in rows:
        half = None if row["lo"] is None else (row["hi"] - row["lo"]) / 4
        unit = format_unit(row["unit_of_measure"])
        value = "" if row["value"] is None else f"{format_number(row['value'], half)} {unit}".strip()
        interval = "" if row["lo"] is None else f"{format_number(row['lo'], half)} .. {format_number(row['hi'], half)}"
        parameters = format_parameters(json.loads(row["parameters"] or "{}"), language)
        of_plant = f"{row['plant']}: " if "plant" in row else ""
        label = f"{row['specification']}-{row['revision'] or '?'}" if row["specification"] else ""
        mark = "（已撤销）" if language == "zh" else " (withdrawn)"
        why = "; ".join(reason_of({"reason": each}, language) for each in (row["reason"], row["withdrawn"]) if each)
        table.add_row(
            of_plant + name_of_metric(row["metric"], language) + (f" ({parameters})" if parameters else ""),
            row["signal"], row["run"] or (several if len(row["runs"]) > 1 else ""), value, interval,
            f"{format_limits(row)} {unit}".strip(), coloured(row["verdict"], language),
            _conformity(row, language), with_year(row["standard"] or ""),
            label + (mark if row["withdrawn"] else ""), why,
        )  # fmt: skip
    return table


def _pareto_table(rows: Iterable[dict[str, Any]], language: str) -> ResultTable:
    titles = ("fails by", "failed", "marginal", "judged", "share", "cumulative")
    if language == "zh":
        titles = ("fails by", "failed units", "marginal units", "judged", "share", "cumulative")
    table = table_of(titles, language)
    for row in rows:
        of = row["subject"].removeprefix(row["metric"])
        name = named(row, language) + ("" if row["subject"] == "entered" else of)
        counts = (str(row[name]) for name in ("failed", "marginal", "judged"))
        table.add_row(name, *counts, f"{row['share']:.0%}", f"{row['cumulative_share']:.0%}")
    return table
