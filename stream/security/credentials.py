"""The credentials of one principal: certificate, key, the site's certificate and its access list, in a folder."""

import datetime as dt
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from stream.errors import BadInput, BusError
from stream.security.access import ACCESS_FILE, AccessList, read_access_list
from stream.security.file_modes import fault_of_secret
from stream.security.rights import Principal, Role, principal_of

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

VARIABLE = "GYROFLEET_SECURITY"
SITE_CERTIFICATE, CERTIFICATE, KEY = "ca.pem", "certificate.pem", "key.pem"


@dataclass(frozen=True, eq=False)
class Credentials:
    """What a principal proves itself with; its certificate is valid from `since` until `until`.

    `site` is a digest of the site's key.
    """

    folder: Path
    principal: Principal
    key: "EllipticCurvePrivateKey"
    access: AccessList
    since: dt.datetime
    until: dt.datetime
    site: str

    def describe(self) -> str:
        """Who this side is, for messages."""
        return f"this side is {self.principal}, its certificate ends on {self.until:%Y-%m-%d %H:%M} UTC"

    @property
    def numbers(self) -> dict[str, float]:
        """When the certificate ends, for a status.

        Who connects makes new links with the newest in its folder, who listens has the one that it started with.
        """
        return {"certificate_ends_seconds": self._dates()[1].timestamp()}

    @property
    def trouble(self) -> str | None:
        """That the certificate has ended, or ends within a tenth of its time; None before that."""
        since, until = self._dates()
        now = dt.datetime.now(dt.UTC)
        if until - now > (until - since) / 10:
            return None
        is_over = until <= now
        when = f"{'ended' if is_over else 'ends'} on {until:%Y-%m-%d %H:%M} UTC"
        effect = "no new link is made with it; " if is_over else ""
        return f"the certificate of {self.principal} {when}; {effect}{_renewal(self.principal, self.folder)}"

    def _dates(self) -> tuple[dt.datetime, dt.datetime]:
        path = self.folder / CERTIFICATE
        if self.principal.role.listens:
            return self.since, self.until
        try:
            status = path.stat()
            return _dates_of(path, (status.st_mtime_ns, status.st_size, status.st_ino))
        except (OSError, ValueError):
            return self.since, self.until


@lru_cache(maxsize=100)
def _dates_of(path: Path, _stamp: tuple[int, int, int]) -> tuple[dt.datetime, dt.datetime]:
    from cryptography import x509

    certificate = x509.load_pem_x509_certificate(path.read_bytes())
    return certificate.not_valid_before_utc, certificate.not_valid_after_utc


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
        if fault := fault_of_secret(folder / KEY):
            raise BusError(f"{folder / KEY}: {fault}")
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
            f"{_renewal(principal, folder)}"
        )
    if principal.role not in roles:
        able = " or ".join(roles)
        raise BusError(f"{folder} is of {principal}; this command needs a certificate of role {able}")
    access = read_access_list(folder / ACCESS_FILE, site_key)
    digest = sha256(site_key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)).hexdigest()
    since, until = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    return Credentials(folder, principal, key, access, since, until, digest)


def _renewal(principal: Principal, folder: Path) -> str:
    start = ", then start it again" if principal.role.listens else ""
    return f"`gyrofleet site renew SITE {principal.common_name}`, and copy {folder}{start}"


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
