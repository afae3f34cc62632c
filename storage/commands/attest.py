"""The command `gyrofleet attest`."""

import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from stream.roles.config_file import configured
from stream.roles.role_log import RoleLog, logged
from stream.terminal.console import counted, notes, print_json, reporting, results, store_option, until_stopped
from stream.terminal.option_checks import about, options_checked

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
@click.option("--every-h", type=click.FloatRange(min=0.01), help="Again each so many hours, until stopped.")
@configured("attest")
@reporting
@logged("attest")
@options_checked(_check)
def attest(
    folder: Path, key: Path | None, out: Path | None, every_h: float | None, timestamp_url: str, *, as_json: bool
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
            kept, signed, unstamped = attest_store(store, signing, timestamp_url=timestamp_url)
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
                    }
                )  # fmt: skip
            RoleLog("attest").write("debug", "attested", f"attested as {kept}", segments=len(stated.segments))
            if not as_json:
                at = datetime.fromtimestamp(stated.at_ns / 1e9, UTC)
                results().print(
                    f"{kept}: {counted(len(stated.segments), 'segment')} and {counted(len(stated.files), 'file')} at "
                    f"{at:%Y-%m-%d %H:%M:%S} UTC, head {stated.head[:12]}, signed by {by}"
                )
            if every_h is None and unstamped:
                sys.exit(1)
            if every_h is None or stopped.wait(every_h * _SECONDS_PER_H):
                break
