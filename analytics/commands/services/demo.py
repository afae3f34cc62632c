"""The command `gyrofleet demo`."""

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stream.errors import NotFound
from stream.terminal.console import notes, print_json, reporting, results, store_option, until_stopped
from stream.worker.compile_kernels import compile_kernels

if TYPE_CHECKING:
    from analytics.demo.demo import DemoState

_QUESTIONS = (
    "select unit, document->>'$.verdict' as verdict from events where kind = 'VerdictGiven' order by unit",
    "select unit, run, avg(value) * 3600 as deg_per_h from samples where signal = 'rate' group by 1, 2 order by 1, 2",
)


@click.command("demo")
@store_option
@click.option(
    "--hours", type=click.FloatRange(min=0.1, max=1000), default=6.0, show_default=True,
    help="Simulated length of the run.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the simulation.")
@click.option("--serve", "is_served", is_flag=True, help="Serve the page meanwhile, and afterwards until Ctrl-C.")
@reporting
def demo(folder: Path, hours: float, seed: int, *, is_served: bool, as_json: bool) -> None:
    """Screen eight simulated gyros: bus, log, lake, live estimates, verdicts, and what a unit's error model lacks."""
    with _page(folder) if is_served else nullcontext():
        _demonstrate(folder, hours, seed, as_json=as_json)
        if is_served:
            notes().print("the page stays until Ctrl-C")
            with until_stopped() as stopped:
                while not stopped.wait(1.0):
                    pass


@contextmanager
def _page(folder: Path) -> Iterator[None]:
    """Serve the store in a process of its own; NotFound if it cannot start, which then says why."""
    from storage.store import Store

    Store.create(folder)
    command = [sys.executable, "-m", "gyrofleet", "serve", "--store", str(folder), "--port", "0", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:  # noqa: S603  our own program
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line:
            raise NotFound("the page cannot be served; the message above says why")
        notes().print(f"look at it while it runs: {json.loads(line)['login']}", soft_wrap=True, markup=False)
        try:
            yield
        finally:
            process.terminate()


def _demonstrate(folder: Path, hours: float, seed: int, *, as_json: bool) -> None:
    from rich.live import Live

    from analytics.curves.allan_curve import stored_curves
    from analytics.demo.demo import run_demo
    from analytics.demo.live_view import fleet_table, live_view
    from analytics.plots.allan_plot import plot_allan
    from storage.sql.catalog import Catalog
    from storage.store import Store

    console = notes()
    if not as_json:
        console.print(
            f"This input is simulated: eight gyros at 200 Hz for {hours:g} h, three of them planted at or "
            f"beyond a limit; then nine short runs, in which one unit has an effect that its model lacks. Everything "
            f"after the gyros is the real path."
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
        sql = "select coalesce(sum(samples), 0) from signals where run in (select unnest($runs))"
        ((in_lake,),) = catalog.rows(sql, {"runs": [state.run, *state.cycles]})
    sent = state.samples + state.cycle_samples
    if in_lake != sent:
        raise NotFound(f"run {state.run}: {sent} samples were sent, the lake holds {in_lake}")
    plot = folder / "plots" / f"{state.run}-allan.png"
    plot.parent.mkdir(exist_ok=True)
    plot_allan(curves, plot, title=f"Simulated fleet, run {state.run}", limits=state.limits.live)
    if as_json:
        print_json(_summary(state, folder, plot))
        return
    results().print(fleet_table(state, results().width))
    _print_found(state)
    _print_next(state, folder, plot)


def _summary(state: "DemoState", folder: Path, plot: Path) -> dict[str, object]:
    return {
        "run": state.run, "store": str(folder), "simulated": True, "hours": state.duration_s / 3600,
        "samples": state.samples, "seconds": state.seconds, "units": [view.verdict for view in state.units.values()],
        "found": None if state.found is None else state.found.document(), "plot": str(plot),
    }  # fmt: skip


def _print_found(state: "DemoState") -> None:
    """What the units' error models lack, in a sentence each, in both languages."""
    from analytics.demo.demo import DECLARED_MODEL
    from analytics.loop.report.verdict_sentence import verdict_sentence
    from analytics.loop.report.wording import Wording

    assert state.found is not None
    console = results()
    console.print(f"\nDeclared error model: {DECLARED_MODEL}. Its residual in {len(state.cycles)} short runs:")
    silent = [unit for unit, each in state.found.units.items() if not each.diagnosis.effects]
    for unit, each in state.found.units.items():
        if each.diagnosis.effects:
            for language in ("en", "zh"):
                sentence = verdict_sentence(each.diagnosis, Wording(language))
                console.print(f"{unit}: {sentence}", soft_wrap=True)
    verdicts = sorted({state.found.units[unit].diagnosis.verdict.replace("_", " ") for unit in silent})
    console.print(f"{', '.join(silent)}: {', '.join(verdicts)}\n", soft_wrap=True)


def _print_next(state: "DemoState", folder: Path, plot: Path) -> None:
    from analytics.demo.demo import DECLARED_MODEL
    from ingest.simulator.demo_fleet import ODD_UNIT

    option = "" if str(folder) == "gyrofleet-data" else f" --store {folder}"
    size_mb = {
        part: sum(path.stat().st_size for path in (folder / part).rglob("*") if path.is_file()) / 1e6
        for part in ("log", "lake")
    }
    worst = next(iter(state.units))
    console = results()
    console.print(
        f"{state.samples:,} simulated samples in, {state.samples:,} in the lake, in {state.seconds:.1f} s "
        f"({state.samples / state.seconds / 1e6:.2f} M samples/s, {state.duration_s / state.seconds:,.0f} x real time)"
    )
    console.print(f"log   {folder / 'log'}   {size_mb['log']:.0f} MB of MCAP: the record")
    console.print(f"lake  {folder / 'lake'}  {size_mb['lake']:.0f} MB of Parquet: for any tool that reads it")
    console.print(f"plot  {plot}")
    # what the user typed, where the command is not on the path
    program = "gyrofleet" if shutil.which("gyrofleet") else sys.argv[0]
    console.print("\nAsk it:")
    for statement in _QUESTIONS:
        console.print(f'  {program} sql "{statement}"{option}', soft_wrap=True)
    console.print(f"  {program} allan --unit {worst} --signal rate --plot allan.png{option}", soft_wrap=True)
    console.print(
        f'  {program} diagnose --unit {ODD_UNIT} --model "{DECLARED_MODEL}" --report found.html{option}', soft_wrap=True
    )
    console.print(f"Look at it: {program} serve{option}", soft_wrap=True)
