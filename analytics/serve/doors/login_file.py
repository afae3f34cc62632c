"""The file of logins: a provider of OpenID Connect, and a proxy that asks for client certificates.

[oidc]
issuer = "https://login.plant/realms/test"
client_id = "gyrofleet"
client_secret_file = "oidc-secret"

[oidc.roles]
"gyro engineers" = "engineer"

[proxy]
addresses = ["127.0.0.1"]
secret_file = "proxy-secret"
"""

import ipaddress
from pathlib import Path
from typing import Annotated, Any, Self
from urllib.parse import urlsplit

import msgspec

from analytics.serve.doors.origin import is_loopback
from analytics.serve.doors.roles import Role
from analytics.serve.doors.users_file import RoleWord
from stream.errors import BadInput
from stream.files.toml_text import decode_toml

# where a provider sends browsers back to
DONE_PATH = "/login/oidc/done"
_LEAST_SECRET = 32
_HEADER_NAME = r"^[A-Za-z][A-Za-z0-9-]{0,63}$"
_HeaderName = Annotated[str, msgspec.Meta(pattern=_HEADER_NAME)]


class OidcSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A provider of OpenID Connect, and what its claims mean here.

    Parameters
    ----------
    issuer: Its address, as its tokens name it; `/.well-known/openid-configuration` is read below it.
    client_id, client_secret_file: What the provider has given to this server; a public client has no secret.
    roles: Role of each value of the claim `role_claim`; the highest counts, without one nobody enters.
    name_claim: Name of a person in pages and documents; one that the provider gives once, and people cannot choose.
    session_h: Longest session, in hours.
    leeway_s: Seconds that the clocks of provider and server may differ.
    certificate_authority: File of the authority that has signed the provider's certificate, PEM.
    """

    issuer: str
    client_id: Annotated[str, msgspec.Meta(min_length=1)]
    roles: dict[str, RoleWord]
    client_secret_file: str = ""
    scopes: list[str] = msgspec.field(default_factory=lambda: ["openid", "profile"])
    name_claim: str = "preferred_username"
    role_claim: str = "groups"
    session_h: Annotated[float, msgspec.Meta(gt=0.0, le=12.0)] = 8.0
    leeway_s: Annotated[int, msgspec.Meta(ge=0, le=300)] = 30
    certificate_authority: str = ""

    def role(self, claims: dict[str, Any]) -> Role | None:
        """The highest role that claims give; None if they give none.

        >>> oidc = OidcSettings(issuer="", client_id="g", roles={"eng": "engineer"}, role_claim="realm.groups")
        >>> oidc.role({"realm": {"groups": ["eng", "x"]}}).word, oidc.role({"groups": ["eng"]})
        ('engineer', None)
        """
        found: Any = claims.get(self.role_claim)
        if found is None:
            found = claims
            for part in self.role_claim.split("."):
                found = found.get(part) if isinstance(found, dict) else None
        values = found if isinstance(found, list) else [found]
        roles = [Role.named(self.roles[each]) for each in values if isinstance(each, str) and each in self.roles]
        return max(roles, default=None)


class ProxySettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A proxy that ends TLS, asks for client certificates, and names their subjects in a header.

    Parameters
    ----------
    addresses: Whence the proxy connects. Any program of that machine could: the secret tells them apart.
    secret_file: File with the secret that the proxy sends, 32 characters at least.
    secret_header, subject_header, client_header: Names of the headers with the secret, with the subject of the
        certificate, and with the address of the client, which the proxy adds last.
    """

    addresses: Annotated[list[str], msgspec.Meta(min_length=1)]
    secret_file: str
    secret_header: _HeaderName = "X-Proxy-Secret"  # noqa: S105  the name of a header
    subject_header: _HeaderName = "X-Client-Subject"
    client_header: _HeaderName = "X-Forwarded-For"


class LoginFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a file of logins says; `folder` is where its other files are."""

    oidc: OidcSettings | None = None
    proxy: ProxySettings | None = None
    folder: str = "."

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read and check a file; BadInput names the fault."""
        try:
            found = decode_toml(path.read_bytes(), cls)
        except msgspec.MsgspecError as error:
            raise BadInput(f"the file of logins {path}: {error}") from error
        except OSError as error:
            raise BadInput(f"the file of logins {path} cannot be read: {error.strerror or error}") from error
        if found.oidc is not None:
            _check_issuer(path, found.oidc)
        if found.proxy is not None:
            _check_addresses(path, found.proxy)
        return msgspec.structs.replace(found, folder=str(path.parent / found.folder))

    def secret(self, name: str) -> str:
        """The secret in a file beside this one."""
        path = self.beside(name)
        try:
            found = path.read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            raise BadInput(f"the file of a secret {path} cannot be read: {error}") from error
        if not found or not found.isprintable():
            raise BadInput(f"the file of a secret {path} is empty, or has more than one line of text")
        return found

    def proxy_secret(self) -> str:
        """The secret of the proxy."""
        assert self.proxy is not None
        found = self.secret(self.proxy.secret_file)
        if len(found) < _LEAST_SECRET or not found.isascii():
            raise BadInput(
                f"the secret of the proxy in {self.beside(self.proxy.secret_file)} has {len(found)} characters; "
                f"{_LEAST_SECRET} of ASCII are needed at least: `openssl rand -hex 32` makes one"
            )
        return found

    def check_secrets(self) -> None:
        """BadInput if a file with a secret cannot be used."""
        if self.proxy is not None:
            self.proxy_secret()
        if self.oidc is not None and self.oidc.client_secret_file:
            self.secret(self.oidc.client_secret_file)

    def beside(self, name: str) -> Path:
        """A file that this one names."""
        return Path(self.folder) / name


def is_safe_url(url: str) -> bool:
    """Whether a secret may travel to a URL: https, or http on this machine.

    >>> is_safe_url("https://login.plant/x"), is_safe_url("http://127.0.0.1:9"), is_safe_url("http://login.plant")
    (True, True, False)
    """
    try:
        parts = urlsplit(url)
        host = parts.hostname
    except ValueError:
        return False
    return bool(host) and (parts.scheme == "https" or (parts.scheme == "http" and is_loopback(host or "")))


def _check_issuer(path: Path, oidc: OidcSettings) -> None:
    if not is_safe_url(oidc.issuer) or urlsplit(oidc.issuer).query or urlsplit(oidc.issuer).fragment:
        raise BadInput(f"{path}: the issuer {oidc.issuer!r} is not an address with https, as https://login.plant")
    if "openid" not in oidc.scopes:
        raise BadInput(f"{path}: the scopes lack openid, without which the provider sends no ID token")
    if not oidc.roles:
        raise BadInput(f'{path}: [oidc.roles] is empty, nobody could enter; write as "gyro engineers" = "engineer"')


def _check_addresses(path: Path, proxy: ProxySettings) -> None:
    for each in proxy.addresses:
        try:
            ipaddress.ip_address(each)
        except ValueError as error:
            raise BadInput(f"{path}: {each!r} is not the address of a proxy, as 127.0.0.1") from error
    names = [proxy.secret_header, proxy.subject_header, proxy.client_header]
    if len({name.lower() for name in names}) < len(names):
        raise BadInput(f"{path}: two headers of the proxy have one name: {', '.join(names)}")
