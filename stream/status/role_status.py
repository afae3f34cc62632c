"""The status of a role: what a recorder, estimator, builder of the lake or run reports of itself."""

import hashlib
import os
import socket
import time
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated

import msgspec

from stream.bounds import MAX_MESSAGE_BYTES, MAX_NAME_CHARS
from stream.decoding import decode_json
from stream.errors import WireError
from stream.identity import ROOT

STATUS_KEY = f"{ROOT}/@status"
SILENT_AFTER_S = 10.0  # a role reports every second
_MISSED_S = 2.5  # after two reports that did not come it is asked whether its process is there
_Text = Annotated[str, msgspec.Meta(max_length=4_000)]
_Name = Annotated[str, msgspec.Meta(max_length=MAX_NAME_CHARS)]


class Role(StrEnum):
    """The roles that report a status."""

    RECORD = "record"
    ESTIMATE = "estimate"
    LAKE = "lake"
    RUN = "run"
    SERVE = "serve"
    ALERT = "alert"
    ATTEST = "attest"


class RoleState(StrEnum):
    """How a role is doing."""

    WORKING = "working"
    PAUSED = "paused"
    FAILED = "failed"
    INTERRUPTED = "interrupted"  # a run was left before its end
    ENDED = "ended"


class RunProgress(msgspec.Struct, frozen=True, kw_only=True):
    """How far a run is; times at the computer, not at a simulated station."""

    run: _Name
    procedure: _Text = ""
    units: tuple[_Name, ...] = ()
    step: int = 0  # from 1
    steps: int = 0
    doing: _Text = ""
    left_s: float | None = None  # if nothing is decided early
    decided_at_s: float | None = None  # of the record, where the last limit is forecast to be decided
    verdicts: dict[str, str] = {}  # by unit: what the live limits say so far
    undecided: dict[str, int] = {}  # by unit: limits that are not decided yet
    released: dict[str, str] = {}  # by unit: the verdict with which it was released before the end
    saved_s: float = 0.0  # of the records of released units; at the station


class RoleStatus(msgspec.Struct, frozen=True, kw_only=True):
    """What a role reports of itself once a second; `numbers` end with their unit or `_total`, as Prometheus has it."""

    role: Role
    name: _Name  # the station of a run, else the host
    at_ns: int  # by the clock of its host
    began_ns: int
    state: RoleState = RoleState.WORKING
    trouble: _Text = ""
    host: _Name = ""
    pid: int = 0
    numbers: dict[str, float] = {}
    run: RunProgress | None = None
    kept_ns: int = 0  # by the clock of the computer that keeps it, since it was booted; nobody sets that
    kept_boot: str = ""  # of which start of that computer

    @property
    def file_name(self) -> str:
        """Name of its file, of nothing that the role chose; a store has one recorder and one builder."""
        if self.role in {Role.RECORD, Role.LAKE}:
            return f"{self.role}-role.json"
        return self.file_name_of(f"{self.host}/{self.name}")

    def file_name_of(self, owner: str) -> str:
        """Name of the file of a role by its owner."""
        return f"{self.role}-{hashlib.sha256(f'{self.role}/{owner}'.encode()).hexdigest()[:16]}.json"

    @property
    def age_s(self) -> float:
        """Seconds since it was kept on this computer, whatever clocks say; elsewhere by the clocks of two hosts."""
        if self.kept_boot and self.kept_boot == boot():
            return (uptime_ns() - self.kept_ns) / 1e9
        return (time.time_ns() - self.at_ns) / 1e9

    @property
    def condition(self) -> str:
        """Its state, or ``silent`` where it should have reported and has not, or ``killed`` where its process is gone.

        >>> RoleStatus(role=Role.LAKE, name="a", at_ns=0, began_ns=0).condition
        'silent'
        """
        age_s = self.age_s
        if self.state in {RoleState.ENDED, RoleState.INTERRUPTED} or age_s <= _MISSED_S:
            return self.state.value
        if self.host == socket.gethostname() and not _is_alive(self.pid):
            return "killed"
        return self.state.value if age_s <= SILENT_AFTER_S else "silent"


def uptime_ns() -> int:
    """Time since this computer was booted, sleep included."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


@cache
def boot() -> str:
    """Identity of this start of this computer; empty if it has none."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""


def new_status(role: Role, began_ns: int, *, name: str = "", **parts: object) -> RoleStatus:
    """The status of a role of this process, now."""
    host = socket.gethostname()[:MAX_NAME_CHARS]
    return msgspec.structs.replace(
        RoleStatus(role=role, name=name or host, at_ns=time.time_ns(), began_ns=began_ns, host=host, pid=os.getpid()),
        **parts,
    )


def encode_status(status: RoleStatus) -> bytes:
    """The wire form of a status, which is JSON."""
    return msgspec.json.encode(status)


def decode_status(payload: bytes) -> RoleStatus:
    """Read a status; raises WireError.

    >>> decode_status(encode_status(RoleStatus(role=Role.LAKE, name="a", at_ns=0, began_ns=0))).role.value
    'lake'
    """
    if len(payload) > MAX_MESSAGE_BYTES:
        raise WireError(f"{len(payload)} bytes are more than a status may have")
    try:
        return decode_json(payload, RoleStatus)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise WireError(f"no status of a role: {error}") from error


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
