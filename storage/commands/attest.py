"""The command `gyrofleet attest`."""

import os
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stream.errors import BadInput
from stream.roles.config_file import configured
from stream.roles.role_log import RoleLog, logged
from stream.terminal.console import (
    counted,
    print_json,
    reporting,
    results,
    status_listen_option,
    store_option,
    until_stopped,
)
from stream.terminal.option_checks import about, check_listen, options_checked

if TYPE_CHECKING:
    from storage.attestation.attestation import Attestation, Statement

_SECONDS_PER_H = 3600.0


def _check(options: Mapping[str, Any]) -> None:
    from storage.attestation.time_stamp import check_url

    check_listen(options)
    if url := options["timestamp_url"]:
        with about("timestamp_url"):
            check_url(url)


@click.command("attest")
@store_option
@click.option(
    "--key", type=click.Path(path_type=Path, dir_okay=False),
    help="Ed25519 key in PEM; by default attest.pem in ~/.config/gyrofleet, made at its first use.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), help="Also write it here; keep it away from the store."
)
@click.option(
    "--timestamp-url", default="", metavar="URL",
    help="Have each one stamped by this time stamp authority (RFC 3161), as http://timestamp.digicert.com.",
)  # fmt: skip
@click.option(
    "--verify", "is_verified_first", is_flag=True,
    help="Verify the store before, as `gyrofleet verify --since last` does, and sign only a sound one; "
    "`gyrofleet verify --since` builds on it.",
)  # fmt: skip
@click.option("--every-h", type=click.FloatRange(min=0.01), help="Again each so many hours, until stopped.")
@status_listen_option
@configured("attest")
@reporting
@logged("attest")
@options_checked(_check)
def attest(
    folder: Path,
    key: Path | None,
    out: Path | None,
    every_h: float | None,
    timestamp_url: str,
    status_listen: str | None,
    *,
    is_verified_first: bool,
    as_json: bool,
) -> None:
    """Sign what the store's history is now, so that nothing before can change unseen.

    The signature is over every sealed segment with its SHA-256, their order, and the certificates, error models and
    specifications that were issued. `gyrofleet verify --against FILE` compares a store with it. Keep the file, and the
    fingerprint of the key, where those who write the store cannot change them. With --timestamp-url an authority
    proves that it existed at its time; if it does not answer, the exit code is 1 though the attestation is kept. With
    --every-h a store that is not sound is a trouble of `gyrofleet status`, and tried again; so is a full disk.
    """
    from storage.attestation.signing_key import SigningKey, create_key, default_key, fingerprint
    from storage.check.attesting import AttestService
    from storage.recording.status_board import StatusBoard
    from storage.store import Store, check_outside
    from stream.errors import GyrofleetError
    from stream.status.reporter import StatusReporter, served

    store, log = Store.open(folder), RoleLog("attest")
    if out is not None:
        check_outside(store, out)
        _check_writable(out)
    path = key or default_key()
    if not path.exists():
        create_key(path)
        log.write("info", "key_made", f"made the key {path}; its public half is {path.with_suffix('.pub')}")
    signing = SigningKey(path)
    service = AttestService(store, signing, out=out, timestamp_url=timestamp_url, verifies=is_verified_first)
    with until_stopped() as stopped, ExitStack() as stack:
        if every_h is not None:
            stack.enter_context(served(status_listen, service.status))
            stack.enter_context(StatusReporter(service.status, StatusBoard(store).put))
        while True:
            try:
                kept, signed, unstamped = service.round()
            except GyrofleetError as error:
                if every_h is None:
                    raise
                log.write("error", "not_attested", f"not attested, tried again in {every_h:g} h: {error}")
            else:
                if unstamped:
                    log.write("warning", "unstamped", f"attested without a time stamp: {unstamped}")
                _show(log, kept, signed, fingerprint(signing.public), is_once=every_h is None, as_json=as_json)
                if every_h is None and unstamped:
                    sys.exit(1)
            if every_h is None or stopped.wait(every_h * _SECONDS_PER_H):
                break


def _check_writable(out: Path) -> None:
    """BadInput if a file cannot be written there: known before anything is signed."""
    folder = out.parent
    if out.is_dir() or not folder.is_dir() or not os.access(out if out.exists() else folder, os.W_OK):
        raise BadInput(f"--out {out} cannot be written: give a file in a folder that exists and that you may write")


def _show(log: RoleLog, kept: Path, signed: "Attestation", by: str, *, is_once: bool, as_json: bool) -> None:
    """Report an attestation: as the result of the command, or, of one that goes on, as a line of its log."""
    text = _sentence(kept, signed, by)
    if as_json:
        _print_json(kept, signed, by)
    elif is_once:
        results().print(text, soft_wrap=True)
    log.write("debug" if is_once else "info", "attested", text, segments=len(signed.stated.segments))


def _print_json(kept: Path, signed: "Attestation", by: str) -> None:
    stated = signed.stated
    print_json(
        {
            "attestation": str(kept), "at_ns": stated.at_ns, "store": stated.store, "head": stated.head,
            "segments": len(stated.segments), "files": len(stated.files), "signed_by": by,
            "is_stamped": bool(signed.time_stamp),
            "unverified": None if stated.unverified is None else len(stated.unverified),
        }
    )  # fmt: skip


def _sentence(kept: Path, signed: "Attestation", by: str) -> str:
    stated = signed.stated
    at = datetime.fromtimestamp(stated.at_ns / 1e9, UTC)
    return (
        f"{kept}: {counted(len(stated.segments), 'segment')} and {counted(len(stated.files), 'file')} at "
        f"{at:%Y-%m-%d %H:%M:%S} UTC, head {stated.head[:12]}, signed by {by}{_verified_words(stated)}"
    )


def _verified_words(stated: "Statement") -> str:
    if stated.unverified is None:
        return ""
    later = f", but {counted(len(stated.unverified), 'segment')} sealed since" if stated.unverified else ""
    return f"; the store was verified before and is sound{later}"
