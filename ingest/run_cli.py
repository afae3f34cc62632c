"""The command `gyrofleet run`."""

import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stream.console import (
    DEFAULT_STORE,
    Stop,
    compile_kernels,
    notes,
    print_json,
    reporting,
    results,
    store_option,
    until_stopped,
)
from stream.errors import BadInput

if TYPE_CHECKING:
    from ingest.live_run import LiveRun
    from ingest.run_path import RunPath
    from stream.delivery import DurablePublisher

_INTERRUPTED = 130
_PATIENCE_S = 5.0
_TOLD_EVERY_S = 5.0
_LOOK_EVERY_S = 0.2
_LONGEST_FOLDER_BYTES = 200


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
@click.option("--procedure", help="With --simulate: what the run is called a run of.")
@click.option("--operator", help="Who is responsible.")
@click.option("--lot", help="Production lot.")
@click.option("--site", default="local", show_default=True, help="Site the samples come from.")
@click.option(
    "--station",
    help="PROCEDURE: the station's file; with --simulate its name in the data, else `simulated`.",
)
@store_option
@click.option("--connect", help="Where the recorder listens; by default, where the one listens that writes the store.")
@click.option("--spool", "spool_folder", type=click.Path(path_type=Path), help="Folder of the spool; STORE/spool/RUN.")
@click.option(
    "--spool-mb", type=click.IntRange(min=1), default=4096, show_default=True, help="How much may wait in the spool."
)
@click.option("--end", "is_ended", is_flag=True, help="End the run where it is, with outcome `stopped`.")
@reporting
def run(
    procedure_name: str | None,
    run_id: str | None,
    units: Path | None,
    parameters: tuple[str, ...],
    settle_timeout_h: float,
    every_s: float | None,
    folder: Path,
    connect: str | None,
    spool_folder: Path | None,
    spool_mb: int,
    *,
    says_yes: bool,
    is_ended: bool,
    as_json: bool,
    **given: Any,
) -> None:
    """Carry out a PROCEDURE at a station, or send samples of units that are simulated in this process.

    `gyrofleet run PROCEDURE --station FILE --units FILE` sets the station's instruments, waits until they have
    settled, records, and goes on to the next step; `gyrofleet procedure list` has the procedures. Without --yes,
    p Enter pauses, c Enter goes on, a Enter aborts; Ctrl-C makes the station safe and leaves the run to go on later.
    What prepares the record that was cut, a soak or a time without power, is then done again.

    Where a `gyrofleet record` writes the store, it goes there, else it is recorded in this process. What no recorder
    has yet waits in a spool on disk. Interrupted or killed, the run goes on under its id when the same command is
    given again; --end ends it.
    """
    if procedure_name is not None:
        sys.exit(
            _run_procedure(
                procedure_name, run_id, units, parameters, settle_timeout_h, every_s, folder, connect, spool_folder,
                spool_mb, given, says_yes=says_yes, is_ended=is_ended, as_json=as_json,
            )
        )  # fmt: skip
    if given["simulate"] is None or run_id is None:
        raise BadInput(
            "give a procedure, --station FILE and --units FILE, or --simulate N and --run ID; "
            "`gyrofleet procedure list` has the procedures"
        )
    _simulate(run_id, folder, connect, spool_folder, spool_mb, given, is_ended=is_ended, as_json=as_json)


def _run_procedure(
    procedure: str,
    run_id: str | None,
    units: Path | None,
    parameters: tuple[str, ...],
    settle_timeout_h: float,
    every_s: float | None,
    folder: Path,
    connect: str | None,
    spool_folder: Path | None,
    spool_mb: int,
    given: dict[str, Any],
    *,
    says_yes: bool,
    is_ended: bool,
    as_json: bool,
) -> int:
    from ingest.procedure_run_cli import ProcedureRun, run_procedure
    from storage.store import writer_endpoint
    from stream.identity import check_name

    if given["simulate"] is not None:
        raise BadInput("--simulate is for units without a procedure; `gyrofleet simulate` has a station for procedures")
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
        settle_timeout_s=settle_timeout_h * 3600.0,
        every_s=every_s,
    )
    is_remote = (connect or writer_endpoint(folder)) is not None
    spools = spool_folder or _spool_folder(folder, run_id or "run", is_remote=is_remote).parent
    return run_procedure(asked, folder, connect, spools, spool_mb << 20, as_json=as_json)


def _simulate(
    run_id: str,
    folder: Path,
    connect: str | None,
    spool_folder: Path | None,
    spool_mb: int,
    given: dict[str, Any],
    *,
    is_ended: bool,
    as_json: bool,
) -> None:
    import msgspec

    from ingest.live_run import LiveRun
    from ingest.run_path import path_to
    from ingest.run_state import RunParameters
    from storage.store import writer_endpoint
    from stream.identity import check_name
    from stream.spool import Spool

    check_name("run", run_id)
    given["station"] = given["station"] or "simulated"
    parameters = msgspec.convert(given, RunParameters)
    check_name("site", parameters.site)
    check_name("station", parameters.station)
    connect = connect or writer_endpoint(folder)
    if connect is None:
        compile_kernels(quiet=as_json)
    spool_folder = spool_folder or _spool_folder(folder, run_id, is_remote=connect is not None)
    with Spool(spool_folder, max_bytes=spool_mb << 20) as spool, until_stopped() as stop:
        for damage in spool.damages:
            notes().print(f"warning: the spool is damaged: {damage}", soft_wrap=True, markup=False)
        live = LiveRun(run_id, parameters, spool)
        if live.is_over:
            tell_run(live, "ended", "nothing to do, all of it is recorded", as_json=as_json)
            return
        with path_to(folder, run_id, connect, spool) as path:
            code = _send(live, path, stop, _Watch(path.publisher, as_json=as_json), is_ended=is_ended)
    sys.exit(code)


def _spool_folder(folder: Path, run_id: str, *, is_remote: bool) -> Path:
    """Beside the store; where its samples go elsewhere, in no folder that could become one."""
    if len(run_id.encode()) > _LONGEST_FOLDER_BYTES:
        raise BadInput(
            f"--run {run_id} has {len(run_id.encode())} bytes in UTF-8, and the folder of its spool is named after it: "
            f"{_LONGEST_FOLDER_BYTES} at most; give a shorter one, or --spool FOLDER"
        )
    if is_remote and not (folder / "store.json").exists():
        return folder.with_name(folder.name + "-spool") / run_id
    if not is_remote:
        from storage.store import Store

        Store.create(folder)
    return folder / "spool" / run_id


def _send(live: "LiveRun", path: "RunPath", stop: Stop, watch: "_Watch", *, is_ended: bool) -> int:
    """Send what is left of the run; returns the exit code."""
    if not (is_ended and live.state.phase == "running"):
        live.begin(path.sender)
    watch.tell(live, "running", path.where)
    if not is_ended:
        for batch in live.batches(stop.wait):
            if stop.asked_at is not None:
                break
            path.sender.send_batch(live.key(batch), batch)
            watch.look(live)
    if stop.asked_at is None:
        live.end(path.sender, "stopped" if is_ended else "completed")
        path.publisher.drain(lambda: watch.look(live) or stop.asked_at is not None)
    if stop.asked_at is None:
        path.finish()
        live.close()
        watch.tell(live, "ended", _next(live, path))
        return 0
    patient_until = stop.asked_at + _PATIENCE_S
    path.publisher.drain(lambda: time.monotonic() > patient_until)
    left = path.publisher.outstanding
    if left:
        path.publisher.abandon()
    else:
        path.finish()
    kept = f"{left} messages wait in {live.folder}; " if left else ""
    watch.tell(live, "interrupted", f"{kept}give the same command to go on, with --end to end it")
    return _INTERRUPTED


def _next(live: "LiveRun", path: "RunPath") -> str:
    """What to ask of the run."""
    if path.folder is None:
        return "every sample is recorded"
    store = "" if str(path.folder) == DEFAULT_STORE else f" --store {shlex.quote(str(path.folder))}"
    return f"ask it: gyrofleet allan --unit SIM-0001 --signal rate --run {shlex.quote(live.state.run)} --fit{store}"


class _Watch:
    """Tells how the run goes on: now and then, and whenever something is wrong."""

    def __init__(self, publisher: "DurablePublisher", *, as_json: bool) -> None:
        self._publisher = publisher
        self._as_json = as_json
        self._looked_at = self._told_at = time.monotonic()
        self._trouble: str | None = None
        self._sent = 0

    def look(self, live: "LiveRun") -> bool:
        """Say what there is to say; False."""
        now = time.monotonic()
        if now - self._looked_at < _LOOK_EVERY_S:
            return False
        self._looked_at = now
        paused = self._publisher.paused
        trouble = self._publisher.warning or (f"the recorder pauses: {paused}" if paused else None)
        if trouble != self._trouble:
            self._trouble = trouble
            notes().print(f"warning: {trouble}" if trouble else "going on", soft_wrap=True, markup=False)
        if now - self._told_at >= _TOLD_EVERY_S and not self._as_json:
            samples, outstanding = live.samples, self._publisher.outstanding
            rate = (samples - self._sent) / (now - self._told_at)
            self._told_at, self._sent = now, samples
            notes().print(f"{samples:,} samples, {rate:,.0f}/s, {outstanding:,} messages not recorded yet")
        return False

    def tell(self, live: "LiveRun", event: str, remark: str) -> None:
        """Say where the run is."""
        tell_run(live, event, remark, self._publisher.resent, as_json=self._as_json)
        self._sent = live.samples


def tell_run(live: "LiveRun", event: str, remark: str, resent: int = 0, *, as_json: bool) -> None:
    """Print where a run is, for people or as JSON."""
    gap_s = live.gap_ns / 1e9
    if as_json:
        print_json(
            {
                "event": event,
                "run": live.state.run,
                "samples": live.samples,
                "starts": live.state.starts,
                "resumed": live.is_resumed,
                "gap_s": gap_s,
                "resent": resent,
                "outcome": live.state.outcome if event == "ended" else None,
                "remark": remark,
            }
        )
        return
    resumed = f", resumed after a gap of {gap_s:,.1f} s" if live.is_resumed and event == "running" else ""
    console = notes() if event == "running" else results()
    console.print(
        f"run {live.state.run} {event}{resumed}, {live.samples:,} samples: {remark}", soft_wrap=True, markup=False
    )
