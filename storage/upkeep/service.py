"""The lake service: builds segments as they are sealed, compacts, applies retention, removes replaced files."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from storage.lake.compaction import FAN_IN, compact
from storage.lake.lake import Lake
from storage.store import Store
from storage.upkeep.retention import Rule, apply_rule
from stream.errors import GyrofleetError, StoreError
from stream.status.role_status import Role, RoleStatus, new_status
from stream.terminal.console import Stop

if TYPE_CHECKING:
    from storage.object_lake.publisher import Publisher

_RETRY_S = 60.0
_RETENTION_EVERY_S = 60.0
_PUBLISHED_EVERY_S = 60.0  # what is unchanged

Report = Callable[..., None]  # gets an event in one word, a sentence, and numbers by name


class LakeService:
    """Maintains a lake round by round; the caller holds `builder_lock`.

    A failure is reported once and retried after a minute; it delays nothing else, and is a trouble of the status until
    that works. `grace_s` is how long replaced files stay for their readers. A `publisher` keeps a copy on an object
    store. `segments` were brought to the lake, and `compacted` parts merged, since the start.
    """

    def __init__(
        self, store: Store, *, report: Report, rule: Rule | None = None, grace_s: float = 3600.0,
        publisher: "Publisher | None" = None,
    ) -> None:  # fmt: skip
        self._store, self._report, self._rule = store, report, rule
        self._publisher = publisher
        self._published: tuple[int, float] | None = None  # number of the manifest, and when
        self._grace_s = grace_s
        self._lake: Lake | None = None
        self._retained_at = float("-inf")
        self._failed: dict[str, float] = {}
        self._reported: set[str] = set()
        self.segments = self.compacted = 0
        self._began_ns = time.time_ns()
        self._troubles: dict[str, str] = {}  # by step or segment

    def status(self) -> RoleStatus:
        """What was brought to the lake, and what failed and has not worked since."""
        numbers = {"segments_total": float(self.segments), "compacted_total": float(self.compacted)}
        return new_status(Role.LAKE, self._began_ns, trouble="; ".join(self._troubles.values())[:4000], numbers=numbers)

    def round(self, stopped: Stop) -> list[str]:
        """Do everything that is due, until `stopped`; returns the failures."""
        problems: list[str] = []
        steps = (
            ("lake", self._build), ("compaction", self._compact), ("retention", self._retain),
            ("publication", self._publish),
        )  # fmt: skip
        for what, step in steps:
            if stopped.asked_at is not None:
                break
            try:
                if step(stopped, problems):
                    self._without(what)
            except (GyrofleetError, OSError) as error:
                self._problem(problems, what, error)
        return problems

    def _build(self, stopped: Stop, problems: list[str]) -> bool:
        lake = self._opened()
        now = time.monotonic()
        missing = lake.missing()
        for segment in self._failed.keys() - set(missing):
            self._worked(segment)
        waiting = [each for each in missing if now - self._failed.get(each, float("-inf")) >= _RETRY_S]
        failed: dict[str, StoreError] = {}
        untouched = (segment for segment in waiting if stopped.asked_at is None)
        for number, segment in enumerate(lake.bring(untouched, failed), start=1):
            self._worked(segment)
            self.segments += 1
            left = len(waiting) - number - len(failed)
            more = f", {left} more to come" if left else ""
            self._report("segment", f"segment {segment} is in the lake{more}", segment=segment, left=left)
            if number % FAN_IN == 0:
                self._compact(stopped, problems)
        for segment, error in failed.items():
            self._failed[segment] = now
            self._problem(problems, segment, error)
        return True

    def _compact(self, stopped: Stop, _problems: list[str]) -> bool:
        lake = self._opened()
        for done in compact(lake):
            self.compacted += done.parts
            self._report("compacted", f"{done.parts} parts are one now: {done.name}", part=done.name, parts=done.parts)
            if stopped.asked_at is not None:
                return False
        lake.purge(self._grace_s)
        return True

    def _retain(self, _stopped: Stop, _problems: list[str]) -> bool:
        if self._rule is None or time.monotonic() - self._retained_at < _RETENTION_EVERY_S:
            return False
        self._retained_at = time.monotonic()
        dropped = apply_rule(self._opened(), self._rule)
        if dropped.parts:
            text = f"raw rows of {dropped.samples:,} samples dropped, {dropped.bytes:,} bytes ({self._rule})"
            self._report("raw_rows_dropped", text, **dropped._asdict())
        return True

    def _publish(self, _stopped: Stop, _problems: list[str]) -> bool:
        manifest = self._opened().manifest
        if self._publisher is None:
            return True
        if self._published is not None:
            number, at = self._published
            if time.monotonic() - at < (_PUBLISHED_EVERY_S if number == manifest.number else 0.0):
                return False
        self._published = manifest.number, time.monotonic()
        self._publisher.publish()
        return True

    def _opened(self) -> Lake:
        if self._lake is None:
            self._lake = Lake(self._store)
        return self._lake

    def _worked(self, segment: str) -> None:
        self._failed.pop(segment, None)
        self._without(segment)

    def _without(self, what: str) -> None:
        self._troubles = {each: text for each, text in self._troubles.items() if each != what}

    def _problem(self, problems: list[str], what: str, error: Exception) -> None:
        text = str(error) if isinstance(error, GyrofleetError) else f"the lake cannot be written: {error}"
        problems.append(text)
        self._troubles = {**self._troubles, what: text}  # whole at each moment: the status is of another thread
        self._lake = None  # read again from the disk
        if text not in self._reported:
            self._reported.add(text)
            self._report("problem", text, what=what)
