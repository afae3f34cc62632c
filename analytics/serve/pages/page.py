"""Pages: path, template, and what is shown, from the same functions as the API."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar, get_type_hints

import anyio.to_thread
import msgspec
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from analytics.serve.api.endpoint import query_of, url_of
from analytics.serve.api.operation import Call
from analytics.serve.doors.admission import admitted
from analytics.serve.doors.roles import Role
from analytics.serve.pages.render import page
from analytics.serve.pages.waiting import Waiting
from analytics.serve.service import Service

Asked = TypeVar("Asked", bound=msgspec.Struct)
_LANG = "lang"


@dataclass(frozen=True)
class Page(Generic[Asked]):
    """A page; its handler gives what the template shows."""

    path: str
    template: str
    handler: Callable[[Call, Asked], dict[str, Any]]
    is_slow: bool = False

    @cached_property
    def asked(self) -> type[Asked]:
        """Type of its parameters."""
        hints = get_type_hints(self.handler)
        found: type[Asked] = hints[list(hints)[1]]
        return found

    def route(self, service: Service) -> Route:
        """Its route."""
        respond = functools.partial(_respond, shown=self, service=service, waiting=Waiting())
        return Route(self.path, respond, name=f"page_{self.handler.__name__}")


def shown(
    path: str, template: str, *, is_slow: bool = False
) -> Callable[[Callable[[Call, Asked], dict[str, Any]]], Page[Asked]]:
    """Declare a page."""

    def declare(handler: Callable[[Call, Asked], dict[str, Any]]) -> Page[Asked]:
        return Page(path, template, handler, is_slow)

    return declare


async def _respond(request: Request, *, shown: Page[Any], service: Service, waiting: Waiting) -> Response:
    person = admitted(request.scope, Role.VIEWER)
    asked, _ = query_of(request, shown.asked, (_LANG,))

    def made() -> Response:
        with Call(service, person, service.lake.state(), dict(request.path_params), url_of(request)) as call:
            return page(request, shown.template, {"asked": asked, **shown.handler(call, asked)})

    limiter = service.slow if shown.is_slow else service.fast
    make = functools.partial(anyio.to_thread.run_sync, made, limiter=limiter, abandon_on_cancel=True)
    answer = await waiting.answer(request, service, make)
    answer.headers["Cache-Control"] = "private, no-cache"
    return answer
