"""Addresses of plants: a folder, an endpoint of the bus, or a bucket; and whether two of them are one place."""

import re
import shlex
from collections.abc import Iterable
from pathlib import Path

from storage.object_lake.address import SCHEME, parse_bucket
from stream.errors import BadInput, BusError
from stream.security.endpoint import parse_endpoint

_ENDPOINT = re.compile(r"(?:tcp|tls|quic|udp|ws|unixsock-stream|serial)/\S+")


def is_endpoint(address: str) -> bool:
    """Whether an address is one of the bus.

    >>> is_endpoint("tcp/10.0.0.7:7448"), is_endpoint("night")
    (True, False)
    """
    return _ENDPOINT.fullmatch(address) is not None


def is_bucket(address: str) -> bool:
    """Whether an address is one of an object store.

    >>> is_bucket("s3://gyros/plants/hangzhou"), is_bucket("s3")
    (True, False)
    """
    return address.startswith(SCHEME)


def check_distinct(addresses: Iterable[str]) -> None:
    """BadInput if two addresses are one place, however they are written: its copy would be written twice at once.

    >>> check_distinct(["tcp/localhost:7448", "tcp/127.0.0.1:7448"])
    Traceback (most recent call last):
    ...
    stream.errors.BadInput: --from tcp/127.0.0.1:7448 is the same plant as --from tcp/localhost:7448; give each once
    """
    seen: dict[object, str] = {}
    for address in addresses:
        place = _place(address)
        if place in seen:
            raise BadInput(f"--from {address} is the same plant as --from {seen[place]}; give each once")
        seen[place] = address


def recall_command(source: str, target: str, plant: str = "", *, endpoint_url: str | None = None) -> str:
    """The command by which a plant's store gets back from `source` what it has lost, as it is typed at the plant.

    Where the plant was reached elsewhere than in a folder, STORE stands for that of its store.

    >>> recall_command("fleet", "tcp/10.0.0.7:7448", "hangzhou")
    '`gyrofleet replicate --recall --from fleet --to STORE --plant hangzhou`'
    """
    to = "STORE" if is_endpoint(target) or is_bucket(target) else target
    words = ["--from", source, "--to", to, *(("--plant", plant) if plant else ())]
    words += ("--endpoint-url", endpoint_url) if endpoint_url else ()
    return f"`gyrofleet replicate --recall {shlex.join(words)}`"


def _place(address: str) -> object:
    """What is the same for two ways to write one place."""
    if is_bucket(address):
        return str(parse_bucket(address))
    if is_endpoint(address):
        try:
            found = parse_endpoint(address)
        except BusError:
            return address  # of another form, as of a serial line
        return ("localhost" if found.is_loopback else found.host.casefold(), found.port)
    try:
        status = Path(address).stat()
    except OSError:
        return Path(address).absolute()
    return (status.st_dev, status.st_ino)
