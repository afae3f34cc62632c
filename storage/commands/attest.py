"""The command `gyrofleet attest`."""

import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stream.roles.config_file import configured
from stream.roles.role_log import RoleLog, logged
from stream.terminal.console import counted, notes, print_json, reporting, results, store_option, until_stopped
from stream.terminal.option_checks import about, options_checked

if TYPE_CHECKING:
    from storage.attestation.attestation import Statement
    from storage.manifests.entries import SegmentEntry
    from storage.store import Store

_SECONDS_PER_H = 3600.0


def _check(options: Mapping[str, Any]) -> None:
    from storage.attestation.time_stamp import check_url

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
    *,
    is_verified_first: bool,
    as_json: bool,
) -> None:
    """Sign what the store's history is now, so that nothing before can change unseen.

    The signature is over every sealed segment with its SHA-256, their order, and the certificates, error models and
    specifications that were issued. `gyrofleet verify --against FILE` compares a store with it. Keep the file, and the
    fingerprint of the key, where those who write the store cannot change them. With --timestamp-url an authority
    proves that it existed at its time; if it does not answer, the exit code is 1 though the attestation is kept.
    """
    from storage.attestation.attestation import attest as attest_store
    from storage.attestation.signing_key import SigningKey, create_key, default_key, fingerprint
    from storage.store import Store, check_outside
    from stream.atomic_file import write_durably

    store = Store.open(folder)
    if out is not None:
        check_outside(store, out)
    path = key or default_key()
    if not path.exists():
        create_key(path)
        notes().print(f"made the key {path}; its public half is {path.with_suffix('.pub')}", soft_wrap=True)
    signing = SigningKey(path)
    with until_stopped() as stopped:
        while True:
            verified = _verified(store, fingerprint(signing.public)) if is_verified_first else None
            kept, signed, unstamped = attest_store(store, signing, timestamp_url=timestamp_url, verified=verified)
            if unstamped:
                RoleLog("attest").write("warning", "unstamped", f"attested without a time stamp: {unstamped}")
            if out is not None:
                write_durably(out, kept.read_bytes())
            stated, by = signed.stated, fingerprint(signing.public)
            if as_json:
                print_json(
                    {
                        "attestation": str(kept), "at_ns": stated.at_ns, "store": stated.store, "head": stated.head,
                        "segments": len(stated.segments), "files": len(stated.files), "signed_by": by,
                        "is_stamped": bool(signed.time_stamp),
                        "unverified": None if stated.unverified is None else len(stated.unverified),
                    }
                )  # fmt: skip
            RoleLog("attest").write("debug", "attested", f"attested as {kept}", segments=len(stated.segments))
            if not as_json:
                at = datetime.fromtimestamp(stated.at_ns / 1e9, UTC)
                results().print(
                    f"{kept}: {counted(len(stated.segments), 'segment')} and {counted(len(stated.files), 'file')} at "
                    f"{at:%Y-%m-%d %H:%M:%S} UTC, head {stated.head[:12]}, signed by {by}{_verified_words(stated)}"
                )
            if every_h is None and unstamped:
                sys.exit(1)
            if every_h is None or stopped.wait(every_h * _SECONDS_PER_H):
                break


def _verified(store: "Store", signer: str) -> "Mapping[str, SegmentEntry]":
    """Entries of the segments of a store that is sound; StoreError if it is not."""
    from storage.attestation.verified_state import newest_verified_state
    from storage.check.verify import verify
    from storage.findings import Severity
    from stream.errors import StoreError

    found, state = verify(store, since=newest_verified_state(store, signer))
    if not found.is_sound:
        wrong = [each for each in found.findings if each.severity is not Severity.NOTE]
        raise StoreError(
            f"{store.folder} is not sound, nothing is signed: {wrong[0].where}: {wrong[0].what}"
            + (f"; and {counted(len(wrong) - 1, 'finding')} more" if len(wrong) > 1 else "")
            + ". `gyrofleet verify` lists all"
        )
    return {name: entry for name, entry in state.entries.items() if name in state.samples}


def _verified_words(stated: "Statement") -> str:
    if stated.unverified is None:
        return ""
    later = f", but {counted(len(stated.unverified), 'segment')} sealed since" if stated.unverified else ""
    return f"; the store was verified before and is sound{later}"
