"""The certificate authority of a site: a folder with its key, and one with the credentials of each principal.

SITE/ca.key (mode 600) stays with who runs the site. SITE/ROLE/NAME/ is what a principal's computer needs.
"""

import datetime as dt
import fcntl
import ipaddress
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec
from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from stream.decoding import decode_json
from stream.errors import BadInput
from stream.files.atomic_file import write_durably
from stream.security.access import ACCESS_FILE, AccessList
from stream.security.credentials import CERTIFICATE, KEY, SITE_CERTIFICATE
from stream.security.file_modes import fault_of_secret
from stream.security.rights import Principal, Role, principal_named, principal_of
from stream.security.site_rules import RULES_FILE, SiteRules, read_site_rules

_CA_KEY, _INDEX = "ca.key", "site.json"
_CA_DAYS = 3650
_EARLY = dt.timedelta(minutes=10)  # clocks of other computers may be behind
_LOCAL_HOSTS = ("localhost", "127.0.0.1", "::1")


class Issued(msgspec.Struct, frozen=True, kw_only=True):
    """A principal of a site; `until_ns` is the end of its certificate, `revoked_ns` when it was revoked."""

    common_name: str
    until_ns: int
    hosts: tuple[str, ...] = ()
    revoked_ns: int | None = None

    @property
    def principal(self) -> Principal:
        """Who it is."""
        return principal_of(self.common_name)

    @property
    def state(self) -> str:
        """``valid``, ``ended`` or ``revoked``."""
        if self.revoked_ns is not None:
            return "revoked"
        return "valid" if self.until_ns > time.time_ns() else "ended"


class _Index(msgspec.Struct, frozen=True):
    issued: tuple[Issued, ...]
    version: int = 1


class Site:
    """A site's authority in its folder; raises BadInput if the folder holds none."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            if fault := fault_of_secret(folder / _CA_KEY):
                raise BadInput(f"{folder / _CA_KEY}: {fault}")
            key = serialization.load_pem_private_key((folder / _CA_KEY).read_bytes(), None)
            self._certificate = x509.load_pem_x509_certificate((folder / SITE_CERTIFICATE).read_bytes())
        except OSError as error:
            raise self._none(error) from error
        except (ValueError, TypeError) as error:
            files = f"{_CA_KEY} or {SITE_CERTIFICATE}"
            raise BadInput(f"{folder}: {files} is damaged: {error}; restore it from its copy") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise BadInput(f"{folder / _CA_KEY} is no key of a site")
        self._key = key
        self._issued = self._read_index()

    def _read_index(self) -> dict[Principal, Issued]:
        path = self.folder / _INDEX
        try:
            index = decode_json(path.read_bytes(), _Index)
            return {each.principal: each for each in index.issued}
        except OSError as error:
            raise self._none(error) from error
        except (ValueError, msgspec.MsgspecError, BadInput) as error:
            raise BadInput(f"{path} is damaged: {error}; restore it from its copy") from error

    def _none(self, error: OSError) -> BadInput:
        reason = f"{self.folder} is no site ({error.strerror})"
        return BadInput(f"{reason}; `gyrofleet site init {self.folder}` makes one")

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Hold the site against other commands that change it, and know what those before have written."""
        descriptor = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            self._issued = self._read_index()
            yield
        finally:
            os.close(descriptor)

    @classmethod
    def create(cls, folder: Path) -> "Site":
        """Make a site; raises BadInput if the folder holds anything."""
        try:
            if folder.exists() and any(folder.iterdir()):
                raise BadInput(f"{folder} is not empty: a site's keys are never overwritten; give a new folder")
            folder.mkdir(parents=True, exist_ok=True)
            folder.chmod(0o700)
        except OSError as error:
            raise BadInput(f"{folder} cannot be made: {error.strerror}; give a new folder") from error
        key = ec.generate_private_key(ec.SECP256R1())
        _write_key(folder / _CA_KEY, key)
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"gyrofleet site {folder.resolve().name}"[:64])])
        now = dt.datetime.now(dt.UTC)
        certificate = (
            x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - _EARLY).not_valid_after(now + dt.timedelta(days=_CA_DAYS))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_key_usage(signs_certificates=True), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
            .sign(key, hashes.SHA256())
        )  # fmt: skip
        write_durably(folder / SITE_CERTIFICATE, certificate.public_bytes(serialization.Encoding.PEM))
        write_durably(folder / _INDEX, msgspec.json.encode(_Index(())))
        return cls(folder)

    @property
    def issued(self) -> list[Issued]:
        """Everybody, in order."""
        return [self._issued[each] for each in sorted(self._issued)]

    def folder_of(self, principal: Principal) -> Path:
        """Where the credentials of a principal are."""
        return self.folder / principal.role / principal.name

    def add(self, role: Role, name: str, *, hosts: Sequence[str] = (), days: float) -> Path:
        """Make the credentials of a principal; their folder. Raises BadInput if there are any."""
        with self._alone():
            return self._add(principal_named(role, name), hosts, days)

    def _add(self, principal: Principal, hosts: Sequence[str], days: float) -> Path:
        role, found = principal.role, self._issued.get(principal)
        folder = self.folder_of(principal)
        if found is not None:
            raise BadInput(
                f"{principal} is on the site already, {found.state}: keys are never overwritten; `gyrofleet site "
                f"renew` prolongs a certificate, and after a revocation another name is given"
            )
        if folder.exists():
            raise BadInput(
                f"{folder} is there, and {principal} is not on the site: an interrupted command has left it, or "
                f"{_INDEX} is an old one; keys are never overwritten, move the folder away and add again"
            )
        if hosts and not role.listens:
            raise BadInput(f"--host is for those that listen, and {principal} does not: leave it out")
        self._admitted()  # before anything is made: all are on the new access list
        folder.mkdir(parents=True, mode=0o700)
        key = ec.generate_private_key(ec.SECP256R1())
        _write_key(folder / KEY, key)
        self._issue(principal, key.public_key(), tuple(hosts), days)
        return folder

    def renew(self, principal: Principal, *, days: float, hosts: Sequence[str] = ()) -> Issued:
        """A new certificate for the same key; raises BadInput if the principal is revoked or unknown."""
        with self._alone():
            found = self._known(principal)
            if found.revoked_ns is not None:
                raise BadInput(f"{principal} is revoked and is not renewed; add it under another name")
            public = self._public_key(principal)
            return self._issue(principal, public, tuple(hosts) or found.hosts, days)

    def revoke(self, principal: Principal) -> None:
        """Take a principal off the access lists: who listens refuses it, and it is not renewed."""
        with self._alone():
            found = self._known(principal)
            if found.revoked_ns is None:
                self._issued[principal] = msgspec.structs.replace(found, revoked_ns=time.time_ns())
                self._write()

    def _admitted(self) -> dict[Principal, bytes]:
        """Public keys of all that are not revoked; BadInput if the certificate of one cannot be read."""
        admitted: dict[Principal, bytes] = {}
        for each in self.issued:
            if each.revoked_ns is None:
                admitted[each.principal] = self._public_key(each.principal).public_bytes(
                    serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo
                )
        return admitted

    def _public_key(self, principal: Principal) -> ec.EllipticCurvePublicKey:
        """The key of a principal, from its certificate; BadInput if that is missing or damaged."""
        path = self.folder_of(principal) / CERTIFICATE
        try:
            public = x509.load_pem_x509_certificate(path.read_bytes()).public_key()
        except (OSError, ValueError, UnsupportedAlgorithm) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            raise BadInput(
                f"{path}, the certificate of {principal} in {self.folder / _INDEX}, cannot be read: {reason}; restore "
                f"it from a copy, or revoke {principal.common_name}"
            ) from error
        if not isinstance(public, ec.EllipticCurvePublicKey):
            raise BadInput(f"{path} is of a key that is not on the curve P-256; restore it from a copy")
        return public

    def _known(self, principal: Principal) -> Issued:
        found = self._issued.get(principal)
        if found is None:
            raise BadInput(f"{principal} is not on the site {self.folder}; `gyrofleet site list` has those that are")
        return found

    def _issue(
        self, principal: Principal, public: ec.EllipticCurvePublicKey, hosts: tuple[str, ...], days: float
    ) -> Issued:
        now = dt.datetime.now(dt.UTC)
        until = now + dt.timedelta(days=days)
        usages = [ExtendedKeyUsageOID.CLIENT_AUTH]
        usages += [ExtendedKeyUsageOID.SERVER_AUTH] if principal.role.listens else []
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, principal.common_name)])
        builder = (
            x509.CertificateBuilder().subject_name(name).issuer_name(self._certificate.subject).public_key(public)
            .serial_number(x509.random_serial_number()).not_valid_before(now - _EARLY).not_valid_after(until)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_key_usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False)
        )  # fmt: skip
        if principal.role.listens:
            names = [_general_name(each) for each in dict.fromkeys((*_LOCAL_HOSTS, *hosts))]
            builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
        certificate = builder.sign(self._key, hashes.SHA256())
        folder = self.folder_of(principal)
        write_durably(folder / CERTIFICATE, certificate.public_bytes(serialization.Encoding.PEM))
        write_durably(folder / SITE_CERTIFICATE, (self.folder / SITE_CERTIFICATE).read_bytes())
        issued = Issued(common_name=principal.common_name, until_ns=round(until.timestamp() * 1e9), hosts=hosts)
        self._issued[principal] = issued
        self._write()
        return issued

    @property
    def rules_file(self) -> Path:
        """Where the rules of the site are."""
        return self.folder / RULES_FILE

    def publish(self) -> SiteRules:
        """Sign the rules of the site into every access list; BadInput if their file is wrong."""
        rules = read_site_rules(self.rules_file)
        self._write()
        return rules

    def _write(self) -> None:
        """Write the index, and the access list into the folder of everybody."""
        admitted = self._admitted()
        write_durably(self.folder / _INDEX, msgspec.json.encode(_Index(tuple(self.issued))))
        revoked = frozenset(each.principal for each in self.issued if each.revoked_ns is not None)
        content = AccessList(admitted, revoked, time.time_ns(), read_site_rules(self.rules_file)).encode(self._key)
        for principal in self._issued:
            with suppress(FileNotFoundError):  # moved away
                write_durably(self.folder_of(principal) / ACCESS_FILE, content)


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host.strip("[]")))
    except ValueError:
        pass
    try:
        return x509.DNSName(host)
    except ValueError as error:
        raise BadInput(f"--host {host!r} is neither an address nor a name of a computer: {error}") from error


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates, content_commitment=False, key_encipherment=False,
        data_encipherment=False, key_agreement=not signs_certificates, key_cert_sign=signs_certificates,
        crl_sign=signs_certificates, encipher_only=False, decipher_only=False,
    )  # fmt: skip


def _write_key(path: Path, key: ec.EllipticCurvePrivateKey) -> None:
    content = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
