"""The credentials of one principal: certificate, key, the site's certificate and its access list, in a folder."""

import datetime as dt
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from stream.errors import BadInput, BusError
from stream.security.access import ACCESS_FILE, AccessList, read_access_list
from stream.security.rights import Principal, Role, principal_of

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

VARIABLE = "GYROFLEET_SECURITY"
SITE_CERTIFICATE, CERTIFICATE, KEY = "ca.pem", "certificate.pem", "key.pem"


@dataclass(frozen=True, eq=False)
class Credentials:
    """What a principal proves itself with; `until` is the end of its certificate, `site` a digest of the site's key."""

    folder: Path
    principal: Principal
    key: "EllipticCurvePrivateKey"
    access: AccessList
    until: dt.datetime
    site: str

    def describe(self) -> str:
        """Who this side is, for messages."""
        return f"this side is {self.principal}, its certificate ends on {self.until:%Y-%m-%d %H:%M} UTC"


def load_credentials(path: Path, roles: tuple[Role, ...] = tuple(Role)) -> Credentials:
    """Read the folder of a principal, or that of a site which has one principal of `roles` only.

    Raises BusError if they are no valid credentials, and says what to do.
    """
    from cryptography import x509
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey, EllipticCurvePublicKey
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key
    from cryptography.x509.oid import NameOID

    folder = _folder_of(path, roles)
    try:
        mode = stat.S_IMODE((folder / KEY).stat().st_mode)
        if mode & 0o077:
            raise BusError(f"{folder / KEY} can be read by others (mode {mode:o}): chmod 600 {folder / KEY}")
        key = load_pem_private_key((folder / KEY).read_bytes(), None)
        certificate = x509.load_pem_x509_certificate((folder / CERTIFICATE).read_bytes())
        site = x509.load_pem_x509_certificate((folder / SITE_CERTIFICATE).read_bytes())
        names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        principal = principal_of(str(names[0].value) if names else "")
    except OSError as error:
        raise BusError(f"{error.filename} cannot be read: {error.strerror}; give --security FOLDER") from error
    except (ValueError, TypeError, BadInput) as error:
        raise BusError(
            f"{folder}: {KEY}, {CERTIFICATE} or {SITE_CERTIFICATE} is damaged: {error}; `gyrofleet site add` makes "
            "such folders"
        ) from error
    try:
        certificate.verify_directly_issued_by(site)
    except (ValueError, TypeError, InvalidSignature):
        raise BusError(
            f"{folder / CERTIFICATE} is not of the site of {folder / SITE_CERTIFICATE}; copy the folder again, whole"
        ) from None
    site_key = site.public_key()
    if not isinstance(key, EllipticCurvePrivateKey) or not isinstance(site_key, EllipticCurvePublicKey):
        raise BusError(f"{folder}: its keys are not of the curve P-256; `gyrofleet site add` makes such folders")
    if key.public_key() != certificate.public_key():
        raise BusError(f"{folder / KEY} is not the key of {folder / CERTIFICATE}; copy the folder again, whole")
    if certificate.not_valid_after_utc <= dt.datetime.now(dt.UTC):
        raise BusError(
            f"the certificate of {principal} ended on {certificate.not_valid_after_utc:%Y-%m-%d %H:%M} UTC; "
            f"`gyrofleet site renew SITE {principal.common_name}`, and copy {folder}"
        )
    if principal.role not in roles:
        able = " or ".join(roles)
        raise BusError(f"{folder} is of {principal}; this command needs a certificate of role {able}")
    access = read_access_list(folder / ACCESS_FILE, site_key)
    digest = sha256(site_key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)).hexdigest()
    return Credentials(folder, principal, key, access, certificate.not_valid_after_utc, digest)


def _folder_of(path: Path, roles: tuple[Role, ...]) -> Path:
    path = path.absolute()
    if path.is_file():
        path = path.parent
    if (path / CERTIFICATE).exists():
        return path
    found = [each.parent for role in roles for each in sorted((path / role).glob(f"*/{CERTIFICATE}"))]
    if len(found) == 1:
        return found[0]
    able = " or ".join(roles)
    if found:
        raise BusError(f"{path} has {len(found)} certificates for this command; give one, as --security {found[0]}")
    raise BusError(
        f"--security {path} holds no certificate of role {able}; `gyrofleet site init` makes a site, "
        f"`gyrofleet site add` certificates"
    )


@dataclass(frozen=True)
class BusSecurity:
    """How this process protects its buses: by `credentials`, or not; `is_insecure` is the option of that name."""

    credentials: Credentials | None = None
    is_insecure: bool = False


_current: list[BusSecurity] = []


@contextmanager
def secured_process(security: BusSecurity) -> Iterator[None]:
    """Protect the buses that this process opens meanwhile: a process has one identity."""
    _current.append(security)
    try:
        yield
    finally:
        _current.pop()


def process_security() -> BusSecurity:
    """How this process protects its buses: as its command says, else by the variable GYROFLEET_SECURITY."""
    if _current:
        return _current[-1]
    path = os.environ.get(VARIABLE)
    return BusSecurity(load_credentials(Path(path))) if path else BusSecurity()
