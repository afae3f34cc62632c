"""Operations of the HTTP API: path, parameters, answer, and the role that they need."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, TypeVar, get_type_hints
from urllib.parse import quote, urlencode

import msgspec

from analytics.serve.doors.roles import Person, Role
from analytics.serve.live.fresh_views import FreshViews
from analytics.serve.service import Service
from analytics.serve.shared_lake import LakeState
from storage.sql.catalog import Catalog
from storage.store import Store

UNFINISHED = 202
Asked = TypeVar("Asked", bound=msgspec.Struct)
Given = TypeVar("Given")


class NotYet(Exception):
    """The metrics are still being computed, and who asks shows what there is meanwhile."""


class Nothing(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """No parameters."""


@dataclass
class Call:
    """One request while it is answered, in a thread of its own.

    Parameters
    ----------
    service: What all requests share.
    person: Who asks.
    state: The version of the lake that the answer is of.
    path: Parameters in the path, as ``{"unit": "FOG-0231"}``.
    url: Path and parameters as they were asked.
    is_patient: Whether it waits until metrics are computed; else `metrics` raises NotYet.
    is_partial: Whether it shows what is known meanwhile.
    """

    service: Service
    person: Person
    state: LakeState
    path: Mapping[str, str] = field(default_factory=dict)
    url: str = ""
    is_patient: bool = True
    is_partial: bool = False
    _leases: ExitStack = field(default_factory=ExitStack)

    @property
    def store(self) -> Store:
        """The store."""
        return self.service.store

    @cached_property
    def views(self) -> Catalog:
        """The store's own views; it has no metrics."""
        return self._leases.enter_context(self.service.lake.views.lease(self.state.lake))

    @cached_property
    def fresh(self) -> FreshViews:
        """The store's own views with the channels and documents as well that only the log has."""
        return self._leases.enter_context(self.service.fresh.lease(self.state))

    @cached_property
    def metrics(self) -> Catalog:
        """All tables, those of metrics and verdicts included: of the lake as it was when `state.metrics` was seen."""
        state = self.state.metrics
        if state is None and not self.is_patient:
            self.service.warming.want_metrics()
            raise NotYet
        return self._leases.enter_context(self.service.lake.metrics.lease(state or self.state.lake))

    @property
    def metrics_tag(self) -> str:
        """The version that `metrics` are of."""
        return (self.state.metrics or self.state).tag

    def __enter__(self) -> "Call":
        return self

    def __exit__(self, *_: object) -> None:
        self._leases.close()


@dataclass(frozen=True)
class Operation(Generic[Asked, Given]):
    """One operation; calling it runs its handler.

    Parameters
    ----------
    handler: Its first parameter is the call, its second what is asked: the query of a GET, the body of a POST.
    role: Who may.
    table: Field of the answer that Arrow and CSV have; empty if the answer has columns itself, None for neither.
    is_kept: The answer depends on the lake alone: it has an ETag and is kept.
    is_live: The answer depends on the newest samples of the signal in its path as well.
    sees_log: The answer depends on the rows of channels and documents as well that only the log has.
    is_slow: It needs metrics or long computations, in a pool of threads of their own.
    status: Of its answer.
    is_unfinished: Whether an answer is of something that goes on: its status is 202 then.
    shared_s: Who asks the same within so many seconds gets the same answer.
    media_type: Of an answer that is a file.
    """

    method: str
    path: str
    handler: Callable[[Call, Asked], Given]
    role: Role
    table: str | None = None
    is_kept: bool = False
    is_slow: bool = False
    status: int = 200
    is_unfinished: Callable[[Any], bool] | None = None
    is_live: bool = False
    sees_log: bool = False
    shared_s: float = 0.0
    media_type: str = ""

    def version(self, service: Service, state: LakeState, path: Mapping[str, str]) -> str:
        """Names all that a kept answer depends on."""
        tag = state.tag
        if self.is_slow and state.metrics is not None and state.metrics.tag != tag:
            tag = f"{tag}-{state.metrics.number}"
        if self.sees_log:
            return f"{tag}-{state.log_version}"
        if not self.is_live:
            return tag
        return f"{tag}-{service.live.tail.version((path['unit'], path['run'], path['signal']))}"

    def __call__(self, call: Call, asked: Asked) -> Given:
        """Answer; what takes long and depends on the lake alone is computed once for pages and programs."""
        if not (self.is_kept and self.is_slow):
            return self.handler(call, asked)
        key = (
            self.path,
            tuple(call.path.items()),
            msgspec.json.encode(asked),
            self.version(call.service, call.state, call.path),
        )
        found: Given = call.service.memo.result(key, lambda: self.handler(call, asked))
        return found

    @property
    def name(self) -> str:
        """Name of the operation for programs."""
        return self.handler.__name__

    @property
    def about(self) -> str:
        """What it does, the text of its handler."""
        return (self.handler.__doc__ or "").strip()

    @cached_property
    def asked(self) -> type[Asked]:
        """Type of its parameters, or of its body."""
        names = list(self._hints)
        found: type[Asked] = self._hints[names[1]]
        return found

    @cached_property
    def answer(self) -> Any:
        """Type of its answer in JSON."""
        return self._hints["return"]

    @cached_property
    def _hints(self) -> dict[str, Any]:
        return get_type_hints(self.handler, include_extras=True)


def get(
    path: str,
    *,
    table: str | None = None,
    role: Role = Role.VIEWER,
    is_kept: bool = True,
    is_slow: bool = False,
    is_live: bool = False,
    sees_log: bool = False,
    shared_s: float = 0.0,
    media_type: str = "",
) -> Callable[[Callable[[Call, Asked], Given]], Operation[Asked, Given]]:
    """Declare an operation that reads."""

    def declare(handler: Callable[[Call, Asked], Given]) -> Operation[Asked, Given]:
        return Operation(
            "GET",
            path,
            handler,
            role,
            table,
            is_kept,
            is_slow,
            is_live=is_live,
            sees_log=sees_log,
            shared_s=shared_s,
            media_type=media_type,
        )

    return declare


def post(
    path: str,
    *,
    role: Role,
    is_slow: bool = True,
    status: int = 200,
    is_unfinished: Callable[[Any], bool] | None = None,
) -> Callable[[Callable[[Call, Asked], Given]], Operation[Asked, Given]]:
    """Declare an operation with a body."""

    def declare(handler: Callable[[Call, Asked], Given]) -> Operation[Asked, Given]:
        return Operation("POST", path, handler, role, is_slow=is_slow, status=status, is_unfinished=is_unfinished)

    return declare


def link(*segments: str, **parameters: object) -> str:
    """A path of this server, its parts quoted; parameters that are None or empty are left out.

    >>> link("api", "units", "A/../B"), link("units", after="<x>", limit=None)
    ('/api/units/A%2F..%2FB', '/units?after=%3Cx%3E')
    """
    path = "/" + "/".join(quote(each, safe="") for each in segments)
    given = {name: value for name, value in parameters.items() if value not in (None, "", (), [])}
    return f"{path}?{urlencode(given, doseq=True)}" if given else path
