"""What a condition finds, and what it looks at."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import msgspec

from analytics.floor import UnitNow
from analytics.loop.bilingual import Bilingual
from storage.recording.store_status import StoreStatus
from storage.store import Store
from stream.errors import GyrofleetError
from stream.events import AnyDocument

Hours = Annotated[float, msgspec.Meta(gt=0.0, le=8784.0)]  # up to a year
_AGAIN_H = 1 / 60  # a choice that no value is of is looked for by evaluating the store


class Finding(NamedTuple):
    """Something that a condition finds now.

    A lasting one is found again and again while it lasts, by its `key`; an event once, by a key of its own.
    """

    key: str
    subject: str
    text: Bilingual
    is_event: bool = False
    unit: str | None = None


@dataclass
class AlertView:
    """What conditions look at: documents that are new, units on the floor, the roles."""

    now_ns: int  # by a clock that nobody sets
    began_ns: int  # since when the view is kept, by the computer's clock
    documents: Sequence[AnyDocument]
    units: Mapping[str, UnitNow]
    last_sample_ns: Mapping[tuple[str, str], int]  # by run and unit: the last sample, by the clock of now_ns
    status: StoreStatus
    damaged_bytes: Mapping[str, int]  # by segment of the log
    store: Store
    kept: dict[str, tuple[float, list[Finding] | GyrofleetError]]  # what a condition computed, and when it is due (ns)

    def every(self, hours: float, key: str, compute: Callable[[], list[Finding]]) -> list[Finding]:
        """What is computed under a key every so many hours, after an error in a minute; as before where not due."""
        due_ns, found = self.kept.get(key, (self.now_ns, []))
        if self.now_ns >= due_ns:
            try:
                found = compute()
            except GyrofleetError as error:
                found, hours = error, min(hours, _AGAIN_H)
            self.kept[key] = (self.now_ns + hours * 3600e9, found)
        if isinstance(found, GyrofleetError):
            raise found.with_traceback(None)  # it is raised every second
        return found


class Condition(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind"):
    """Base class of conditions; fields of a subclass are the parameters of its rules."""

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """What is found now."""
        raise NotImplementedError

    def check(self) -> None:
        """Raise BadInput where a parameter can match nothing, ever."""

    def ending(self, key: str, raised_ns: int, view: AlertView) -> Bilingual | None:
        """How something ended that is no longer found, raised at a time by the computer's clock; None if it passed."""
        del key, raised_ns, view
        return None
