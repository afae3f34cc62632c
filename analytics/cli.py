"""Commands of what the samples mean: `gyrofleet allan` and `gyrofleet demo`."""

import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.table import Table

from stream.console import compile_kernels, notes, print_json, reporting, results, store_option
from stream.errors import BadInput, NotFound

if TYPE_CHECKING:
    from analytics.allan_curve import AllanCurve
    from analytics.demo import DemoState
    from analytics.noise_coefficients import NoiseCoefficients
    from storage.catalog import Catalog
    from stream.estimators.base import NoEstimate

_QUESTIONS = (
    "select unit, document->>'$.verdict' as verdict from events where kind = 'VerdictGiven' order by unit",
    "select unit, avg(value) * 3600 as bias_deg_per_h from samples where signal = 'rate' group by unit",
)


@click.command("allan")
@click.option("--unit", required=True, help="Which unit.")
@click.option("--signal", required=True, help="Which of its signals, as rate or rate_x.")
@click.option("--run", help="Which run; the one recorded last if left out.")
@store_option
@click.option(
    "--points-per-octave",
    type=click.Choice(["1", "2", "4", "8"]),
    default="1",
    show_default=True,
    help="Averaging times in an octave.",
)
@click.option("--resample", "resample_s", type=float, help="Take means of blocks of so many seconds first.")
@click.option("--plot", "plot_path", type=click.Path(path_type=Path), help="Draw the curve: FILE.png or FILE.svg.")
@click.option(
    "--compare", multiple=True, metavar="UNIT", help="Draw this unit beside it, lightly; 'all' for every one."
)
@click.option("--limits", "limits_path", type=click.Path(path_type=Path), help="Draw the limits of this TOML file in.")
@click.option("--fit", is_flag=True, help="Fit the noise coefficients of IEEE 952 to the curve; drawn in with --plot.")
@reporting
def allan(
    unit: str,
    signal: str,
    run: str | None,
    folder: Path,
    points_per_octave: str,
    resample_s: float | None,
    plot_path: Path | None,
    compare: tuple[str, ...],
    limits_path: Path | None,
    *,
    fit: bool,
    as_json: bool,
) -> None:
    """Overlapping Allan deviation of a recorded signal, with 95 % confidence limits.

    Limits are those of a screening: [[limit]] tables with characteristic, signal, tau_s, upper, unit_of_measure.
    """
    from analytics.allan_curve import allan_curve
    from analytics.limits import read_limits
    from analytics.noise_coefficients import curve_document
    from analytics.noise_table import noise_table
    from storage.catalog import Catalog
    from storage.store import Store
    from stream.estimators.base import NoEstimate

    if plot_path is None and (compare or limits_path):
        raise BadInput("--compare and --limits are drawn: give --plot FILE.png or FILE.svg as well")
    limits = () if limits_path is None else read_limits(limits_path).limits
    with Catalog(Store.open(folder)) as catalog:
        octave = int(points_per_octave)
        curve = allan_curve(catalog, unit, signal, run, points_per_octave=octave, resample_s=resample_s)
        others = [
            allan_curve(catalog, each, signal, curve.run, points_per_octave=octave, resample_s=resample_s)
            for each in _fleet(catalog, curve, compare)
        ]
        found = _noise(catalog, curve) if fit else None
    if plot_path is not None:
        from analytics.allan_plot import plot_allan

        drawn = None if isinstance(found, NoEstimate) else found
        plot_allan([*others, curve], plot_path, limits=limits, chosen=unit if others else None, found=drawn)
    if as_json:
        print_json(curve if found is None else curve_document(curve, found))
        return
    results().print(_curve_table(curve))
    if isinstance(found, NoEstimate):
        results().print(f"No noise coefficients (无噪声系数): {found.reason}", soft_wrap=True, markup=False)
    elif found is not None:
        results().print(noise_table(curve, found))
    if plot_path is not None:
        notes().print(f"plot: {plot_path}")


def _noise(catalog: "Catalog", curve: "AllanCurve") -> "NoiseCoefficients | NoEstimate":
    from analytics.noise_coefficients import noise_coefficients
    from analytics.normalised_walk import normalised_walk
    from storage.reading import find_signal

    record = find_signal(catalog, curve.unit, curve.signal, curve.run)
    return noise_coefficients(curve, normalised_walk(catalog, record))


def _fleet(catalog: "Catalog", curve: "AllanCurve", compare: tuple[str, ...]) -> list[str]:
    """Units to draw beside a curve: those named, or all that have the signal in its run."""
    if "all" in compare:
        sql = "select unit from signals where run = $run and signal = $signal order by unit"
        units = [str(unit) for (unit,) in catalog.rows(sql, {"run": curve.run, "signal": curve.signal})]
    else:
        units = list(dict.fromkeys(compare))
    return [unit for unit in units if unit != curve.unit]


def _curve_table(curve: "AllanCurve") -> Table:
    table = Table(
        title=f"Overlapping Allan deviation (重叠 Allan 标准差) of {curve.unit} {curve.signal}, run {curve.run}",
        title_justify="left",
        caption=f"{curve.samples:,} samples every {curve.sample_interval_s:g} s, {curve.missing:,} missing; "
        f"limits: 95 % confidence, least degrees of freedom of the plausible noises",
        caption_justify="left",
        header_style="bold",
    )
    for title in ("tau s", f"deviation {curve.unit_of_measure}", "from", "to", "degrees of freedom"):
        table.add_column(title, justify="right")
    for row in zip(curve.tau_s, curve.adev, curve.lo, curve.hi, curve.edf, strict=True):
        tau_s, *values, edf = row
        table.add_row(f"{tau_s:g}", *(f"{value:.5g}" for value in values), f"{edf:,.1f}")
    return table


@click.command("demo")
@store_option
@click.option(
    "--hours",
    type=click.FloatRange(min=0.1, max=1000),
    default=6.0,
    show_default=True,
    help="Simulated length of the run.",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the simulation.")
@reporting
def demo(folder: Path, hours: float, seed: int, *, as_json: bool) -> None:
    """Screen eight simulated gyros: bus, log, lake, live estimates, verdicts, a plot; about a minute."""
    from rich.live import Live

    from analytics.allan_curve import stored_curves
    from analytics.allan_plot import plot_allan
    from analytics.demo import run_demo
    from analytics.live_view import fleet_table, live_view
    from storage.catalog import Catalog
    from storage.store import Store

    console = notes()
    if not as_json:
        console.print(
            f"This input is simulated: eight gyros at 200 Hz for {hours:g} h, three of them planted at or "
            f"beyond a limit. Everything after the gyros is the real path."
        )
    compile_kernels(quiet=as_json)
    if console.is_terminal and not as_json:
        with Live(console=console, refresh_per_second=5, transient=True) as live:
            state = run_demo(
                folder, hours=hours, seed=seed, on_progress=lambda state: live.update(live_view(state, console.width))
            )
    else:
        state = run_demo(folder, hours=hours, seed=seed)
    with Catalog(Store.open(folder)) as catalog:
        curves = stored_curves(catalog, state.run, "rate")
        in_lake = catalog.rows("select coalesce(sum(samples), 0) from signals where run = $run", {"run": state.run})
    if in_lake[0][0] != state.samples:
        raise NotFound(f"run {state.run}: {state.samples} samples were sent, the lake holds {in_lake[0][0]}")
    plot = folder / "plots" / f"{state.run}-allan.png"
    plot.parent.mkdir(exist_ok=True)
    plot_allan(curves, plot, title=f"Simulated fleet, run {state.run}", limits=state.limits.limits)
    if as_json:
        print_json(_summary(state, folder, plot))
        return
    results().print(fleet_table(state, results().width))
    _tell_next(state, folder, plot)


def _summary(state: "DemoState", folder: Path, plot: Path) -> dict[str, object]:
    return {
        "run": state.run,
        "store": str(folder),
        "simulated": True,
        "hours": state.duration_s / 3600,
        "samples": state.samples,
        "seconds": state.seconds,
        "units": [view.verdict for view in state.units.values()],
        "plot": str(plot),
    }


def _tell_next(state: "DemoState", folder: Path, plot: Path) -> None:
    option = "" if str(folder) == "gyrofleet-data" else f" --store {folder}"
    size_mb = {
        part: sum(path.stat().st_size for path in (folder / part).rglob("*") if path.is_file()) / 1e6
        for part in ("log", "lake")
    }
    worst = next(iter(state.units))
    console = results()
    console.print(
        f"{state.samples:,} simulated samples in, {state.samples:,} in the lake, in {state.seconds:.1f} s "
        f"({state.samples / state.seconds / 1e6:.2f} M samples/s, {state.duration_s / state.seconds:,.0f} x real time)",
    )
    console.print(f"log   {folder / 'log'}   {size_mb['log']:.0f} MB of MCAP: the record")
    console.print(f"lake  {folder / 'lake'}  {size_mb['lake']:.0f} MB of Parquet: for any tool that reads it")
    console.print(f"plot  {plot}")
    # what the user typed, where the command is not on the path
    program = "gyrofleet" if shutil.which("gyrofleet") else sys.argv[0]
    console.print("\nAsk it:")
    for statement in _QUESTIONS:
        console.print(f'  {program} sql "{statement}"{option}', soft_wrap=True, markup=False)
    console.print(f"  {program} allan --unit {worst} --signal rate --plot allan.png{option}", soft_wrap=True)
