"""The commands `gyrofleet lake`, `gyrofleet rebuild` and `gyrofleet retain`."""

import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from storage.commands.lake_address import endpoint_option
from stream.errors import BadInput
from stream.roles.config_file import configured
from stream.roles.role_log import RoleLog, logged
from stream.terminal.console import (
    notes,
    print_json,
    progress_bar,
    reporting,
    status_listen_option,
    store_option,
    until_stopped,
)
from stream.terminal.option_checks import about, check_listen, options_checked

if TYPE_CHECKING:
    from storage.store import Store
    from storage.upkeep.retention import Dropped, Rule

_POLL_S = 0.5
_PATIENCE_S = 10.0  # a recorder builds for some seconds at a time

_older_than = click.option(
    "--older-than", metavar="AGE", help="Drop raw rows that arrived longer ago, like 90d or 12h."
)
_max_size = click.option("--max-size", metavar="SIZE", help="Drop the oldest raw rows beyond this size, like 500GB.")


def _check(options: Mapping[str, Any]) -> None:
    from storage.object_lake.address import check_service, parse_bucket

    check_listen(options)
    for name in ("older_than", "max_size"):
        with about(name):
            _rule(**{"older_than": None, "max_size": None, name: options[name]})
    url, endpoint_url = options["url"], options["endpoint_url"]
    if url is not None:
        with about("url"):
            parse_bucket(url)
        with about("endpoint_url"):
            check_service(endpoint_url)
    elif options["repair"] or endpoint_url is not None:
        with about("repair" if options["repair"] else "endpoint_url"):
            raise BadInput(
                "--repair and --endpoint-url are of a published lake: give --lake s3://BUCKET/PREFIX as well"
            )


@click.command("lake")
@store_option
@click.option("--once", is_flag=True, help="Do what is due, and end.")
@click.option(
    "--grace-s", type=click.FloatRange(min=0), default=3600.0, show_default=True,
    help="Seconds that replaced files stay for running queries.",
)  # fmt: skip
@_older_than
@_max_size
@click.option(
    "--lake", "url", metavar="s3://BUCKET/PREFIX", help="Also publish it there, on an object store with the S3 API."
)
@endpoint_option
@click.option("--repair", is_flag=True, help="Verify what is published first, and publish damaged parts again.")
@status_listen_option
@configured("lake")
@reporting
@logged("lake")
@options_checked(_check)
def lake(
    folder: Path, grace_s: float, older_than: str | None, max_size: str | None, url: str | None,
    endpoint_url: str | None, status_listen: str | None, *, once: bool, repair: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Build the lake from sealed segments as they appear, until stopped.

    The parts of a finished day (UTC) are merged into one, small parts of the present day into few. With --older-than or
    --max-size raw rows are dropped as by `gyrofleet retain`. With --lake the lake is published on an object store, for
    `gyrofleet sql --lake` and `gyrofleet metrics --lake`; credentials and region come from AWS_*. Several builders may
    publish one store at once.
    """
    from storage.lake.builder import builder_lock
    from storage.recording.status_board import StatusBoard
    from storage.store import Store
    from storage.upkeep.service import LakeService
    from stream.errors import StoreError
    from stream.status.reporter import StatusReporter, served

    log = RoleLog("lake")
    store = Store.open(folder)
    rule = None if older_than is None and max_size is None else _rule(older_than, max_size)

    def report(event: str, text: str, **numbers: object) -> None:
        if as_json:
            print_json({"event": event, "text": text, **numbers})
        log.write("info", event, text, **numbers)

    publisher = None
    if url is not None:
        from storage.object_lake.bucket import Bucket
        from storage.object_lake.publisher import Publisher

        bucket = Bucket(url, endpoint_url)
        damaged: set[str] = set()
        if repair:
            from storage.check.verify_published import damaged_parts, verify_published

            damaged = damaged_parts(bucket, verify_published(bucket, store))
            report("verified", f"{len(damaged)} published parts are damaged", damaged=len(damaged))
        publisher = Publisher(store, bucket, grace_s=grace_s, report=report, damaged=damaged)
    with builder_lock(store), until_stopped() as stopped, ExitStack() as stack:
        service = LakeService(store, report=report, rule=rule, grace_s=grace_s, publisher=publisher)
        if not once:
            stack.enter_context(served(status_listen, service.status))
            stack.enter_context(StatusReporter(service.status, StatusBoard(store).put))
            report("building", f"building the lake of {folder} from sealed segments; Ctrl-C ends")
        while True:
            problems = service.round(stopped)
            if once or stopped.wait(_POLL_S):
                break
    sent: dict[str, object] = {}
    ended = f"{service.segments} segments brought to the lake, {service.compacted} parts merged"
    if publisher is not None:
        ended += f"; {publisher.parts} parts published, {publisher.bytes:,} bytes sent"
        sent = {"parts_published": publisher.parts, "bytes_sent": publisher.bytes}
    report("ended", ended, **sent)
    if once and problems:
        raise StoreError("; ".join(problems))


@click.command("rebuild")
@store_option
@click.option("--force", is_flag=True, help="Also if the old lake holds more than the log.")
@click.option("--raw", is_flag=True, help="Only restore dropped raw rows, as far as the log has them.")
@reporting
def rebuild(folder: Path, *, force: bool, raw: bool, as_json: bool) -> None:
    """Rebuild the lake from the log, beside the old one, which is replaced when the new one is complete.

    What retention has dropped stays dropped; --raw restores it. Both are documented in the log. After a kill the old
    lake is in force, and the same command resumes.
    """
    if raw:
        _restore(folder, as_json=as_json)
        return
    from storage.lake.rebuild import rebuild as steps
    from storage.manifests.lake import left_aside, read_manifest
    from storage.store import Store

    store = Store.open(folder)
    with _patient_lock(store, as_json=as_json), progress_bar(hidden=as_json) as progress:
        task = progress.add_task("segments", total=None)
        for built, of in steps(store, force=force):
            progress.update(task, completed=built, total=of)
    manifest = read_manifest(store)
    done = {
        "segments": len(manifest.segments), "parts": len(manifest.parts),
        "samples": sum(part.samples for part in manifest.parts), "aside": [str(path) for path in left_aside(store)],
    }  # fmt: skip
    if as_json:
        print_json(done)
        return
    console = notes()
    console.print(f"{done['segments']} segments with {done['samples']:,} samples are in the new lake of {folder}")
    for path in left_aside(store):
        console.print(f"quarantined: {path}", soft_wrap=True)


def _restore(folder: Path, *, as_json: bool) -> None:
    from storage.lake.builder import build_missing
    from storage.lake.lake import Lake
    from storage.store import Store
    from storage.upkeep.retention import restore_raw

    store = Store.open(folder)
    with _patient_lock(store, as_json=as_json):
        lake = Lake(store)
        wanted = len(lake.manifest.dropped)
        restored = restore_raw(lake)
        gone = len(lake.manifest.dropped)
        list(build_missing(store))  # the document of it, if no recorder has taken it
    if as_json:
        print_json({"segments": wanted - gone, "segments_gone": gone, "samples": restored.samples})
        return
    console = notes()
    console.print(f"{restored.samples:,} samples of {wanted - gone} segments have raw rows in the lake again")
    if gone:
        console.print(f"{gone} segments are no longer in the log; their rollups and estimates stay", soft_wrap=True)


@click.command("retain")
@store_option
@_older_than
@_max_size
@click.option("--trust-clock", is_flag=True, help="The clock is right, although it has leapt since the last check.")
@click.option("--dry-run", is_flag=True, help="Only report what would be dropped.")
@reporting
def retain(
    folder: Path, older_than: str | None, max_size: str | None, *, trust_clock: bool, dry_run: bool, as_json: bool
) -> None:
    """Drop raw rows of the oldest parts of the lake; rollups, estimates, events and the log stay.

    A document in the log lists what is dropped, beforehand. After a leap of the clock nothing is dropped by age without
    --trust-clock. `gyrofleet rebuild --raw` restores what the log still has.
    """
    from storage.lake.builder import build_missing
    from storage.lake.lake import Lake
    from storage.manifests.lake import read_manifest
    from storage.store import Store
    from storage.upkeep.retention import apply_rule, would_drop
    from storage.upkeep.retention_clock import trust_clock as trust

    if older_than is None and max_size is None:
        raise BadInput("give --older-than AGE or --max-size SIZE, or both")
    rule = _rule(older_than, max_size)
    store = Store.open(folder)
    if dry_run:
        dropped = would_drop(read_manifest(store), rule)
    else:
        with _patient_lock(store, as_json=as_json):
            if trust_clock:
                trust(store, time.time_ns())
            dropped = apply_rule(Lake(store), rule)
            list(build_missing(store))  # the document of it, if no recorder has taken it
    if as_json:
        print_json({"dry_run": dry_run, **dropped._asdict()})
    else:
        notes().print(describe(dropped, rule, dry_run=dry_run), soft_wrap=True)


def _patient_lock(store: "Store", *, as_json: bool) -> AbstractContextManager[None]:
    from storage.lake.builder import builder_lock

    if not as_json:
        notes().print(f"waiting up to {_PATIENCE_S:g} s for another builder of the lake")
    return builder_lock(store, patience_s=_PATIENCE_S)


def describe(dropped: "Dropped", rule: "Rule", *, dry_run: bool = False) -> str:
    """What retention did, in one line.

    >>> from storage.upkeep.retention import Dropped, Rule
    >>> describe(Dropped(1, 2, 3000, 4000), Rule(max_bytes=10))
    'dropped: raw rows of 3,000 samples in 2 segments, 4,000 bytes (beyond 10 bytes)'
    """
    if not dropped.parts:
        return f"nothing is {rule}"
    would = "would be dropped" if dry_run else "dropped"
    return (
        f"{would}: raw rows of {dropped.samples:,} samples in {dropped.segments} segments, {dropped.bytes:,} bytes "
        f"({rule})"
    )


def _rule(older_than: str | None, max_size: str | None) -> "Rule":
    from storage.upkeep.retention import Rule, parse_age, parse_size

    return Rule(
        None if older_than is None else parse_age(older_than), None if max_size is None else parse_size(max_size)
    )
