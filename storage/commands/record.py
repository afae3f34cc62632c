"""The commands `gyrofleet record` and `gyrofleet router`."""

import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stream.roles.config_file import configured
from stream.roles.role_log import RoleLog, logged
from stream.security.rights import Role
from stream.terminal.console import print_json, reporting, status_listen_option, store_option, until_stopped
from stream.terminal.option_checks import check_listen, options_checked
from stream.terminal.security_options import check_one_address, secured

if TYPE_CHECKING:
    from storage.recording.recorder import Recorder

_SHOWN_REJECTIONS = 5
_REFUSALS_LOGGED = 10  # between two reports
_REPORT_EVERY_S = 5.0
_SILENCE_S = 30.0


def _check(options: Mapping[str, Any]) -> None:
    check_one_address(options)
    check_listen(options)


@click.command("record")
@store_option
@click.option(
    "--listen", help="Address for sources; by default tcp/127.0.0.1:7447, on loopback, unless --connect is given."
)
@click.option("--connect", help="Connect to a `gyrofleet router` at this address instead of listening.")
@click.option(
    "--rotate-mb", type=click.IntRange(min=1), default=128, show_default=True,
    help="Payload of a segment of the log before it is sealed.",
)  # fmt: skip
@click.option(
    "--rotate-s", type=click.FloatRange(min=1), default=300.0, show_default=True,
    help="Age of a segment in seconds before it is sealed and reaches the lake.",
)  # fmt: skip
@click.option(
    "--sync-ms", type=click.IntRange(min=1, max=10_000), default=100, show_default=True,
    help="Milliseconds between fdatasync and acknowledgement.",
)  # fmt: skip
@click.option("--no-lake", is_flag=True, help="Leave the lake to a separate `gyrofleet lake`.")
@status_listen_option
@configured("record")
@reporting
@logged("record")
@options_checked(_check)
@secured(Role.RECORDER, listens=True)
def record(
    folder: Path, listen: str | None, connect: str | None, rotate_mb: int, rotate_s: float, sync_ms: int,
    status_listen: str | None, *, no_lake: bool, as_json: bool,
) -> None:  # fmt: skip
    """Record everything that sources send, until stopped."""
    from storage.log.event_log import EventLog
    from storage.recording.recorder import Recorder
    from storage.store import Store, WriterLock
    from stream.errors import StoreError
    from stream.security.credentials import process_security
    from stream.security.endpoint import parse_endpoint, secured_endpoint
    from stream.status.reporter import served
    from stream.transport.zenoh_bus import DEFAULT_ENDPOINT, ZenohBus

    credentials = process_security().credentials
    default = DEFAULT_ENDPOINT if credentials is None else secured_endpoint(DEFAULT_ENDPOINT)
    endpoint = connect or listen or default
    log_of_role = RoleLog("record")
    printing = threading.Lock()

    def warn(text: str) -> None:
        with printing:
            if as_json:
                with suppress(BrokenPipeError):  # the next progress line ends the command, not the writer's thread
                    print_json({"event": "warning", "at": _now(), "text": text})
            log_of_role.write("warning", "warning", text)

    store = Store.create(folder)
    reached = str(parse_endpoint(endpoint).local)
    folder_of_key = "" if credentials is None else str(credentials.folder)
    with WriterLock(store, "gyrofleet record", reached, folder_of_key), until_stopped() as stopped:
        try:
            log = EventLog(store, rotate_bytes=rotate_mb << 20, rotate_s=rotate_s)
        except OSError as error:
            raise StoreError(f"the log of {folder} cannot be written: {error}; free or repair the disk") from error
        for warning in log.warnings:
            warn(warning)
        for recovery in log.recovered:
            original = "" if recovery.kept_aside is None else f"; the original file: {recovery.kept_aside}"
            log_of_role.write("info", "recovered", f"{recovery}, left open by an earlier process{original}")
        with (
            ZenohBus(listen=[] if connect else [endpoint], connect=[connect] if connect else []) as bus,
            Recorder(
                store, bus, log, sync_interval_s=sync_ms / 1000, builds_lake=not no_lake, on_warning=warn
            ) as recorder,
            served(status_listen, recorder.status),
        ):
            if as_json:
                print_json({"event": "recording", "store": str(folder), "listen": endpoint})
            text = f"recording from {endpoint} to {folder}; Ctrl-C ends"
            log_of_role.write("info", "recording", text, listen=endpoint)
            progress = _Progress(recorder, log_of_role, as_json=as_json)
            while not stopped.wait(0.2) and recorder.failure is None:
                progress.report()
            log_of_role.write("info", "stopping", "stopping: writing what has arrived, sources keep the rest")
            recorder.end()
            if not no_lake and recorder.failure is None:
                text = "the log is complete; the lake follows. Ctrl-C again leaves it to the next command"
                log_of_role.write("info", "log_complete", text)
    _print_counts(recorder, log_of_role, as_json=as_json)


@click.command("router")
@click.option("--listen", default="tcp/127.0.0.1:7447", show_default=True, help="Address that all others connect to.")
@configured("router")
@reporting
@logged("router")
@secured(Role.ROUTER, listens=True)
def router(listen: str, *, as_json: bool) -> None:
    """Pass messages between sources, recorder and estimators that connect here, until stopped.

    With a router the recorder can be stopped and started alone; without one the others connect to the recorder.
    """
    from stream.transport.zenoh_bus import ZenohBus

    with until_stopped() as stopped, ZenohBus(listen=[listen]):
        if as_json:
            print_json({"event": "routing", "listen": listen})
        RoleLog("router").write("info", "routing", f"routing messages at {listen}; Ctrl-C ends", listen=listen)
        while not stopped.wait(1.0):
            pass


class _Progress:
    """Reports the progress of recording, and when nothing arrives any more."""

    def __init__(self, recorder: "Recorder", log: RoleLog, *, as_json: bool) -> None:
        self._recorder, self._log, self._as_json = recorder, log, as_json
        self._reported_at = self._moved_at = time.monotonic()
        self._messages = self._samples = self._refused = 0
        self._room = _REFUSALS_LOGGED
        self._is_silent = False

    def report(self) -> None:
        """Report now and then."""
        now, counts = time.monotonic(), self._recorder.counts
        self._log_refusals()
        if counts.messages != self._messages:
            self._messages, self._moved_at, self._is_silent = counts.messages, now, False
        elif self._messages and not self._is_silent and now - self._moved_at >= _SILENCE_S:
            self._is_silent = True
            self._print("silent", f"nothing has arrived for {_SILENCE_S:g} s", samples=counts.samples)
        if now - self._reported_at >= _REPORT_EVERY_S:
            self._room = _REFUSALS_LOGGED
        if now - self._reported_at >= _REPORT_EVERY_S and counts.samples != self._samples:
            rate = (counts.samples - self._samples) / (now - self._reported_at)
            self._reported_at, self._samples = now, counts.samples
            self._print("progress", f"{counts.samples:,} samples, {rate:,.0f}/s", samples=counts.samples, per_s=rate)

    def _log_refusals(self) -> None:
        """Log what is refused as it comes, up to a number; all of it is counted."""
        counts = self._recorder.counts
        total = counts.rejected + counts.conflicts
        fresh = min(total - self._refused, self._room, len(counts.rejections))
        self._refused = total
        self._room -= fresh
        for rejection in list(counts.rejections)[len(counts.rejections) - fresh :]:
            self._log.write("warning", "refused", f"refused and quarantined: {rejection}", refused=total)

    def _print(self, event: str, text: str, **numbers: float) -> None:
        if self._as_json:
            print_json({"event": event, "at": _now(), "text": text, **numbers})
        self._log.write("info", event, text, **numbers)


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="seconds")


def _print_counts(recorder: "Recorder", log: RoleLog, *, as_json: bool) -> None:
    counts = recorder.counts
    if as_json:
        totals = {("clock_steps_back" if name == "backwards" else name): each for name, each in vars(counts).items()}
        print_json({"event": "ended", **totals, "rejections": list(counts.rejections)})
    text = (
        f"{counts.samples:,} samples in {counts.segments} segments; {counts.duplicates} messages came twice, "
        f"{counts.rejected} were refused"
    )
    log.write("info", "ended", text, samples=counts.samples, segments=counts.segments, rejected=counts.rejected)
    if counts.conflicts:
        text = f"{counts.conflicts} messages have numbers that are recorded with other content; see the events"
        log.write("warning", "conflicts", text)
    if counts.rejected_not_kept:
        log.write(
            "warning",
            "not_kept",
            f"{counts.rejected_not_kept} of the rejected messages were not kept: too many at once",
        )
    for rejection in list(counts.rejections)[-_SHOWN_REJECTIONS:]:
        log.write("warning", "quarantined", f"quarantined, among the last: {rejection}")
