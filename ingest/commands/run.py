"""The commands `gyrofleet run`, a procedure at a station, and `gyrofleet run-simulated`, units without one."""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import click

from ingest.commands.procedure import PROCEDURE
from ingest.run.station_security import station_security
from stream.decoding import converted
from stream.errors import BadInput
from stream.roles.role_log import logged
from stream.security.rights import Role
from stream.terminal.console import estimates_option, reporting, status_listen_option, store_option
from stream.terminal.security_options import secured

_defaulted = partial(click.option, show_default=True)
_PATH = click.Path(path_type=Path)


class _ProcedureCommand(click.Command):
    """Points to the command that has the options of simulated units."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments; refuse ``--simulate``."""
        if any(each.partition("=")[0] == "--simulate" for each in args):
            raise click.UsageError(
                "`run` carries out a procedure at a station; units without a station are simulated by "
                "`gyrofleet run-simulated --run ID --simulate N`, with the same options as before",
                ctx,
            )
        return super().parse_args(ctx, args)


def destination_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of where a run goes, and `--end`."""
    for option in (
        click.option("--end", "is_ended", is_flag=True, help="End the run where it is, with outcome `stopped`."),
        _defaulted("--spool-mb", type=click.IntRange(min=1), default=4096, help="Size of the spool."),
        click.option("--spool", "spool_folder", type=_PATH, help="Folder of the spool; by default STORE/spool."),
        click.option("--connect", help="Where the recorder listens; by default the one that writes the store."),
        store_option,
    ):
        command = option(command)
    return command


@click.command("run", cls=_ProcedureCommand)
@click.argument("procedure", type=PROCEDURE, metavar="PROCEDURE")
@click.option("--station", type=_PATH, help="The station's file.")
@click.option("--units", type=_PATH, help="Units to test: CSV, or one serial a line.")
@click.option("--set", "parameters", multiple=True, metavar="NAME=VALUE", help="A parameter of the procedure.")
@click.option(
    "--specification", metavar="NAME[@REVISION]", help="Limits to apply; by default those of each unit's product."
)
@click.option("--run", "run_id", help="Id of the run; by default the day, the procedure and a letter.")
@click.option("--operator", help="Who is responsible.")
@click.option("--lot", help="Production lot.")
@click.option("--yes", "says_yes", is_flag=True, help="Answer every prompt for the operator with yes.")
@click.option(
    "--settle-timeout-h", type=click.FloatRange(min=0.0), default=6.0, show_default=True,
    help="Longest settling time of an instrument, at the station.",
)  # fmt: skip
@click.option("--every", "every_s", type=click.FloatRange(min=1.0), help="Seconds between estimates.")
@click.option(
    "--stop-when-decided",
    "stops_when_decided",
    is_flag=True,
    help="Release each unit once all its limits are decided; its supply is switched off.",
)
@estimates_option
@status_listen_option
@destination_options
@click.option("--check", "is_check", is_flag=True, help="Check whether the run could begin, and end.")
@reporting
@logged("run")
@secured(Role.STATION, default=lambda given: station_security(given["station"]))
def run(
    station: Path | None, units: Path | None, parameters: tuple[str, ...], run_id: str | None, settle_timeout_h: float,
    estimated: tuple[str, ...], folder: Path, connect: str | None, spool_folder: Path | None, spool_mb: int,
    *, as_json: bool, **given: Any,
) -> None:  # fmt: skip
    """Carry out a PROCEDURE at a station (`gyrofleet procedure list` has them).

    It sets the station's instruments, waits until they have settled, records, and goes on to the next step. At a
    terminal, with --yes too, p Enter pauses, c Enter goes on, a Enter aborts; Ctrl-C makes the station safe and leaves
    the run to be resumed: the same command goes on where it was, and repeats a soak or a time without power that
    prepares the record that was cut.

    Each unit is judged by the specification of its product that is valid in the store (`gyrofleet limits`): a run with
    one record at rest is decided early where the data allow it, all limits are judged by `gyrofleet verdicts`.

    Before a run begins, instruments, buses, serial lines, disks, clock and calibration dates are checked; every
    obstacle is reported at once, and nothing is written. What no recorder has yet waits in a spool on disk.
    """
    from ingest.commands.run_procedure import ProcedureRun, run_procedure
    from ingest.run.run_path import Destination
    from stream.identity import check_name
    from stream.worker.estimated_signals import EstimatedSignals

    if units is None:
        raise BadInput("say which units are tested: --units FILE, a CSV with a column serial, or one serial a line")
    if station is None:
        raise BadInput("say at which station: --station FILE; `gyrofleet simulate FOLDER` makes one to try it on")
    if run_id is not None:
        check_name("run", run_id)
    asked = ProcedureRun(
        station=station, units=units, run=run_id, settle_timeout_s=settle_timeout_h * 3600.0,
        parameters=dict(_parameter(each, given["procedure"]) for each in parameters),
        estimated=EstimatedSignals.named(estimated), **given,
    )  # fmt: skip
    destination = Destination.chosen(run_id, folder, connect, spool_folder, spool_mb)
    sys.exit(run_procedure(asked, destination, as_json=as_json))


@click.command("run-simulated")
@click.option("--run", "run_id", required=True, help="Id of the run; given again, the run resumes.")
@click.option("--simulate", type=click.IntRange(1, 100_000), metavar="N", required=True, help="How many units.")
@_defaulted("--hours", type=click.FloatRange(min=1e-4), default=1.0, help="Length of the run.")
@_defaulted("--rate-hz", type=click.FloatRange(min=0.01, max=1e6), default=200.0, help="Rate samples.")
@_defaulted("--batch", type=click.IntRange(1, 100_000), default=100, help="Rate samples in a message.")
@_defaulted("--speed", type=click.FloatRange(min=0.0), default=1.0, help="Times real time; 0: unpaced.")
@_defaulted("--seed", type=click.IntRange(min=0), default=1, help="Seed of the simulation.")
@click.option("--start", help="First sample, as 2026-11-21T18:00:00+08:00; by default the run ends now.")
@click.option("--procedure", help="What is done, as static_bias: the whole run is a step of it.")
@click.option("--position", help="Attitude of the input axis, as IRA_east_west.")
@click.option("--operator", help="Who is responsible.")
@click.option("--lot", help="Production lot.")
@_defaulted("--site", default="local", help="Site of the samples.")
@_defaulted("--station", default="simulated", help="Name of the station in the data.")
@status_listen_option
@destination_options
@reporting
@logged("run")
@secured(Role.STATION)
def run_simulated(
    run_id: str, folder: Path, connect: str | None, spool_folder: Path | None, spool_mb: int,
    status_listen: str | None, *, is_ended: bool, as_json: bool, **given: Any,
) -> None:  # fmt: skip
    """Send samples of N units at rest that are simulated in this process, without a station.

    Where a `gyrofleet record` writes the store, it records them, else this process does. What no recorder has yet waits
    in a spool on disk. Interrupted or killed, the run resumes under its id when the same command is given again.
    """
    from ingest.commands import run_simulated
    from ingest.run.live_run import RunParameters
    from ingest.run.run_path import Destination
    from stream.identity import check_name

    check_name("run", run_id)
    parameters = converted(given, RunParameters)
    destination = Destination.chosen(run_id, folder, connect, spool_folder, spool_mb)
    code = run_simulated.run_simulated(
        run_id, parameters, destination, status_listen, is_ended=is_ended, as_json=as_json
    )
    sys.exit(code)


def _parameter(text: str, procedure: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise BadInput(f"--set {text}: write it as NAME=VALUE; `gyrofleet procedure show {procedure}` has the names")
    return name, value
