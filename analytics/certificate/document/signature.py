"""Electronic signature of a certificate: PAdES with a key of PKCS #12, and its check."""

import io
import logging
from pathlib import Path

import msgspec

from stream.errors import BadInput

_FIELD = "Signature"


class SignatureCheck(msgspec.Struct, frozen=True, kw_only=True):
    """What the signature of a PDF says: whose, whether the file is as it was signed, whether its issuer is trusted."""

    by: str
    intact: bool
    trusted: bool
    why: str = ""


def sign(pdf: bytes, key: Path, passphrase: str, *, reason: str) -> bytes:
    """The PDF with an invisible PAdES signature; BadInput if the key cannot be read with the passphrase."""
    from pyhanko.pdf_utils.incremental_writer import IncrementalPdfFileWriter
    from pyhanko.sign import signers
    from pyhanko.sign.fields import SigSeedSubFilter

    try:
        content = key.read_bytes()
    except OSError as error:
        raise BadInput(f"--key {key}: cannot be read: {error.strerror}") from error
    try:
        signer = signers.SimpleSigner.load_pkcs12_data(content, other_certs=[], passphrase=passphrase.encode())
    except ValueError as error:
        why = "no PKCS #12 file (.p12), or another passphrase; give it as GYROFLEET_KEY_PASSPHRASE"
        raise BadInput(f"--key {key}: {why}") from error
    metadata = signers.PdfSignatureMetadata(
        field_name=_FIELD, reason=reason, subfilter=SigSeedSubFilter.PADES, md_algorithm="sha256"
    )
    out = signers.sign_pdf(IncrementalPdfFileWriter(io.BytesIO(pdf)), metadata, signer=signer)
    return bytes(out.getbuffer())


def check_signature(pdf: bytes, trust: Path | None) -> SignatureCheck | None:
    """Check the signature of a PDF; None if it has none. `trust`: certificates (PEM) whose keys are trusted."""
    from pyhanko.keys import load_certs_from_pemder_data
    from pyhanko.pdf_utils.misc import PdfError
    from pyhanko.pdf_utils.reader import PdfFileReader
    from pyhanko.sign.validation import validate_pdf_signature
    from pyhanko.sign.validation.status import SignatureCoverageLevel
    from pyhanko_certvalidator import ValidationContext

    try:
        roots = [] if trust is None else list(load_certs_from_pemder_data(trust.read_bytes()))
    except (OSError, ValueError) as error:
        raise BadInput(f"--trust {trust}: no certificate in PEM can be read: {error}") from error
    logging.getLogger("pyhanko").setLevel(logging.CRITICAL)
    logging.getLogger("pyhanko_certvalidator").setLevel(logging.CRITICAL)
    try:
        signatures = PdfFileReader(io.BytesIO(pdf)).embedded_signatures
        if not signatures:
            return None
        last = signatures[-1]
        by = "" if last.signer_cert is None else last.signer_cert.subject.human_friendly
        status = validate_pdf_signature(last, ValidationContext(trust_roots=roots, allow_fetching=False))
    except (PdfError, ValueError) as error:
        return SignatureCheck(by="", intact=False, trusted=False, why=str(error))
    is_whole = status.coverage is SignatureCoverageLevel.ENTIRE_FILE
    whole = bool(status.intact and status.valid and is_whole)
    return SignatureCheck(by=by, intact=whole, trusted=bool(status.trusted), why="" if whole else status.summary())
