"""The command `gyrofleet run`: its options, and which of the two kinds of run they ask for."""

import sys
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from stream.console import estimates_option, reporting, store_option
from stream.errors import BadInput

_ONLY_PROCEDURE = frozenset({"units", "parameters", "says_yes", "settle_timeout_h", "every_s", "estimated", "is_check"})
_ONLY_SIMULATED = frozenset({"hours", "rate_hz", "batch", "speed", "seed", "start", "procedure", "position", "site"})


@click.command("run")
@click.argument("procedure_name", metavar="[PROCEDURE]", required=False)
@click.option("--run", "run_id", help="Id of the run; given again, the run goes on. A procedure's is made by itself.")
@click.option("--units", type=click.Path(path_type=Path), help="PROCEDURE: which units are tested, CSV or one a line.")
@click.option("--set", "parameters", multiple=True, metavar="NAME=VALUE", help="PROCEDURE: a parameter of its.")
@click.option("--yes", "says_yes", is_flag=True, help="PROCEDURE: take what the operator is asked as done.")
@click.option(
    "--settle-timeout-h",
    type=click.FloatRange(min=0.0),
    default=6.0,
    show_default=True,
    help="PROCEDURE: how long an instrument may take to settle, at the station.",
)
@click.option("--every", "every_s", type=click.FloatRange(min=1.0), help="PROCEDURE: seconds between estimates.")
@estimates_option
@click.option("--simulate", type=click.IntRange(1, 100_000), metavar="N", help="Simulated units, at rest.")
@click.option("--hours", type=click.FloatRange(min=1e-4), default=1.0, show_default=True, help="Length of the run.")
@click.option(
    "--rate-hz", type=click.FloatRange(min=0.01, max=1e6), default=200.0, show_default=True, help="Rate samples."
)
@click.option(
    "--batch", type=click.IntRange(1, 100_000), default=100, show_default=True, help="Rate samples in a message."
)
@click.option(
    "--speed", type=click.FloatRange(min=0.0), default=1.0, show_default=True, help="Times real time; 0: all it can."
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the simulation.")
@click.option("--start", help="Moment of the first samples, as 2026-11-21T18:00:00+08:00; by default they end now.")
@click.option("--procedure", help="With --simulate: what is done, as static_bias: all of the run is a step of it.")
@click.option("--position", help="With --simulate: where the input axis points, as IRA_east_west.")
@click.option("--operator", help="Who is responsible.")
@click.option("--lot", help="Production lot.")
@click.option("--site", default="local", show_default=True, help="Site the samples come from.")
@click.option(
    "--station", help="PROCEDURE: the station's file; with --simulate its name in the data, else `simulated`."
)
@store_option
@click.option("--connect", help="Where the recorder listens; by default, where the one listens that writes the store.")
@click.option("--spool", "spool_folder", type=click.Path(path_type=Path), help="Folder of the spool; STORE/spool/RUN.")
@click.option(
    "--spool-mb", type=click.IntRange(min=1), default=4096, show_default=True, help="How much may wait in the spool."
)
@click.option("--check", "is_check", is_flag=True, help="PROCEDURE: only look whether the run could begin.")
@click.option("--end", "is_ended", is_flag=True, help="End the run where it is, with outcome `stopped`.")
@reporting
def run(
    procedure_name: str | None,
    run_id: str | None,
    units: Path | None,
    parameters: tuple[str, ...],
    settle_timeout_h: float,
    every_s: float | None,
    estimated: tuple[str, ...],
    folder: Path,
    connect: str | None,
    spool_folder: Path | None,
    spool_mb: int,
    *,
    says_yes: bool,
    is_check: bool,
    is_ended: bool,
    as_json: bool,
    **given: Any,
) -> None:
    """Carry out a PROCEDURE at a station, or send samples of units that are simulated in this process.

    `gyrofleet run PROCEDURE --station FILE --units FILE` sets the station's instruments, waits until they have
    settled, records, and goes on to the next step; `gyrofleet procedure list` has the procedures. At a terminal,
    with --yes too, p Enter pauses, c Enter goes on, a Enter aborts; Ctrl-C makes the station safe and leaves the run
    to go on later. What prepares the record that was cut, a soak or a time without power, is then done again.

    Before a run begins, all instruments, buses, serial lines, disks, the clock and the dates of calibration are looked
    at; --check does that alone. What stands in the way is told at once, and nothing is written.

    Where a `gyrofleet record` writes the store, it goes there, else it is recorded in this process. What no recorder
    has yet waits in a spool on disk. Interrupted or killed, the run goes on under its id when the same command is
    given again; --end ends it.
    """
    if procedure_name is not None:
        sys.exit(
            _run_procedure(
                procedure_name, run_id, units, parameters, settle_timeout_h, every_s, estimated, folder, connect,
                spool_folder, spool_mb, given, says_yes=says_yes, is_check=is_check, is_ended=is_ended,
                as_json=as_json,
            )
        )  # fmt: skip
    if given["simulate"] is None or run_id is None:
        raise BadInput(
            "give a procedure, --station FILE and --units FILE, or --simulate N and --run ID; "
            "`gyrofleet procedure list` has the procedures"
        )
    _refuse(
        _ONLY_PROCEDURE,
        "only for a procedure at a station, and --simulate sends units at rest without one: leave that out, or name "
        "a procedure instead of --simulate",
    )
    from ingest.commands.run_simulated import run_simulated

    sys.exit(
        run_simulated(
            run_id, given, folder, connect, spool_folder, spool_mb << 20, is_ended=is_ended, as_json=as_json
        )
    )  # fmt: skip


def _refuse(names: frozenset[str], why: str) -> None:
    """Raise BadInput where options were given that mean nothing for this kind of run."""
    context = click.get_current_context()
    stray = [
        each.opts[0]
        for each in context.command.params
        if each.name in names and context.get_parameter_source(each.name) is ParameterSource.COMMANDLINE
    ]
    if stray:
        raise BadInput(f"{', '.join(stray)}: {why}")


def _run_procedure(
    procedure: str,
    run_id: str | None,
    units: Path | None,
    parameters: tuple[str, ...],
    settle_timeout_h: float,
    every_s: float | None,
    estimated: tuple[str, ...],
    folder: Path,
    connect: str | None,
    spool_folder: Path | None,
    spool_mb: int,
    given: dict[str, Any],
    *,
    says_yes: bool,
    is_check: bool,
    is_ended: bool,
    as_json: bool,
) -> int:
    from ingest.commands.run_procedure import ProcedureRun, run_procedure
    from ingest.run.run_path import check_spool_name, spools_of
    from storage.store import writer_endpoint
    from stream.identity import check_name
    from stream.worker.estimated_signals import EstimatedSignals

    if given["simulate"] is not None:
        raise BadInput("--simulate is for units without a procedure; `gyrofleet simulate` has a station for procedures")
    _refuse(
        _ONLY_SIMULATED,
        f"only with --simulate; a procedure has its own steps, and its station is in the station's file: leave that "
        f"out; `gyrofleet procedure show {procedure}` has what --set can choose",
    )
    if units is None:
        raise BadInput("say which units are tested: --units FILE, a CSV with a column serial, or one serial a line")
    chosen: dict[str, str] = {}
    for each in parameters:
        name, equals, value = each.partition("=")
        if not equals:
            raise BadInput(
                f"--set {each}: write it as NAME=VALUE; `gyrofleet procedure show {procedure}` has the names"
            )
        chosen[name] = value
    if given["station"] is None:
        raise BadInput("say at which station: --station FILE; `gyrofleet simulate FOLDER` makes one to try it on")
    if run_id is not None:
        check_name("run", run_id)
    asked = ProcedureRun(
        procedure=procedure,
        station=Path(given["station"]),
        units=units,
        parameters=chosen,
        run=run_id,
        operator=given["operator"],
        lot=given["lot"],
        says_yes=says_yes,
        is_ended=is_ended,
        is_check=is_check,
        settle_timeout_s=settle_timeout_h * 3600.0,
        every_s=every_s,
        estimated=EstimatedSignals.named(estimated),
    )
    if spool_folder is None:
        check_spool_name(run_id or "")
        spool_folder = spools_of(folder, is_remote=(connect or writer_endpoint(folder)) is not None)
    return run_procedure(asked, folder, connect, spool_folder, spool_mb << 20, as_json=as_json)
