"""Roles of a site, and the keys that each may publish, read, query and answer."""

import re
from enum import StrEnum
from functools import lru_cache
from typing import NamedTuple

from stream.errors import BadInput, BusError
from stream.identity import ACKNOWLEDGEMENT_KEY, EVERYTHING, ROOT, check_name

_MOST_CHARS = 64  # of a common name, by RFC 5280
_STATUS, _REQUEST, _REPLIES = f"{ROOT}/@status", f"{ROOT}/@request", f"{ROOT}/@reply/*"
_REPLICATION = f"{ROOT}/@replication/**"
ACCESS_KEY = f"{ROOT}/@access"
_ESTIMATES, _COMPENSATED = f"{ROOT}/*/*/*/*/estimate/*", f"{ROOT}/*/*/*/$*_compensated"
_STORE_KEYS = (f"{ROOT}/store/*/event", f"{ROOT}/local/entered/event", f"{ROOT}/local/alerts/event")
RESERVED_STATIONS = frozenset({"lake", "recorder", "entered", "alerts"})  # places of a store's own documents


class Role(StrEnum):
    """What a certificate is for."""

    STATION = "station"
    RECORDER = "recorder"
    ESTIMATOR = "estimator"
    APPROVER = "approver"
    ROUTER = "router"
    FLEET = "fleet"

    @property
    def listens(self) -> bool:
        """Whether others may connect to it."""
        return self in {Role.RECORDER, Role.ROUTER}


class MissingRight(BusError):
    """An action that the certificate of this side does not allow."""


class Principal(NamedTuple):
    """Who has a certificate: a role and a name."""

    role: Role
    name: str

    @property
    def common_name(self) -> str:
        """As in the certificate."""
        return f"{self.role}:{self.name}"

    def __str__(self) -> str:
        return f"{self.role} {self.name}"


def principal_named(role: Role, name: str) -> Principal:
    """A principal; raises BadInput if the name cannot be one."""
    check_name(role, name)
    if role is Role.STATION and name in RESERVED_STATIONS:
        raise BadInput(f"station {name!r} has the name of a place of the store's own documents; give another one")
    principal = Principal(role, name)
    if len(principal.common_name) > _MOST_CHARS:
        raise BadInput(f"{role} {name!r} is too long for a certificate: {_MOST_CHARS - len(role) - 1} characters")
    return principal


def principal_of(common_name: str) -> Principal:
    """The principal of a certificate's common name; raises BadInput if it is none of a site.

    >>> principal_of("station:chamber-2")
    Principal(role=<Role.STATION: 'station'>, name='chamber-2')
    """
    role, _, name = common_name.partition(":")
    if role not in set(Role):
        raise BadInput(f"{common_name[:80]!r} is no common name of a site: ROLE:NAME, for example station:chamber-2")
    return principal_named(Role(role), name)


class Rights(NamedTuple):
    """Key expressions that a principal may publish, subscribe to, query and answer."""

    publishes: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    queries: tuple[str, ...] = (ACCESS_KEY,)
    answers: tuple[str, ...] = ()


@lru_cache(maxsize=10_000)
def rights_of(principal: Principal) -> Rights:
    """The rights of a principal; whoever listens has no rights at another one that listens, but a recorder."""
    answered = (ACKNOWLEDGEMENT_KEY, _REPLIES)
    asks = (_STATUS, _REQUEST)
    name = principal.name
    match principal.role:
        case Role.STATION:
            own = (f"{ROOT}/*/{name}/event", f"{ROOT}/*/{name}/*/*")
            return Rights((*own, *asks), (*answered, f"{ROOT}/*/{name}/*/*/estimate/*"))
        case Role.ESTIMATOR:
            return Rights((_ESTIMATES, _COMPENSATED, f"{ROOT}/*/*/event", *asks), (EVERYTHING, *answered))
        case Role.APPROVER:
            return Rights((*_STORE_KEYS, _REQUEST), answered)
        case Role.RECORDER:
            return Rights(
                (ACKNOWLEDGEMENT_KEY, _REPLIES, *_STORE_KEYS, _REQUEST),
                (EVERYTHING, *asks, *answered),
                answers=(_REPLICATION, ACCESS_KEY),
            )
        case Role.FLEET:
            return Rights(queries=(_REPLICATION, ACCESS_KEY))
    return Rights(answers=(ACCESS_KEY,))


@lru_cache(maxsize=100_000)
def check_right(principal: Principal, action: str, key: str) -> None:
    """Raise MissingRight if a principal may not `publish`, `read`, `query` or `answer` a key expression."""
    rights = rights_of(principal)
    allowed = {
        "publish": rights.publishes, "read": rights.reads, "query": rights.queries, "answer": rights.answers
    }[action]  # fmt: skip
    if any(includes(each, key) for each in allowed):
        return
    able = [role for role in Role if _could(role, action, key)]
    who = f"a certificate of role {' or '.join(able)} may" if able else "no role may"
    if Role.STATION in able and principal.role is Role.STATION:
        who = "the station of that name may"
    raise MissingRight(f"{principal} may not {action} {key}: {who}; `gyrofleet site list` has who is who")


def _could(role: Role, action: str, key: str) -> bool:
    place = key.split("/")[2:3]
    rights = rights_of(Principal(role, place[0] if place else "x"))
    allowed = {
        "publish": rights.publishes, "read": rights.reads, "query": rights.queries, "answer": rights.answers
    }[action]  # fmt: skip
    return any(includes(each, key) for each in allowed)


def includes(allowed: str, key: str) -> bool:
    """Whether every key of one expression is one of another's, in the forms that are used here.

    >>> includes("gyrofleet/**", "gyrofleet/*/a/event"), includes("gyrofleet/**", "gyrofleet/@acknowledgement")
    (True, False)
    """
    if allowed == key:
        return True
    return _pattern(allowed).fullmatch(key) is not None


@lru_cache(maxsize=10_000)
def _pattern(allowed: str) -> re.Pattern[str]:
    parts = []
    for chunk in allowed.split("/"):
        if chunk == "**":
            # no chunk that begins with @ is matched by a wildcard
            parts.append(r"(?:/(?!@)[^/]+)*")
        elif chunk == "*":
            parts.append(r"/(?!@|\*\*)[^/]+")
        else:
            parts.append("/" + "(?!@)[^/]*".join(map(re.escape, chunk.split("$*"))))
    return re.compile("".join(parts).removeprefix("/"))
