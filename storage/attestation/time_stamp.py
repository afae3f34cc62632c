"""Time stamps of attestations by an authority (RFC 3161): proof that a signature existed at a moment.

What is stamped is the attestation's signature, and with it all that it signs.
"""

import base64
import binascii
import datetime as dt
import http.client
import urllib.request
import warnings
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from stream.errors import BadInput, StoreError
from stream.roles.patience import GivenUp, answered

if TYPE_CHECKING:
    from cryptography.x509 import Certificate
    from rfc3161_client import TimeStampResponse

_ANSWER_S = 30.0
_MOST_BYTES = 1 << 20
_QUERY, _REPLY = "application/timestamp-query", "application/timestamp-reply"


class TimeStamp(NamedTuple):
    """A moment, and the name of the authority that certifies it.

    `is_trusted` if its chain ends at a trusted root; `why_not` is why it does not hold.
    """

    at: dt.datetime
    by: str
    is_trusted: bool = False
    why_not: str = ""


def check_url(url: str) -> str:
    """The address of an authority; BadInput if it is none."""
    if not url.startswith(("http://", "https://")):
        raise BadInput(f"--timestamp-url {url!r}: an address begins with https:// or http://")
    return url


def request_stamp(url: str, signature: bytes) -> str:
    """Have an authority stamp a signature; the answer in base64. StoreError if it does not, or stamps another thing."""
    from rfc3161_client import HashAlgorithm, TimestampRequestBuilder, decode_timestamp_response

    asked = TimestampRequestBuilder().data(signature).hash_algorithm(HashAlgorithm.SHA256).build()
    request = urllib.request.Request(  # noqa: S310  checked by check_url
        check_url(url), asked.as_bytes(), {"Content-Type": _QUERY, "Accept": _REPLY}
    )

    def ask() -> bytes:
        with urllib.request.urlopen(request, timeout=_ANSWER_S) as answer:  # noqa: S310  checked by check_url
            content: bytes = answer.read(_MOST_BYTES + 1)
            return content

    try:
        content = answered(ask)
    except GivenUp:
        raise StoreError(f"the time stamp authority {url} has not answered yet, and this process is to end") from None
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise StoreError(f"the time stamp authority {url} does not answer: {error}") from error
    if len(content) > _MOST_BYTES:
        raise StoreError(f"the time stamp authority {url} answers with more than {_MOST_BYTES:,} bytes")
    try:
        stamped = decode_timestamp_response(content)
        if stamped.status not in (0, 1):
            refused = ", ".join(stamped.status_string) or f"status {stamped.status}"
            raise StoreError(f"the time stamp authority {url} refuses: {refused}")
        info = stamped.tst_info
        is_ours = info.message_imprint.message == sha256(signature).digest() and info.nonce == asked.nonce
    except ValueError as error:
        raise StoreError(f"the time stamp authority {url} answers what is no time stamp: {error}") from error
    if not is_ours:
        raise StoreError(f"the time stamp authority {url} has stamped something else, or an earlier request")
    return base64.b64encode(content).decode()


def read_roots(path: Path) -> list["Certificate"]:
    """Certificates (PEM) of authorities that are trusted; BadInput if the file has none."""
    from cryptography.x509 import load_pem_x509_certificates

    try:
        with warnings.catch_warnings(action="ignore"):  # of others' old roots in a bundle of the system
            return load_pem_x509_certificates(path.read_bytes())
    except OSError as error:
        raise BadInput(f"--timestamp-root {path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise BadInput(f"--timestamp-root {path}: it has no certificates in PEM: {error}") from error


def check_stamp(stamp: str, signature: bytes, roots: "list[Certificate] | None") -> TimeStamp:
    """The moment of a stamp, and whether it holds.

    Without `roots` it is only checked that it is of this signature: whoever makes up an authority can sign as one.
    Certificates count that were valid at the moment of the stamp. What is in the stamp itself is never a root.
    """
    from cryptography.x509 import load_der_x509_certificate
    from rfc3161_client import VerificationError, VerifierBuilder, decode_timestamp_response

    never = dt.datetime.fromtimestamp(0, dt.UTC)
    try:
        found = decode_timestamp_response(base64.b64decode(stamp, validate=True))
        embedded = [load_der_x509_certificate(each) for each in sorted(found.signed_data.certificates)]
        at, by = found.tst_info.gen_time, _name(found, embedded)
    except (ValueError, binascii.Error) as error:
        return TimeStamp(never, "", why_not=f"it cannot be read: {error}")
    if found.tst_info.message_imprint.message != sha256(signature).digest():
        return TimeStamp(at, by, why_not="it is of another signature")
    if roots is None:
        return TimeStamp(at, by)
    try:
        VerifierBuilder(roots=roots).build().verify(found, sha256(signature).digest())
    except (VerificationError, ValueError) as error:
        return TimeStamp(at, by, why_not=str(error))
    return TimeStamp(at, by, is_trusted=True)


def _name(stamped: "TimeStampResponse", embedded: "list[Certificate]") -> str:
    """Name of the certificate that has signed a stamp."""
    signers = {(each.issuer, each.serial_number) for each in stamped.signed_data.signer_infos}
    found = [each for each in embedded if (each.issuer, each.serial_number) in signers]
    return found[0].subject.rfc4514_string() if found else ""
