"""Statuses on the bus: a secured one carries a proof of its source, which reports its own role and name only."""

from collections.abc import Callable
from typing import NamedTuple

from stream.security import rights
from stream.security.authority import NotAuthorised
from stream.security.proof import SourceProver, SourceVerifier, credentials_of, split
from stream.status.role_status import STATUS_KEY, Role, RoleStatus, decode_status, encode_status
from stream.transport.bus import Bus

_ROLE_OF = {rights.Role.STATION: Role.RUN, rights.Role.ESTIMATOR: Role.ESTIMATE}


class ReceivedStatus(NamedTuple):
    """A status, and the common name of the certificate that proves it; empty without security."""

    status: RoleStatus
    by: str


def on_bus(bus: Bus) -> Callable[[RoleStatus], None]:
    """A `put` that sends a status to the recorder."""
    credentials = credentials_of(bus)
    prover = None if credentials is None else SourceProver(credentials)

    def put(status: RoleStatus) -> None:
        payload = encode_status(status)
        bus.publish(STATUS_KEY, payload if prover is None else prover.prove(STATUS_KEY, payload))

    return put


def received_status(payload: bytes, sources: SourceVerifier | None) -> ReceivedStatus:
    """Read what came over the bus; raises WireError if it is no status, or not of the one who sent it."""
    message = split(payload)
    if sources is None:
        return ReceivedStatus(decode_status(message.body), "")
    source = sources.source_of(STATUS_KEY, message)
    status = decode_status(message.body)
    if status.role is not _ROLE_OF.get(source.role):
        raise NotAuthorised(f"{source} may not report the status of `gyrofleet {status.role}`")
    if source.role is rights.Role.STATION and status.name != source.name:
        raise NotAuthorised(f"{source} may not report the status of {status.name[:80]!r}")
    return ReceivedStatus(status, source.common_name)
