"""The status of a store: its roles, disk, log, lake and spools, and what is wrong with them."""

import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from storage.log.files import sealed_segments
from storage.manifests.lake import read_manifest
from storage.recording.status_board import read_statuses
from storage.segments.disk import DISK
from storage.store import Store
from stream.status.role_status import SILENT_AFTER_S, Role, RoleState, RoleStatus

_SHOW_ENDED_S = 3_600.0
_THROUGH_RECORDER = {Role.RUN, Role.ESTIMATE}  # their reports; others keep theirs in the store themselves
_LAKE_LATE_S = 60.0  # a sealed segment is in the lake after some seconds


class RoleReport(msgspec.Struct, frozen=True, kw_only=True):
    """A role as its last status has it; `condition` is ``working``, ``paused``, ``failed``, ``interrupted``, ``ended``,
    ``silent``, ``killed``, or ``unknown``: it reports through the recorder, and none is at work.
    """

    condition: str
    age_s: float
    works_s: float
    status: RoleStatus


class StoreStatus(msgspec.Struct, frozen=True, kw_only=True):
    """What is at work on a store now; `troubles` are sentences, none where all is well."""

    store: str
    at_ns: int
    troubles: tuple[str, ...]
    roles: tuple[RoleReport, ...]
    verdicts: dict[str, int]  # units of the runs at work by verdict so far; ``undecided`` for the others
    last_message_age_s: float | None  # of the recorder; None where none is at work
    last_sample_ns: int | None  # when the last recorder recorded its last sample; None where it has none
    free_bytes: int
    disk_bytes: int
    segments: int
    segments_not_in_lake: int
    spool_bytes: int  # on this computer, of what may not be recorded yet


def store_status(store: Store) -> StoreStatus:
    """Look at a store; raises StoreError if its manifests are damaged."""
    statuses = read_statuses(store)
    reports = [_report(*each) for each in zip(statuses, conditions(statuses), strict=True)]
    recorded_s = max((each.numbers.get("last_sample_seconds", 0.0) for each in statuses), default=0.0)
    roles = tuple(each for each in reports if each.condition != "ended" or each.age_s <= _SHOW_ENDED_S)
    # the recorder and the estimators in the process of a run are started with it
    killed = {(each.status.host, each.status.pid) for each in roles if each.status.run and each.condition == "killed"}
    own = [each for each in roles if each.status.run or (each.status.host, each.status.pid) not in killed]
    sealed = sealed_segments(store)
    in_lake = read_manifest(store).segments
    waiting = [path for path in sealed if path.stem not in in_lake]
    space = DISK.space(store.folder)
    return StoreStatus(
        store=str(store.folder), at_ns=time.time_ns(), roles=roles, verdicts=_verdicts(roles),
        troubles=(*(each for role in own for each in _troubles(role, recorded_s)), *_late(waiting)),
        last_message_age_s=min((age for role in roles if (age := _silence_s(role)) is not None), default=None),
        last_sample_ns=round(recorded_s * 1e9) or None,
        free_bytes=space.free, disk_bytes=space.total, segments=len(sealed), segments_not_in_lake=len(waiting),
        spool_bytes=sum(path.stat().st_size for path in store.folder.glob("spool/**/*") if path.is_file()),
    )  # fmt: skip


def conditions(statuses: Sequence[RoleStatus]) -> list[str]:
    """The condition of each of a store's roles; ``unknown`` of one that no recorder is there to hear."""
    found = [each.condition for each in statuses]
    recorders = {each for each, status in zip(found, statuses, strict=True) if status.role is Role.RECORD}
    if recorders & {"working", "paused"}:
        return found
    return [
        "unknown" if each == "silent" and status.role in _THROUGH_RECORDER else each
        for each, status in zip(found, statuses, strict=True)
    ]


def _report(status: RoleStatus, condition: str) -> RoleReport:
    works_s = (status.at_ns - status.began_ns) / 1e9
    return RoleReport(condition=condition, age_s=status.age_s, works_s=works_s, status=status)


def _silence_s(role: RoleReport) -> float | None:
    arrived_s = role.status.numbers.get("last_message_seconds")
    return time.time() - arrived_s if arrived_s and role.condition in {"working", "paused"} else None


def _verdicts(roles: tuple[RoleReport, ...]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for role in roles:
        if role.status.run is not None and role.condition not in {"ended", "interrupted"}:
            for unit in role.status.run.units:
                verdict = role.status.run.verdicts.get(unit, "undecided")
                counts[verdict] = counts.get(verdict, 0) + 1
    return counts


def _troubles(role: RoleReport, recorded_s: float) -> list[str]:
    status = role.status
    name = f"`gyrofleet {status.role}` at {status.name}" + (f" (run {status.run.run})" if status.run else "")
    found = []
    if role.condition == "silent":
        found.append(f"{name} has reported nothing for {role.age_s:,.0f} s; it reports every second")
    elif role.condition == "unknown":
        last = f"; the last sample was recorded at {_moment(recorded_s)}" if recorded_s else ""
        found.append(
            f"no recorder is at work, so it is not known whether {name} is: it reported last {role.age_s:,.0f} s "
            f"ago{last}; start `gyrofleet record`"
        )
    elif role.condition == "killed":
        found.append(f"{name} was killed {role.age_s:,.0f} s ago; start it again, it resumes where it was")
    elif role.condition == "interrupted":
        found.append(f"{name} was interrupted {role.age_s:,.0f} s ago: {status.trouble}")
    elif status.state in {RoleState.PAUSED, RoleState.FAILED}:
        found.append(f"{name} is {status.state}" + (f": {status.trouble}" if status.trouble else ""))
    elif status.trouble and role.condition != "ended":
        found.append(f"{name}: {status.trouble}")
    if (lag_s := status.numbers.get("lag_seconds", 0.0)) > SILENT_AFTER_S and role.condition == "working":
        found.append(f"{name} is {lag_s:,.0f} s behind what arrives")
    return found


def _moment(seconds: float) -> str:
    """A time with the seconds since then.

    >>> _moment(time.time() - 7.0).endswith(" UTC, 7 s ago")
    True
    """
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC, {time.time() - seconds:,.0f} s ago"


def _late(waiting: list[Path]) -> list[str]:
    ages = [time.time() - path.stat().st_mtime for path in waiting if path.exists()]
    if not ages or max(ages) < _LAKE_LATE_S:
        return []
    late = f"{len(ages)} sealed segments are not in the lake, the oldest for {max(ages):,.0f} s"
    return [f"{late}: no builder is at work, or it fails; start `gyrofleet lake`, it says why"]
