"""Whether a PDF, or its digital form, is a certificate of this store, unchanged, and still valid."""

import datetime as dt
from collections.abc import Callable
from pathlib import Path

import msgspec

from analytics.certificate.document.signature import SignatureCheck, check_signature
from analytics.certificate.record import Certificates, sha256_of
from stream.errors import BadInput
from stream.events import CertificateIssued

_LARGEST_BYTES = 100_000_000


class Verified(msgspec.Struct, frozen=True, kw_only=True):
    """What is known of a file; `why` has the reasons where it is not genuine or not valid.

    `changed` lists results and statements of conformity that the store gives differently today, empty where it gives
    them all; None where they were not computed, as of a file that is not genuine.
    """

    genuine: bool
    valid: bool
    changed: list[str] | None = None
    number: str | None = None
    unit: str | None = None
    standard: str | None = None
    issued: str | None = None
    valid_until: str | None = None
    superseded_by: str | None = None
    signature: SignatureCheck | None = None
    why: list[str] = []


def verify_certificate(
    path: Path,
    known: Certificates,
    *,
    trust: Path | None,
    now: dt.datetime,
    zone_of: Callable[[CertificateIssued], dt.tzinfo],
) -> Verified:
    """Compare a PDF or digital certificate with those of a store; BadInput if it cannot be read.

    `zone_of` gives the time zone of a certificate's station, in which its dates are.
    """
    try:
        if path.stat().st_size > _LARGEST_BYTES:
            raise BadInput(f"{path} has more than {_LARGEST_BYTES:,} bytes; a certificate is smaller")
        pdf = path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path} cannot be read: {error.strerror}") from error
    document = known.by_hash(sha256_of(pdf))
    signature = check_signature(pdf, trust) if pdf.startswith(b"%PDF") else None
    if document is None:
        why = ["no certificate of this store has these bytes: it is changed, a draft, or of another store"]
        return Verified(genuine=False, valid=False, signature=signature, why=why)
    why = []
    successor = known.successor(document.number)
    if successor is not None:
        why.append(f"superseded by {successor.number}: {successor.reason}")
    zone = zone_of(document)
    if document.valid_until and now.astimezone(zone).date() > dt.date.fromisoformat(document.valid_until):
        why.append(f"its validity ended on {document.valid_until}")
    is_xml = document.digital_sha256 == sha256_of(pdf)
    if trust is not None and signature is None:
        what = "the digital certificate is not signed; give the PDF" if is_xml else "it is not signed"
        why.append(f"{what}: --trust asks for a signature by a trusted issuer")
    if signature is not None and trust is not None and not signature.trusted:
        why.append(f"its signature, by {signature.by}, is by no trusted issuer")
    return Verified(
        genuine=True, valid=not why, number=document.number, unit=document.unit, standard=document.standard,
        issued=dt.datetime.fromtimestamp(document.t_ns / 1e9, zone).date().isoformat(),
        valid_until=document.valid_until or None, superseded_by=None if successor is None else successor.number,
        signature=signature, why=why,
    )  # fmt: skip
