"""The command `gyrofleet replicate`."""

import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import msgspec

from storage.commands.lake_address import endpoint_option
from storage.replication.addresses import check_distinct, is_bucket
from stream.errors import BadInput
from stream.roles.config_file import configured
from stream.roles.role_log import RoleLog, logged
from stream.security.rights import Role
from stream.terminal.console import (
    NoProgress,
    counted,
    notes,
    print_json,
    progress_bar,
    reporting,
    results,
    until_stopped,
)
from stream.terminal.option_checks import about, options_checked
from stream.terminal.result_table import ResultTable
from stream.terminal.security_options import check_one_address, secured

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

    from storage.replication.progress import Progress, Refusal
    from storage.replication.service import Pass

_EVERY_S = 2.0
_ENDPOINT = "tcp/127.0.0.1:7448"


def _check(options: Mapping[str, Any]) -> None:
    """BadInput if the options do not go together, or name a plant twice."""
    from storage.plant import check_plant_name

    if options["plant"] is not None:
        with about("plant"):
            check_plant_name(options["plant"])
    sources, target = options["sources"], options["target"]
    if options["serves"]:
        if options["folder"] is None or sources or target is not None:
            with about("folder" if options["folder"] is None else "sources" if sources else "target"):
                raise BadInput(
                    "--serve takes --store, and --listen or --connect; --from and --to are of the other side"
                )
        check_one_address(options)
        return
    for name in ("folder", "listen", "connect"):
        if options[name]:
            with about(name):
                raise BadInput("--store, --listen and --connect go with --serve; else give --from PLANT and --to FLEET")
    if not sources or target is None:
        with about("target" if sources else "sources"):
            raise BadInput("give --from PLANT and --to FLEET")
    _check_addresses(options, sources, target)


def _check_addresses(options: Mapping[str, Any], sources: tuple[str, ...], target: str) -> None:
    from storage.object_lake.address import check_service, parse_bucket

    with about("sources"):
        check_distinct(sources)
        for each in filter(is_bucket, sources):
            parse_bucket(each)
    with about("endpoint_url"):
        if any(is_bucket(each) for each in (*sources, target)):
            check_service(options["endpoint_url"])
        elif options["endpoint_url"] is not None:
            raise BadInput("--endpoint-url is of an object store: give s3://BUCKET/PREFIX with --from or --to")
    with about("target"):
        if is_bucket(target):
            parse_bucket(target)
            if options["recalls"] or options["no_lake"]:
                raise BadInput("--recall and --no-lake go with a --to that is a folder; a bucket is only ever added to")


@click.command("replicate")
@click.option(
    "--from", "sources", multiple=True, metavar="PLANT",
    help="A plant: its store's folder, its s3://BUCKET/PREFIX, or the endpoint that serves it; may be repeated. A "
    "fleet store: its plants.",
)  # fmt: skip
@click.option(
    "--to", "target", metavar="FLEET", help="Folder of the fleet store; or s3://BUCKET/PREFIX, of one plant, to upload."
)
@endpoint_option
@click.option("--plant", metavar="NAME", help="Name of the plant at its first use, else its folder's; then which one.")
@click.option("--watch", "is_watch", is_flag=True, help="Keep following, until stopped.")
@click.option(
    "--bandwidth", type=click.FloatRange(min=1), metavar="BYTES_PER_S", help="Limit of all plants together; as 2e6."
)
@click.option(
    "--serve", "serves", is_flag=True, help="Serve a plant's segments to fleet stores instead, until stopped."
)
@click.option("--store", "folder", type=click.Path(path_type=Path), help="With --serve: the store, or a fleet store.")
@click.option("--listen", metavar="ENDPOINT", help="With --serve: address.  [default: tcp/127.0.0.1:7448]")
@click.option("--connect", metavar="ENDPOINT", help="With --serve: a `gyrofleet router` instead of --listen.")
@click.option("--recall", "recalls", is_flag=True, help="Read all of --to; fetch what is lost or damaged.")
@click.option("--no-lake", is_flag=True, help="Leave the lakes to `gyrofleet rebuild`, or to a later pass.")
@configured("replicate")
@reporting
@logged("replicate")
@options_checked(_check)
@secured(Role.FLEET, Role.RECORDER)
def replicate(
    sources: tuple[str, ...], target: str | None, endpoint_url: str | None, plant: str | None,
    bandwidth: float | None, folder: Path | None, listen: str | None, connect: str | None, *, is_watch: bool,
    serves: bool, recalls: bool, no_lake: bool, as_json: bool,
) -> None:  # fmt: skip
    """Copy the sealed segments of plants into a fleet store, each once, verified at arrival.

    What a plant sends can only continue its own history: a changed segment, a fork of its list, or a wrong hash is
    refused and reported, and the exit code is 1. A pass that is cut off resumes where it was.

    With --recall a segment that was lost on one side comes from the other: --to is the fleet store, or the store of a
    plant whose copy --from has; an empty folder becomes the plant's store again.

    Over a bucket, the plant uploads and the fleet store's side fetches; credentials and region come from AWS_*. A
    prefix is that of one plant, whose history there is only ever continued.

    \b
    gyrofleet replicate --from night --to fleet --plant hangzhou
    gyrofleet replicate --serve --store night --listen tcp/0.0.0.0:7448
    gyrofleet replicate --from tcp/10.0.0.7:7448 --to fleet --watch
    gyrofleet replicate --from night --to s3://gyros/hangzhou --watch
    gyrofleet replicate --from s3://gyros/hangzhou --to fleet --watch
    """  # noqa: D301  click's mark for lines that are not to be joined
    if serves and folder is not None:
        _serve(folder, listen, connect, plant, as_json=as_json)
        return
    assert target is not None  # else `_check` has refused it
    _copy(_Asked(sources, target, endpoint_url, plant, bandwidth, is_watch, as_json), recalls=recalls, no_lake=no_lake)


class _Asked(NamedTuple):
    """What is to be copied."""

    sources: tuple[str, ...]
    target: str
    endpoint_url: str | None
    plant: str | None
    bandwidth: float | None
    is_watch: bool
    as_json: bool


def _copy(asked: _Asked, *, recalls: bool, no_lake: bool) -> None:
    from storage.fleet_store import is_fleet

    if is_bucket(asked.target):
        _upload(asked)
    elif recalls and not (is_fleet(Path(asked.target)) or asked.is_watch):
        _recall(asked)
    else:
        _fetch(asked, recalls=recalls, no_lake=no_lake)


def _fetch(asked: _Asked, *, recalls: bool, no_lake: bool) -> None:
    """Bring what plants have into a fleet store, once or until stopped."""
    from storage.replication.arriving.bandwidth import Bandwidth
    from storage.replication.fleet_target import fleet_target
    from storage.replication.opened import opened_sources
    from storage.replication.service import Replication

    with (
        until_stopped() as stopped,
        progress_bar(hidden=asked.as_json) as bar,
        opened_sources(asked.sources, asked.plant, asked.endpoint_url) as opened,
        fleet_target(Path(asked.target)) as fleet,
    ):
        replication = Replication(
            fleet, bandwidth=Bandwidth(asked.bandwidth, sleep=stopped.wait),
            builds_lakes=not no_lake, rereads=recalls, report=_Shown(bar),
            stopped=lambda: stopped.asked_at is not None,
        )  # fmt: skip
        shown: object = None
        while True:
            found = replication.run(opened)
            state = (found.conflicts, found.lakes, [(each.refused, each.trouble, each.lag) for each in found.plants])
            if not asked.is_watch or found.added or found.added_files or state != shown:
                shown = state
                if asked.as_json:
                    print_json(
                        {"is_well": found.is_well, **{name: getattr(found, name) for name in found.__struct_fields__}}
                    )
                else:
                    _print(found)
                _log(found)
            if not asked.is_watch or stopped.wait(_EVERY_S):
                break
    sys.exit(0 if found.is_well or asked.is_watch else 1)


def _serve(folder: Path, listen: str | None, connect: str | None, plant: str | None, *, as_json: bool) -> None:
    from contextlib import ExitStack

    from storage.fleet_store import FleetStore, is_fleet
    from storage.replication.sources.bus_server import PlantServer
    from storage.replication.sources.folder_source import FolderSource
    from stream.transport.zenoh_bus import ZenohBus

    folders = [folder]
    if is_fleet(folder):
        fleet = FleetStore.open(folder)
        folders = [each.store.folder for each in (fleet.replicas() if plant is None else [fleet.replica(plant)])]
    endpoint = connect or listen or _ENDPOINT
    with until_stopped() as stopped, ExitStack() as stack:
        bus = stack.enter_context(ZenohBus(listen=[] if connect else [endpoint], connect=[connect] if connect else []))
        names = [
            PlantServer(bus, stack.enter_context(FolderSource(each, None if is_fleet(folder) else plant))).plant.name
            for each in folders
        ]
        if as_json:
            print_json({"event": "serving", "plants": names, "listen": endpoint})
        text = f"serving {', '.join(names)} at {endpoint}; Ctrl-C ends"
        RoleLog("replicate").write("info", "serving", text, listen=endpoint)
        while not stopped.wait(1.0):
            pass


def _upload(asked: _Asked) -> None:
    """Upload one plant's segments into a bucket, once or until stopped."""
    from storage.object_lake.bucket import Bucket
    from storage.replication.arriving.bandwidth import Bandwidth
    from storage.replication.bucket_upload import BucketUpload
    from storage.replication.opened import opened_sources
    from storage.replication.sources.folder_source import FolderSource

    with (
        until_stopped() as stopped,
        progress_bar(hidden=asked.as_json) as bar,
        opened_sources(asked.sources, asked.plant) as opened,
    ):
        if len(opened) != 1 or not isinstance(opened[0], FolderSource):
            raise BadInput(f"a prefix of a bucket is one plant's: give one --from with its folder for {asked.target}")
        task = bar.add_task(asked.target, total=None)
        upload = BucketUpload(
            opened[0], Bucket(asked.target, asked.endpoint_url),
            bandwidth=Bandwidth(asked.bandwidth, sleep=stopped.wait), on_bytes=lambda size: bar.advance(task, size),
            stopped=lambda: stopped.asked_at is not None,
        )  # fmt: skip
        shown: object = None
        while True:
            found = upload.run()
            state = (found.refused, found.notes, found.trouble)
            if not asked.is_watch or found.added or found.added_files or state != shown:
                shown = state
                if asked.as_json:
                    print_json({"is_well": found.is_well, **msgspec.to_builtins(found)})
                else:
                    results().print(
                        f"{counted(found.added, 'segment')} of {found.plant or opened[0].where} uploaded, "
                        f"{found.added_bytes:,} bytes, and {counted(found.added_files, 'file')}; "
                        f"{found.segments:,} lines of its list are in {found.to}"
                    )
                _log_plant(RoleLog("replicate"), found.plant, found.notes, found.refused, found.trouble)
            if not asked.is_watch or stopped.wait(_EVERY_S):
                break
    sys.exit(0 if found.is_well or asked.is_watch else 1)


def _recall(asked: _Asked) -> None:
    from storage.replication.arriving.bandwidth import Bandwidth
    from storage.replication.opened import recalled_from
    from storage.replication.recall import recall

    if len(asked.sources) != 1:
        raise BadInput("--recall brings one store back: give one --from")
    target = Path(asked.target)
    with until_stopped() as stopped, recalled_from(asked.sources[0], target, asked.plant, asked.endpoint_url) as source:
        limit = Bandwidth(asked.bandwidth, sleep=stopped.wait)
        found = recall(target, source, bandwidth=limit, stopped=lambda: stopped.asked_at is not None)
    if asked.as_json:
        print_json({"is_well": found.is_well, **msgspec.to_builtins(found)})
    else:
        results().print(
            f"{counted(len(found.segments), 'segment')} of {found.plant} came back, {found.bytes:,} bytes, and "
            f"{counted(found.files, 'file')}; {found.intact:,} segments were intact"
        )
        for path in found.aside:
            notes().print(f"quarantined: {path}", soft_wrap=True, markup=False)
        for refusal in found.refused:
            notes().print(f"refused: {refusal.segment}: {refusal.what}", soft_wrap=True, markup=False)
        if found.trouble:
            notes().print(f"trouble: {found.trouble}", soft_wrap=True, markup=False)
    sys.exit(0 if found.is_well else 1)


class _Shown:
    """Shows the bytes that arrive in a bar for each plant."""

    def __init__(self, bar: "Bar | NoProgress") -> None:
        self._bar = bar
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, progress: "Progress") -> None:
        task = self._tasks.get(progress.plant)
        if task is None:
            task = self._tasks[progress.plant] = self._bar.add_task(progress.plant, total=None)
        total = progress.transferred_bytes + progress.lag.bytes
        self._bar.update(task, completed=progress.transferred_bytes, total=max(total, 1))


def _print(found: "Pass") -> None:
    table = ResultTable("plant", "added", "bytes", "files", "segments", "behind")
    for each in found.plants:
        lag = (
            f"{each.lag.segments:,} segments, {each.lag.bytes:,} B, {each.lag.seconds:,.0f} s"
            if each.lag.segments
            else "-"
        )
        table.add_row(
            each.plant or "?",
            f"{each.added:,}",
            f"{each.added_bytes:,}",
            f"{each.added_files:,}",
            f"{each.segments:,}",
            lag,
        )
    results().print(table)


def _log(found: "Pass") -> None:
    """Log what was noted, refused, or went wrong in a pass."""
    log = RoleLog("replicate")
    for each in found.plants:
        _log_plant(log, each.plant, each.notes, each.refused, each.trouble)
    for plant, why in found.lakes.items():
        log.write("warning", "trouble", f"trouble: the lake of {plant}: {why}", plant=plant)
    for conflict in found.conflicts:
        log.write("warning", "conflict", f"conflict: {conflict}")


def _log_plant(
    log: RoleLog, plant: str, found_notes: "Iterable[str]", refused: "Iterable[Refusal]", trouble: str
) -> None:
    who = f"{plant}: " if plant else ""  # one that has sealed nothing, or does not answer, has no name yet
    for note in found_notes:
        log.write("info", "note", f"note: {who}{note}", plant=plant)
    for refusal in refused:
        where = " ".join(each for each in (plant, refusal.segment) if each)
        log.write("warning", "refused", f"refused: {where}: {refusal.what}", plant=plant)
    if trouble:
        log.write("warning", "trouble", f"trouble: {who}{trouble}", plant=plant)
