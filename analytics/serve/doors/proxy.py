"""A proxy that ends TLS with client certificates: whom it names, if it is the proxy that speaks."""

import hmac
import ipaddress
from dataclasses import dataclass, field
from typing import NamedTuple

from starlette.datastructures import Headers

from analytics.serve.doors.login_file import ProxySettings
from analytics.serve.problems import Forbidden


class Caller(NamedTuple):
    """Who calls through the proxy: subject of the certificate, empty for none, and address of the client."""

    subject: str
    address: str


class ForgedProxy(Forbidden):
    """Headers of the proxy from somebody else, or in a form that the proxy does not send."""


@dataclass(frozen=True)
class Proxy:
    """The one proxy of a server, known by its address and its secret."""

    settings: ProxySettings
    secret: str = field(repr=False)

    def caller(self, headers: Headers, peer: str) -> Caller | None:
        """Who calls through the proxy, None if it is not the proxy that calls.

        ForgedProxy if a header of the proxy is there, but not all that make it one of the proxy.
        """
        secrets = headers.getlist(self.settings.secret_header)
        subjects = headers.getlist(self.settings.subject_header)
        if not secrets and not subjects:
            return None
        if not self._is_of_proxy(peer):
            raise ForgedProxy(f"headers of the proxy come from {peer}, which is not its address")
        if len(secrets) != 1 or not hmac.compare_digest(secrets[0].encode("latin-1"), self.secret.encode()):
            raise ForgedProxy("headers of the proxy come with a wrong secret, with none, or with more than one")
        if len(subjects) > 1:
            raise ForgedProxy("the proxy names more than one subject; it must replace what clients send")
        return Caller(_text(subjects[0]) if subjects else "", self._client(headers, peer))

    def _is_of_proxy(self, peer: str) -> bool:
        try:
            address = ipaddress.ip_address(peer)
        except ValueError:
            return False
        return any(address == ipaddress.ip_address(each) for each in self.settings.addresses)

    def _client(self, headers: Headers, peer: str) -> str:
        """The address that the proxy has added last; what stands before it, the client may have written."""
        given = ",".join(headers.getlist(self.settings.client_header)).rpartition(",")[2].strip()
        try:
            return str(ipaddress.ip_address(given))
        except ValueError:
            return peer


def _text(header: str) -> str:
    """A header as text: proxies send UTF-8, which servers read as Latin-1."""
    try:
        return header.encode("latin-1").decode().strip()
    except UnicodeDecodeError:
        return header.strip()
