"""What `gyrofleet run-simulated` does: units at rest, simulated in this process."""

import shlex
import time
from contextlib import ExitStack
from functools import partial

from ingest.moment import moment_ns
from ingest.run import run_path
from ingest.run.live_run import LiveRun, RunParameters, read_run
from ingest.run.run_path import INTERRUPTED, Destination, RunPath, TroubleWatch
from stream.delivery.publisher import DurablePublisher
from stream.identity import check_name
from stream.status.reporter import StatusReporter, served
from stream.status.role_status import Role, RoleState, RoleStatus, RunProgress, new_status
from stream.terminal.console import DEFAULT_STORE, Stop, notes, print_json, results, until_stopped
from stream.worker.compile_kernels import compile_kernels

_REPORT_EVERY_S = 5.0
_LOOK_EVERY_S = 0.2


def run_simulated(
    run: str, parameters: RunParameters, destination: Destination, status_listen: str | None, *, is_ended: bool,
    as_json: bool,
) -> int:  # fmt: skip
    """Send the samples of simulated units from where the run is; the exit code. Raises GyrofleetError if it cannot."""
    check_name("site", parameters.site)
    check_name("station", parameters.station)
    if parameters.start is not None:
        moment_ns(parameters.start)  # what cannot be read is reported before anything is made
    spool_folder = destination.spools if destination.is_given else destination.spools / run
    known = read_run(spool_folder, run, parameters)
    is_over = known is not None and known.phase == "ended"
    if destination.connect is None:
        compile_kernels(quiet=as_json)
    with (
        until_stopped() as stop,
        run_path.recorder_at(None if is_over else destination.connect) as bus,
        run_path.opened_spool(destination, spool_folder) as spool,
    ):
        live = LiveRun(run, parameters, spool)
        if live.state.phase == "ended":
            _report(live, "ended", "nothing to do, all of it is recorded", as_json=as_json)
            return 0
        with (
            run_path.path_to(destination, run, bus, spool, units=live.units, station=live.place.station) as path,
            ExitStack() as stack,
        ):
            collect = partial(_status, live, path.publisher, time.time_ns())
            stack.enter_context(served(status_listen, collect))
            stack.enter_context(StatusReporter(collect, path.put_status))
            return _send(live, path, stop, _Watch(path.publisher, as_json=as_json), is_ended=is_ended)


def _status(live: LiveRun, publisher: DurablePublisher, began_ns: int) -> RoleStatus:
    trouble = publisher.warning or publisher.paused or ""
    parameters = live.state.parameters
    progress = RunProgress(
        run=live.state.run, procedure=parameters.procedure or "", units=tuple(live.units), step=1, steps=1,
        doing="sending" if live.state.phase == "running" else live.state.phase, left_s=live.left_s,
    )  # fmt: skip
    return new_status(
        Role.RUN, began_ns, name=parameters.station, run=progress, trouble=trouble,
        state=RoleState.PAUSED if publisher.paused else RoleState.WORKING,
        numbers={"samples_total": float(live.samples), **publisher.numbers},
    )  # fmt: skip


def _send(live: LiveRun, path: RunPath, stop: Stop, watch: "_Watch", *, is_ended: bool) -> int:
    if not (is_ended and live.state.phase == "running"):
        live.begin(path.sender)
    watch.report(live, "running", path.where)
    if not is_ended:
        for batch in live.batches(stop.wait):
            if stop.asked_at is not None:
                break
            path.sender.send_batch(live.key(batch), batch)
            watch.look(live)
    if stop.asked_at is None:
        live.end(path.sender, "stopped" if is_ended else "completed")
        path.publisher.drain(lambda: watch.look(live) or stop.asked_at is not None)
    if stop.asked_at is not None:
        watch.report(live, "interrupted", run_path.left_behind(path, str(live.folder)))
        return INTERRUPTED
    path.finish()
    live.close()
    remark = "every sample is recorded"
    if path.folder is not None:
        run, folder = shlex.quote(live.state.run), str(path.folder)
        store = "" if folder == DEFAULT_STORE else f" --store {shlex.quote(folder)}"
        remark = f"ask it: gyrofleet allan --unit SIM-0001 --signal rate --run {run} --fit{store}"
    watch.report(live, "ended", remark)
    return 0


class _Watch:
    """Reports the progress of the run every few seconds, and troubles at once."""

    def __init__(self, publisher: DurablePublisher, *, as_json: bool) -> None:
        self._publisher, self._as_json = publisher, as_json
        self._looked_at = self._reported_at = time.monotonic()
        self._trouble = TroubleWatch(publisher, lambda text: notes().print(text, soft_wrap=True))
        self._sent = 0

    def look(self, live: LiveRun) -> bool:
        """Report what is due; False."""
        now = time.monotonic()
        if now - self._looked_at < _LOOK_EVERY_S:
            return False
        self._looked_at = now
        self._trouble.look()
        if now - self._reported_at >= _REPORT_EVERY_S and not self._as_json:
            samples, outstanding = live.samples, self._publisher.outstanding
            rate = (samples - self._sent) / (now - self._reported_at)
            self._reported_at, self._sent = now, samples
            notes().print(f"{samples:,} samples, {rate:,.0f}/s, {outstanding:,} messages not recorded yet")
        return False

    def report(self, live: LiveRun, event: str, remark: str) -> None:
        """Report how far the run is."""
        _report(live, event, remark, self._publisher.resent, as_json=self._as_json)
        self._sent = live.samples


def _report(live: LiveRun, event: str, remark: str, resent: int = 0, *, as_json: bool) -> None:
    gap_s = live.gap_ns / 1e9
    if as_json:
        about = {"event": event, "run": live.state.run, "samples": live.samples, "starts": live.state.starts}
        outcome = live.state.outcome if event == "ended" else None
        gap = {"resumed": live.is_resumed, "gap_s": gap_s, "resent": resent}
        print_json({**about, **gap, "outcome": outcome, "remark": remark})
        return
    resumed = f", resumed after a gap of {gap_s:,.1f} s" if live.is_resumed and event == "running" else ""
    console = notes() if event == "running" else results()
    console.print(f"run {live.state.run} {event}{resumed}, {live.samples:,} samples: {remark}", soft_wrap=True)
