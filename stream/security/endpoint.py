"""Addresses of the bus, and how far they reach."""

import ipaddress
import re
from typing import NamedTuple

from stream.errors import BusError

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
# a part after # would be Zenoh's own configuration of the link, such as its certificates
_ENDPOINT = re.compile(r"([a-z][a-z0-9-]*)/(\[[0-9A-Fa-f:.]+(?:%\w+)?\]|[^\s/#?\[\]:]+):(\d{1,5})(\?[^\s#]*)?")
_WITHOUT_PROTECTION = ("tcp", "tls")  # the plain form of a secured address is replaced


class InsecureBus(BusError):
    """A bus without protection that would reach beyond this computer."""

    exit_code = 2


class Endpoint(NamedTuple):
    """The parts of an address; `query` are Zenoh's options of the link."""

    protocol: str
    host: str
    port: int
    query: str = ""

    def __str__(self) -> str:
        return f"{self.protocol}/{self.host}:{self.port}{self.query}"

    @property
    def is_loopback(self) -> bool:
        """Whether it certainly reaches this computer only; a name but ``localhost`` may be any computer's."""
        if self.host == "localhost":
            return True
        try:
            address = ipaddress.ip_address(self.host.strip("[]"))
        except ValueError:
            return False
        mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
        return (mapped or address).is_loopback

    @property
    def local(self) -> "Endpoint":
        """Where a process of this computer reaches who listens there: for all interfaces, the loopback."""
        host = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]"}.get(self.host, self.host)  # noqa: S104  an address that is read
        return self._replace(host=host)


def parse_endpoint(text: str) -> Endpoint:
    """The parts of an address; raises BusError if it is none.

    >>> parse_endpoint("tcp/0.0.0.0:7447").is_loopback, parse_endpoint("tcp/[::1]:7447").is_loopback
    (False, True)
    """
    match = _ENDPOINT.fullmatch(text)
    if match is None or int(match[3]) > 65535:
        raise BusError(f"{text!r} is no address; write it as tcp/HOST:PORT, for example {DEFAULT_ENDPOINT}")
    return Endpoint(match[1], match[2], int(match[3]), match[4] or "")


def secured_endpoint(text: str) -> str:
    """The address with TLS; raises BusError if it is of another protocol.

    >>> secured_endpoint("tcp/10.0.0.7:7447")
    'tls/10.0.0.7:7447'
    """
    endpoint = parse_endpoint(text)
    if endpoint.protocol not in _WITHOUT_PROTECTION:
        raise BusError(f"{text}: with --security an address is tls/HOST:PORT")
    return str(endpoint._replace(protocol="tls"))


def check_plain_endpoint(text: str, *, is_listening: bool, is_insecure: bool) -> None:
    """Raise InsecureBus if an address without security reaches beyond this computer and nobody has asked for it."""
    endpoint = parse_endpoint(text)
    if endpoint.protocol in {"tls", "quic"}:
        raise InsecureBus(f"{text} needs certificates: give --security FOLDER; `gyrofleet site init` makes them")
    if endpoint.is_loopback or is_insecure:
        return
    what = "anybody on the network could send and read" if is_listening else "it would be sent unprotected"
    raise InsecureBus(
        f"{text} reaches beyond this computer, and {what}: give --security FOLDER (`gyrofleet site init` makes "
        f"certificates), or --insecure on a network that is yours alone"
    )
