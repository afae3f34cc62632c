"""The commands `gyrofleet verify` and `gyrofleet recover`."""

import sys
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click
import msgspec
from click.core import ParameterSource

from storage.commands.lake_address import endpoint_option
from stream.errors import BadInput
from stream.terminal.console import counted, notes, print_json, progress_bar, reporting, results, store_option, styled
from stream.terminal.hints import completed
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

    from storage.attestation.attestation import Attestation
    from storage.attestation.verified_state import VerifiedState
    from storage.findings import Finding, Verification
    from storage.store import Store

_SHOWN_OF_A_KIND = 8
_COLOURS = {"damage": "red", "loss": "red", "unfinished": "yellow", "note": "default"}


@click.command("verify")
@store_option
@click.option(
    "--against", type=click.Path(path_type=Path, dir_okay=False, exists=True),
    help="Also compare with this attestation: nothing before it may have changed.",
)  # fmt: skip
@click.option(
    "--since", metavar="FILE",
    help="Compare what was verified before this attestation by its SHA-256 alone, and read what came since; the word "
    "last stands for the store's own newest one.",
)  # fmt: skip
@click.option(
    "--timestamp-root", type=click.Path(path_type=Path, dir_okay=False),
    help="It needs a time stamp whose authority ends at one of these certificates (PEM).",
)  # fmt: skip
@click.option("--signed-by", default="", metavar="FINGERPRINT", help="Only of this key the attestation counts.")
@click.option(
    "--values", "with_values", is_flag=True,
    help="Also compare every value of the lake with the log: it takes as long as building the lake.",
)  # fmt: skip
@click.option(
    "--lake", "url", metavar="s3://BUCKET/PREFIX", help="Verify the lake published there; with --store by its log too."
)
@endpoint_option
@reporting
def verify(
    folder: Path,
    against: Path | None,
    since: str | None,
    timestamp_root: Path | None,
    signed_by: str,
    url: str | None,
    endpoint_url: str | None,
    *,
    with_values: bool,
    as_json: bool,
) -> None:
    """Read everything in the store and report what is wrong, where, and the remedy; nothing is changed.

    The exit code is 0 only for a sound store: every segment is what was written, the numbers of every stream have no
    gap that the log does not document, the files of the lake are those that were made of these segments, the
    estimators' checkpoints, the error models in use and the copies of the specifications, whose documents in the log
    form an unbroken chain, agree with the log, and so do the store's own attestations (`gyrofleet attest`). Of a fleet
    store every plant is verified. Whoever can write the store can also write a lake whose hashes are right: with
    --values the lake is made again of the log, and its rows are compared. With --since the segments
    that were verified before an attestation (`gyrofleet attest --verify`) are compared by their SHA-256 and not read
    again, unless something is damaged or lost. With
    --lake every object of a published lake is read and compared with its manifest, with --store also with the log.
    """
    if url is not None:
        is_given = click.get_current_context().get_parameter_source("folder") is not ParameterSource.DEFAULT
        _verify_lake(url, endpoint_url, folder if is_given else None, as_json=as_json)
    from storage.attestation.attestation import read_attestation
    from storage.attestation.comparison import against as compared
    from storage.attestation.time_stamp import read_roots
    from storage.check.verify import verify as verify_store
    from storage.fleet_store import is_fleet
    from storage.store import Store

    if timestamp_root is not None and against is None:
        raise BadInput("--timestamp-root is of the time stamp of an attestation; give it by --against FILE")
    if signed_by and against is None and since is None:
        raise BadInput("--signed-by names the key of an attestation; give it by --against FILE or --since FILE")
    if is_fleet(folder):
        if with_values:
            raise BadInput(f"--values is of one plant: give --store {folder}/plants/NAME")
        if against is not None or since is not None:
            raise BadInput(f"an attestation is of one plant: give --store {folder}/plants/NAME")
        _verify_fleet(folder, as_json=as_json)
    store = Store.open(folder)
    stamp: dict[str, object] | None = None
    before = None if since is None else _verified(store, since, signed_by)
    with progress_bar(hidden=as_json) as progress:
        task = progress.add_task(f"reading {folder}", total=1.0)
        found, _ = verify_store(
            store, lambda done: progress.update(task, completed=done), before, with_values=with_values
        )
    if against is not None:
        attestation = read_attestation(against)
        roots = None if timestamp_root is None else read_roots(timestamp_root)
        more = compared(store, attestation, str(against), signed_by, roots)
        # the newest attestation in the store has been compared already, and may say the same
        found = msgspec.structs.replace(found, findings=tuple(dict.fromkeys((*found.findings, *more))))
        stamp = _stamp_of(attestation, roots)
    if as_json:
        content = {name: getattr(found, name) for name in found.__struct_fields__}
        print_json({"sound": found.is_sound, **content} | ({"time_stamp": stamp} if stamp is not None else {}))
        sys.exit(0 if found.is_sound else 1)
    _print_findings(found.findings)
    if stamp is not None:
        known = "" if stamp["is_trusted"] else "; whether to trust it, --timestamp-root says"
        results().print(f"time stamp {stamp['at']} by {stamp['by']}{known}", soft_wrap=True)
    _print_counts(found)
    if before is not None:
        _print_compared(found, before)
    sys.exit(0 if found.is_sound else 1)


def _verified(store: "Store", since: str, signed_by: str) -> "VerifiedState":
    from storage.attestation.verified_state import last_verified_state, verified_state

    return last_verified_state(store, signed_by) if since == "last" else verified_state(store, Path(since), signed_by)


def _print_compared(found: "Verification", before: "VerifiedState") -> None:
    """Which segments were not read, and who signed that they had been verified."""
    at = f"{datetime.fromtimestamp(before.at_ns / 1e9, UTC):%Y-%m-%d %H:%M:%S} UTC"
    signed = f"{before.where}, signed at {at} by {before.signed_by}"
    if not found.since:
        why = "not everything is as it had been verified" if found.is_sound else "something is damaged or lost"
        results().print(f"everything was read: {why} before {signed}", soft_wrap=True)
        return
    results().print(
        f"{counted(found.compared, 'segment')} had been verified before {signed}: their SHA-256 was compared, and "
        f"{counted(found.segments - found.compared, 'segment')} read",
        soft_wrap=True,
    )


def _stamp_of(attestation: "Attestation", roots: "list[Certificate] | None") -> dict[str, object] | None:
    """The time stamp of an attestation; None if it has none that holds."""
    from storage.attestation.time_stamp import check_stamp

    if not attestation.time_stamp or not attestation.is_genuine:
        return None
    found = check_stamp(attestation.time_stamp, attestation.signature_bytes, roots)
    if found.why_not:
        return None
    return {"at": f"{found.at:%Y-%m-%dT%H:%M:%SZ}", "by": found.by, "is_trusted": found.is_trusted}


def _print_findings(findings: "Sequence[Finding]") -> None:
    if not findings:
        return
    table = ResultTable("", "where", "what", "remedy")
    shown: Counter[str] = Counter()
    for finding in findings:
        shown[finding.kind] += 1
        if shown[finding.kind] <= _SHOWN_OF_A_KIND:
            severity = styled(finding.severity, _COLOURS[finding.severity])
            table.add_row(severity, finding.where, finding.what, completed(finding.remedy))
    results().print(table)
    for kind, count in shown.items():
        if count > _SHOWN_OF_A_KIND:
            results().print(f"{count - _SHOWN_OF_A_KIND:,} more of {kind}; --json lists all")


def _print_counts(found: "Verification", what: str = "the store") -> None:
    results().print(
        f"{found.segments:,} segments with {found.samples:,} samples in {found.messages:,} messages, {found.parts:,} "
        f"parts of the lake with {found.lake_samples:,} samples, read in {found.seconds:.1f} s: "
        + (f"{what} is sound" if found.is_sound else f"{what} is NOT sound")
    )
    if found.parts and not found.has_values and what == "the store":
        results().print("the lake's files were hashed, its values not compared with the log: --values compares them")


def _verify_lake(url: str, endpoint_url: str | None, folder: Path | None, *, as_json: bool) -> NoReturn:
    from storage.check.verify_published import verify_published
    from storage.object_lake.bucket import Bucket
    from storage.store import Store

    store = None if folder is None else Store.open(folder)
    bucket = Bucket(url, endpoint_url)
    with progress_bar(hidden=as_json) as progress:
        task = progress.add_task(f"reading {bucket.url}", total=1.0)
        found = verify_published(bucket, store, lambda done: progress.update(task, completed=done))
    if as_json:
        print_json({"sound": found.is_sound, **{name: getattr(found, name) for name in found.__struct_fields__}})
    else:
        _print_findings(found.findings)
        _print_counts(found, "the lake")
    sys.exit(0 if found.is_sound else 1)


def _verify_fleet(folder: Path, *, as_json: bool) -> NoReturn:
    from storage.check.verify_fleet import verify_fleet
    from storage.fleet_store import FleetStore

    fleet = FleetStore.open(folder)
    with progress_bar(hidden=as_json) as progress:
        task = progress.add_task(f"reading {folder}", total=1.0)
        found = verify_fleet(fleet, lambda done: progress.update(task, completed=done))
    if as_json:
        plants = {name: {"sound": each.is_sound, **msgspec.to_builtins(each)} for name, each in found.plants.items()}
        print_json({"sound": found.is_sound, "store": found.store, "plants": plants, "findings": found.findings})
    else:
        for name, each in found.plants.items():
            _print_findings(each.findings)
            _print_counts(each, f"plant {name}")
        _print_findings(found.findings)
        sound = "the fleet store is sound" if found.is_sound else "the fleet store is NOT sound"
        results().print(f"{counted(len(found.plants), 'plant')}: {sound}")
    sys.exit(0 if found.is_sound else 1)


@click.command("recover")
@store_option
@click.option("--quarantine", is_flag=True, help="Also move foreign files from log/ to log/aside.")
@reporting
def recover(folder: Path, *, quarantine: bool, as_json: bool) -> None:
    """Repair what `gyrofleet verify` finds, and verify again; nothing is destroyed.

    Damaged files are kept in log/aside and lake-aside, and the log documents what is lost. Files in the log that are
    not the store's are never read; --quarantine moves them to log/aside.
    """
    from storage.check.recover import Action
    from storage.check.recover import recover as recover_store
    from storage.check.verify import verify as verify_store
    from storage.store import Store

    store, repair = Store.open_or_repair(folder)
    actions = [] if repair is None else [Action("store_marked", str(folder / "store.json"), repair)]
    if repair is not None and not as_json:
        notes().print(f"{folder / 'store.json'}: {repair}", soft_wrap=True, markup=False)
    for action in recover_store(store, quarantine=quarantine):
        actions.append(action)
        if not as_json:
            notes().print(f"{action.what} {action.where}: {action.text}", soft_wrap=True, markup=False)
    found, _ = verify_store(store)
    if as_json:
        print_json({"sound": found.is_sound, "actions": actions, "findings": found.findings})
    else:
        done = f"{len(actions)} steps done" if actions else "nothing to do"
        state = "the store is sound" if found.is_sound else "the store is still NOT sound, see `gyrofleet verify`"
        results().print(completed(f"{done}; {state}"))
    sys.exit(0 if found.is_sound else 1)
