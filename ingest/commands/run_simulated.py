"""What `gyrofleet run --simulate N --run ID` does: units at rest, simulated in this process."""

import shlex
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from ingest.moment import moment_ns
from ingest.run.live_run import LiveRun
from ingest.run.run_path import RunPath, TroubleWatch, check_spool_name, opened_spool, path_to, recorder_at, spools_of
from ingest.run.run_state import RunParameters, read_run
from storage.store import writer_endpoint
from stream.console import DEFAULT_STORE, Stop, notes, print_json, results, until_stopped
from stream.delivery.publisher import DurablePublisher
from stream.identity import check_name
from stream.worker.compile_kernels import compile_kernels

_INTERRUPTED = 130
_PATIENCE_S = 5.0
_TOLD_EVERY_S = 5.0
_LOOK_EVERY_S = 0.2


def run_simulated(
    run: str,
    given: Mapping[str, Any],
    folder: Path,
    connect: str | None,
    spool_folder: Path | None,
    spool_bytes: int,
    *,
    is_ended: bool,
    as_json: bool,
) -> int:
    """Send the samples of simulated units, from where the run is; returns the exit code.

    Parameters
    ----------
    run: Its id.
    given: What the command line says of it, by the names of `RunParameters`.
    folder: The store.
    connect: Where the recorder listens; by default, where the one listens that writes the store.
    spool_folder: Folder of its spool; by default one of its name among those of the store.
    spool_bytes: How much may wait in it.
    is_ended: Whether it is ended where it is.
    as_json: Whether it is told as JSON.

    Raises
    ------
    GyrofleetError: If it was started otherwise, no recorder is reached, or recording fails.
    """
    check_name("run", run)
    parameters = msgspec.convert({**given, "station": given["station"] or "simulated"}, RunParameters)
    check_name("site", parameters.site)
    check_name("station", parameters.station)
    if parameters.start is not None:
        moment_ns(parameters.start)  # what cannot be read is told before anything is made
    connect = connect or writer_endpoint(folder)
    is_remote = connect is not None
    if spool_folder is None:
        check_spool_name(run)
        spool_folder = spools_of(folder, is_remote=is_remote) / run
    known = read_run(spool_folder, run, parameters)
    is_over = known is not None and known.phase == "ended"
    if not is_remote:
        compile_kernels(quiet=as_json)
    with (
        until_stopped() as stop,
        recorder_at(None if is_over else connect) as elsewhere,
        opened_spool(folder, spool_folder, spool_bytes, is_remote=is_remote) as spool,
    ):
        live = LiveRun(run, parameters, spool)
        if live.is_over:
            _tell(live, "ended", "nothing to do, all of it is recorded", as_json=as_json)
            return 0
        with path_to(folder, run, elsewhere, spool, units=live.units) as path:
            return _send(live, path, stop, _Watch(path.publisher, as_json=as_json), is_ended=is_ended)


def _send(live: LiveRun, path: RunPath, stop: Stop, watch: "_Watch", *, is_ended: bool) -> int:
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


def _next(live: LiveRun, path: RunPath) -> str:
    """What to ask of the run."""
    if path.folder is None:
        return "every sample is recorded"
    store = "" if str(path.folder) == DEFAULT_STORE else f" --store {shlex.quote(str(path.folder))}"
    return f"ask it: gyrofleet allan --unit SIM-0001 --signal rate --run {shlex.quote(live.state.run)} --fit{store}"


class _Watch:
    """Tells how the run goes on: now and then, and whenever something is wrong."""

    def __init__(self, publisher: DurablePublisher, *, as_json: bool) -> None:
        self._publisher = publisher
        self._as_json = as_json
        self._looked_at = self._told_at = time.monotonic()
        self._trouble = TroubleWatch(publisher, lambda text: notes().print(text, soft_wrap=True, markup=False))
        self._sent = 0

    def look(self, live: LiveRun) -> bool:
        """Say what there is to say; False."""
        now = time.monotonic()
        if now - self._looked_at < _LOOK_EVERY_S:
            return False
        self._looked_at = now
        self._trouble.look()
        if now - self._told_at >= _TOLD_EVERY_S and not self._as_json:
            samples, outstanding = live.samples, self._publisher.outstanding
            rate = (samples - self._sent) / (now - self._told_at)
            self._told_at, self._sent = now, samples
            notes().print(f"{samples:,} samples, {rate:,.0f}/s, {outstanding:,} messages not recorded yet")
        return False

    def tell(self, live: LiveRun, event: str, remark: str) -> None:
        """Say where the run is."""
        _tell(live, event, remark, self._publisher.resent, as_json=self._as_json)
        self._sent = live.samples


def _tell(live: LiveRun, event: str, remark: str, resent: int = 0, *, as_json: bool) -> None:
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
