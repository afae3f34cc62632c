"""Sites with real certificates, and sessions of their principals."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stream.security.certificate_authority import Site
from stream.security.credentials import BusSecurity, Credentials, load_credentials
from stream.security.rights import Role
from stream.transport.zenoh_bus import ZenohBus

DAYS = 1.0
PEOPLE = (
    (Role.RECORDER, "recorder"), (Role.ROUTER, "router"), (Role.STATION, "c1"), (Role.STATION, "c2"),
    (Role.ESTIMATOR, "e1"), (Role.APPROVER, "lead"), (Role.FLEET, "head"),
)  # fmt: skip


def make_site(folder: Path) -> Site:
    site = Site.create(folder)
    for role, name in PEOPLE:
        site.add(role, name, days=DAYS)
    return site


def credentials(folder: Path, who: str) -> Credentials:
    return load_credentials(folder / who.replace(":", "/"))


@contextmanager
def session(
    folder: Path, who: str, *, listen: str | None = None, connect: str | None = None, asks_itself: bool = True
) -> Iterator[ZenohBus]:
    """A session of a principal; unless it asks itself, it tries what it may not do, as a forger would."""
    security = BusSecurity(credentials(folder, who))
    with ZenohBus(
        listen=[listen] if listen else [], connect=[connect] if connect else [], security=security
    ) as bus:  # fmt: skip
        bus._is_trusted = bus._is_trusted or not asks_itself
        yield bus
