"""The command `gyrofleet trend`: a metric over time, by unit, lot, station or fixture."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from analytics.commands.evaluation.engine_option import compute_by_engine, engine_option
from analytics.commands.evaluation.metrics import METRIC, language_option, opened_catalog
from storage.commands.stored_names import SIGNAL, UNIT
from stream.errors import BadInput
from stream.terminal.console import notes, print_json, reporting, results, store_option
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from analytics.trends.trend import Trend

_NONE = "\N{EN DASH}"
_SHOWN_ROWS = 40
_TITLES = {
    "en": ("points", "centre", "sigma", "lower limit", "upper limit", "state", "rules met (times)"),
    "zh": ("点数", "中心线", "σ", "下控制限", "上控制限", "状态", "判异准则（次数）"),
}


@click.command("trend")
@click.argument("metric", type=METRIC, required=False)
@click.option("--metric", "named", type=METRIC, help="The metric; the same as the argument METRIC.")
@click.option(
    "--by", type=click.Choice(["unit", "product", "lot", "station", "fixture"]),
    help="One chart for each; by default one chart with the first value of each unit.",
)  # fmt: skip
@store_option
@click.option("--unit", "units", type=UNIT, multiple=True, help="Only this unit; may be given several times.")
@click.option("--signal", type=SIGNAL, help="Only this signal, as rate_x.")
@click.option("--lot", help="Only units of this lot.")
@click.option("--station", help="Only what this station measured.")
@click.option("--fixture", help="Only what was measured in this fixture.")
@click.option("--product", help="Only units of this product.")
@click.option("--standard", help="Only values of this standard: GJB2426A, JJF2014.")
@click.option("--parameter", "parameters", multiple=True, metavar="NAME=VALUE", help="Which kind, as average_s=100.")
@click.option("--since", help="Only values measured then or later: 2026-11-21, or with time and zone.")
@click.option("--baseline", type=click.IntRange(min=8), help="Limits from this many first points; by default all.")
@click.option(
    "--sigma", "spread", type=click.Choice(["median_moving_range", "moving_range", "deviation"]),
    default="median_moving_range", show_default=True,
    help="How the limits are computed; outliers change the median least.",
)  # fmt: skip
@click.option("--plot", "plot_path", type=click.Path(path_type=Path), help="Draw the charts: FILE.png or FILE.svg.")
@engine_option
@language_option
@reporting
def trend(
    metric: str | None, named: str | None, by: str | None, folder: Path, units: tuple[str, ...], signal: str | None,
    lot: str | None, station: str | None, fixture: str | None, product: str | None, standard: str | None,
    parameters: tuple[str, ...], since: str | None, baseline: int | None, spread: str, plot_path: Path | None,
    engine: str | None, language: str, *, as_json: bool,
) -> None:  # fmt: skip
    """A metric over time: control charts, changes, drift, differences between stations, capability.

    The report at the end has a sentence on each significant result: since when, which group differs, by how much.

    \b
    gyrofleet trend bias --by station --plot bias.png
    gyrofleet trend --metric bias --by lot
    gyrofleet trend bias_stability_averaged --parameter average_s=100
    gyrofleet trend scale_factor --unit FOG-0231 --lang zh
    """  # noqa: D301  click's mark for lines that are not to be joined
    from analytics.evaluation.selection import dated, standard_named
    from analytics.trends.charts.capability import specified_limits
    from analytics.trends.charts.control_chart import Spread
    from analytics.trends.document import document
    from analytics.trends.report import sentences
    from analytics.trends.series import Choice, read_series
    from analytics.trends.trend import trend_of

    metric = named if metric is None else metric
    if metric is None or named not in {None, metric}:
        raise BadInput("name one metric, as `gyrofleet trend bias` or `gyrofleet trend --metric bias`")
    if plot_path is not None:
        from analytics.plots.figure_file import check_suffix

        check_suffix(plot_path)
    choice = Choice(
        units=units, signal=signal, standard=None if standard is None else standard_named(standard),
        parameters=_pairs(parameters), lot=lot, station=station, fixture=fixture, product=product,
        since_ns=None if since is None else dated(since),
    )  # fmt: skip
    with opened_catalog(folder, quiet=as_json) as catalog:
        compute_by_engine(catalog, engine, [metric])
        series = read_series(catalog, metric, choice)
        found = trend_of(
            series, by=by, baseline=baseline, spread=Spread(spread),
            specification=specified_limits(catalog.store, series),
            limits_of=lambda part: specified_limits(catalog.store, part),
        )  # fmt: skip
    if plot_path is not None:
        from analytics.plots.trend_plot import plot_trend

        plot_trend(found, plot_path)
    if as_json:
        print_json(document(found))
        return
    results().print(_chart_table(found, language))
    results().print()
    for sentence in sentences(found):
        results().print(getattr(sentence, language), soft_wrap=True)
    if plot_path is not None:
        notes().print(f"plot: {plot_path}")


def _pairs(parameters: tuple[str, ...]) -> dict[str, str]:
    found = {}
    for text in parameters:
        name, equals, value = text.partition("=")
        if not equals or not name or not value:
            raise BadInput(f"--parameter {text!r} is not like average_s=100")
        found[name.strip()] = value.strip()
    return found


def _chart_table(found: "Trend", language: str) -> ResultTable:
    from analytics.evaluation.table import name_of
    from analytics.trends.chart_sentences import state_of
    from analytics.trends.words import NotComputed, figures, group_name
    from stream.quantities import format_unit

    unit = format_unit(found.series.unit_of_measure)
    metric = name_of(found.series.metric, language) if language == "zh" else found.series.metric
    table = ResultTable(title=f"{metric} / {unit}" if unit else metric)
    group = group_name(found.by or "")
    table.add_column(group.zh if language == "zh" else group.en)
    for title in _TITLES[language]:
        table.add_column(title, justify="right" if title not in {"state", "状态"} else "left")
    order = sorted(found.charts, key=lambda chart: (chart.in_control is not False, chart.in_control is None))
    for chart in order[:_SHOWN_ROWS]:
        cells = [_NONE] * 4
        if not isinstance(limits := chart.limits, NotComputed):
            three = (limits.centre, limits.lower, limits.upper)
            centre, lower, upper = (figures(each, limits.sigma / 10) for each in three)
            cells = [centre, f"{limits.sigma:.3g}", lower, upper]
        met = ", ".join(f"{rule} ({chart.counts[rule - 1]})" for rule in chart.signals) or _NONE
        state = getattr(state_of(chart), language)
        name = chart.name or {"en": "all units", "zh": "全部产品"}[language]
        table.add_row(name, str(chart.series.value.size), *cells, state, met)
    if len(order) > _SHOWN_ROWS:
        table.caption = f"{len(order) - _SHOWN_ROWS} more; --json has all"
    return table
