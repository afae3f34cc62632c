"""Pages: path, template, and what is shown, from the same functions as the API."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar, get_type_hints

import msgspec
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route

from analytics.serve.answer_cache import Answer
from analytics.serve.api.endpoint import computed, query_of, url_of
from analytics.serve.api.operation import Call
from analytics.serve.doors.admission import admitted
from analytics.serve.doors.roles import Role
from analytics.serve.pages.frame.language import language_of
from analytics.serve.pages.frame.render import page_of, rendered
from analytics.serve.pages.frame.waiting import Waiting
from analytics.serve.pages.frame.zones import common_zone
from analytics.serve.service import Service
from analytics.serve.shared_lake import LakeState

Asked = TypeVar("Asked", bound=msgspec.Struct)
_LANG = "lang"


@dataclass(frozen=True)
class Page(Generic[Asked]):
    """A page; its handler gives what the template shows.

    Who asks for it within `shared_s` gets the same content, and within twice that while the next one is made.
    """

    path: str
    template: str
    handler: Callable[[Call, Asked], dict[str, Any]]
    is_slow: bool = False
    shared_s: float = 0.0

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
    path: str, template: str, *, is_slow: bool = False, shared_s: float = 0.0
) -> Callable[[Callable[[Call, Asked], dict[str, Any]]], Page[Asked]]:
    """Declare a page."""

    def declare(handler: Callable[[Call, Asked], dict[str, Any]]) -> Page[Asked]:
        return Page(path, template, handler, is_slow, shared_s)

    return declare


async def _respond(request: Request, *, shown: Page[Any], service: Service, waiting: Waiting) -> Response:
    person = admitted(request.scope, Role.VIEWER)
    asked, _ = query_of(request, shown.asked, (_LANG,))
    limiter = service.slow if shown.is_slow else service.fast
    # a window shows what is ready; its script looks for the rest
    is_partial = request.headers.get("sec-fetch-dest") == "document" or "x-partial" in request.headers

    def answer(state: LakeState, *, is_patient: bool) -> Answer:
        path = dict(request.path_params)
        with Call(service, person, state, path, url_of(request), is_patient, is_partial) as call:
            found = {"asked": asked, "metrics_of": state.metrics, "is_behind": state.is_behind}
            found |= shown.handler(call, asked)
            if found.get("zone") is None:
                found["zone"] = common_zone(call)
            return Answer(rendered(request, shown.template, found), HTMLResponse.media_type)

    async def compute() -> Answer:
        return await computed(service, await service.state(), answer, limiter)

    async def made() -> Answer:
        if not shown.shared_s:
            return await compute()
        of_person = (language_of(request), person.role.word, str(person.csrf is None))
        key = ("page", url_of(request), *of_person, str(service.changed), str(is_partial))
        return await service.cache.answer(key, compute, shown.shared_s, stale_s=shown.shared_s)

    async def make() -> Response:
        return page_of(request, (await made()).body)

    found = await waiting.answer(request, service, make)
    found.headers["Cache-Control"] = "private, no-cache"
    return found
