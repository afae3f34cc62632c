"""The command `gyrofleet certificate`: calibration certificates of units, and whether a file is one."""

import datetime as dt
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from analytics.commands.evaluation.limits import by_option
from analytics.commands.evaluation.metrics import opened_catalog
from storage.commands.stored_names import UNIT
from stream.errors import BadInput
from stream.security.actor import acting
from stream.security.rights import Role
from stream.terminal.command_group import CommandGroup
from stream.terminal.console import notes, print_json, reporting, results, store_option
from stream.terminal.security_options import secured

if TYPE_CHECKING:
    from analytics.certificate.issue import Issued
    from analytics.certificate.statement.words import Language
    from analytics.certificate.verification import Verified
    from storage.store import Store


@click.group("certificate", cls=CommandGroup, invoke_without_command=True)
@store_option
@click.option("--unit", type=UNIT, help="The calibrated unit.")
@click.option("--standard", help="JJF2014 (vibratory rate gyros) or JJF1536 (attitude units).")
@click.option(
    "--order", "order_path", type=click.Path(path_type=Path, dir_okay=False),
    help="TOML file with the laboratory, customer, references, environment, people; without it a draft is written.",
)  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="The PDF; the XML is written beside it.")
@click.option(
    "--lang", "language", type=click.Choice(["both", "zh", "en"]), default="both", show_default=True,
    help="Language.",
)  # fmt: skip
@click.option("--number", default="", help="Its number; by default the next free one, with the prefix of the order.")
@click.option("--supersedes", default="", metavar="NUMBER", help="The certificate that this one replaces.")
@click.option("--reason", default="", help="Why it is replaced.")
@click.option("--draft", "as_draft", is_flag=True, help="Write a draft, and issue nothing.")
@click.option("--key", type=click.Path(path_type=Path, dir_okay=False), help="Sign with this PKCS #12 file (.p12).")
@click.option(
    "--key-passphrase", envvar="GYROFLEET_KEY_PASSPHRASE", metavar="TEXT",
    help="Passphrase of the key; better as GYROFLEET_KEY_PASSPHRASE, or asked for.",
)  # fmt: skip
@by_option
@click.pass_context
@reporting
@secured(Role.APPROVER, Role.RECORDER, is_group=True)
def certificate(
    context: click.Context, folder: Path, unit: str | None, standard: str | None, order_path: Path | None,
    out: Path | None, language: "Language", number: str, supersedes: str, reason: str, key: Path | None,
    key_passphrase: str | None, by: str | None, *, as_draft: bool, as_json: bool,
) -> None:  # fmt: skip
    """Write a calibration certificate of a unit (PDF/A, with a digital certificate), or a draft of what is missing.

    A certificate is issued, and entered in the log, only where nothing is missing.

    \b
    gyrofleet certificate --unit G-1 --standard JJF2014 --order O.toml --out G.pdf
    gyrofleet certificate verify G.pdf
    """  # noqa: D301  click's mark for lines that are not to be joined
    if context.invoked_subcommand is not None:
        return
    if unit is None or standard is None or out is None:
        raise BadInput("give --unit, --standard and --out, or `gyrofleet certificate verify FILE`")
    from analytics.certificate.document.signature import sign
    from analytics.certificate.issue import Wanted, issue_certificate
    from analytics.certificate.statement.order import read_order
    from analytics.certificate.statement.standards import standard_of

    if key is not None and key_passphrase is None:
        key_passphrase = click.prompt("Passphrase of the key", hide_input=True, err=True)
    wanted = Wanted(
        unit=unit, standard=standard_of(standard), order=read_order(order_path), language=language, out=out,
        number=number, supersedes=supersedes, reason=reason, as_draft=as_draft,
        sign=None if key is None else partial(sign, key=key, passphrase=key_passphrase or "", reason="issue"),
        by=acting(by),
    )  # fmt: skip
    with opened_catalog(folder, quiet=as_json, is_anew=True) as catalog:
        issued = issue_certificate(catalog, wanted)
        if not issued.is_draft and issued.proposal is None:
            _attest(catalog.store)
    if as_json:
        print_json(issued)
    else:
        _print_issued(issued, out, language)


def _attest(store: "Store") -> None:
    """Anchor the store's history with the certificate in it, where the user has a key that attests."""
    from storage.attestation.attestation import attest
    from storage.attestation.signing_key import SigningKey, default_key

    if default_key().exists():
        kept = attest(store, SigningKey(default_key())).path
        notes().print(f"attested: {kept}", soft_wrap=True)


def _print_issued(issued: "Issued", out: Path, language: str) -> None:
    for each in issued.left_out:
        notes().print(f"stated in it: {each}", soft_wrap=True)
    if issued.is_draft:
        count, missing = len(issued.missing), issued.missing_zh if language == "zh" else issued.missing
        of = f"：草稿，未签发；尚缺 {count} 项" if language == "zh" else f": a draft, not issued; missing: {count}"
        notes().print(f"{out}{of}", soft_wrap=True)
        for each in missing:
            notes().print(f"  {each}", soft_wrap=True)
        return
    if issued.proposal is not None:
        wait = "it is issued once another person approves, and is then in the store's folder certificates"
        results().print(f"{out}: certificate {issued.number} is proposed as {issued.proposal[:12]}; {wait}")
        return
    until = "" if issued.valid_until is None else f", valid until {issued.valid_until}"
    results().print(f"{out}: certificate {issued.number}{until}; SHA-256 {issued.sha256}")


@certificate.command("verify")
@store_option
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--trust", type=click.Path(path_type=Path, dir_okay=False), help="Certificates (PEM) whose signatures are trusted."
)
@reporting
def verify(folder: Path, file: Path, trust: Path | None, *, as_json: bool) -> None:
    """Say whether a PDF is a certificate of this store, unchanged, and still valid; exit code 1 if not.

    The results of a genuine one are computed again from the store: those that have changed since are listed, as are its
    statements of conformity that the store judges differently, or by a revision withdrawn since; the exit code is 1.
    `valid` in --json is of the document alone: not superseded, its validity not over, with --trust a trusted signature.
    """
    from analytics.certificate.record import read_certificates
    from analytics.certificate.reproduction import changed_results, changed_statements
    from analytics.certificate.statement.evidence import zone_of
    from analytics.certificate.verification import verify_certificate

    with opened_catalog(folder, quiet=as_json, is_anew=True) as catalog:
        known = read_certificates(catalog.store, catalog)
        found = verify_certificate(
            file, known, trust=trust, now=dt.datetime.now(dt.UTC), zone_of=partial(zone_of, catalog)
        )
        document = known.by_number(found.number) if found.number else None
        if document is not None:
            changed = [*changed_results(catalog, document), *changed_statements(catalog, document)]
            found = msgspec.structs.replace(found, changed=changed)
    if as_json:
        print_json(found)
    else:
        _print_verified(found, file)
    if not (found.genuine and found.valid) or found.changed:
        sys.exit(1)


def _print_verified(found: "Verified", file: Path) -> None:
    state = "genuine and valid" if found.valid else "genuine, not valid" if found.genuine else "not genuine"
    if found.changed:
        state = f"{'genuine' if found.valid else state}; the store computes or judges it differently today"
    of = f": certificate {found.number} of {found.unit}, issued {found.issued}" if found.genuine else ""
    results().print(f"{file}: {state}{of}", soft_wrap=True)
    for each in (*found.why, *(found.changed or [])):
        results().print(f"  {each}", soft_wrap=True)
    if found.signature is not None:
        whole = "unchanged since" if found.signature.intact else "CHANGED after"
        results().print(f"  {whole} the signature by {found.signature.by}", soft_wrap=True)
