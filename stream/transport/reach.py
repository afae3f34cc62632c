"""Why an address of the bus cannot be reached: Zenoh calls all of it a timeout."""

import socket
from collections.abc import Iterable

from stream.errors import BusError
from stream.security.endpoint import parse_endpoint

_LOOK_S = 1.0


def why_unreachable(endpoints: Iterable[str]) -> str:
    """What one of the addresses answers to a plain connection; empty if all of them take it, or give no answer."""
    for text in endpoints:
        try:
            endpoint = parse_endpoint(text)
            if endpoint.protocol in {"tcp", "tls"}:
                socket.create_connection((endpoint.host.strip("[]"), endpoint.port), timeout=_LOOK_S).close()
        except ConnectionRefusedError:
            return "connection refused, nobody listens there"
        except socket.gaierror:
            return "the name of its host is not known"
        except (BusError, OSError):
            continue
    return ""
