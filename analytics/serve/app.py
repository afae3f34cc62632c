"""The application: routes of API and pages behind the gate."""

import functools
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.resources import as_file, files

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from analytics.serve.api.routes import api_routes
from analytics.serve.doors.gate import PERSON, Gate, address_of
from analytics.serve.doors.roles import Person
from analytics.serve.pages.frame.problem_page import problem_response
from analytics.serve.pages.routes import page_routes
from analytics.serve.problems import Forbidden, HttpProblem, Misdirected, TooLarge, TooMany, TooSlow, WrongMethod
from analytics.serve.service import Service
from stream.errors import GyrofleetError, NotFound

_LEAST_COMPRESSED_BYTES = 1000
_COMPRESSION = 1  # a picture in a third of the time of level 4, 4 % longer
# attempts, rather than slips
_REPORTED = (Forbidden, Misdirected, TooLarge, TooMany, TooSlow)


def application(service: Service, names: tuple[str, ...]) -> ASGIApp:
    """The ASGI application of a server."""

    @asynccontextmanager
    async def life(_app: Starlette) -> AsyncIterator[None]:
        async with service.running():
            yield

    with as_file(files("analytics.serve") / "static") as folder:
        static = StaticFiles(directory=folder)
    app = Starlette(
        routes=[*api_routes(service), *page_routes(service), Mount("/static", static, name="static")],
        middleware=[Middleware(GZipMiddleware, minimum_size=_LEAST_COMPRESSED_BYTES, compresslevel=_COMPRESSION)],
        exception_handlers={
            GyrofleetError: functools.partial(_refuse, service),
            HTTPException: _refuse_http,
            Exception: _fail,
        },
        lifespan=life,
    )
    refuse = functools.partial(_problem, service)
    return Gate(app, service.doorkeeper, names, refuse, functools.partial(_count, service))


def _count(service: Service) -> None:
    service.requests += 1


def _problem(service: Service, request: Request, error: GyrofleetError) -> Response:
    if isinstance(error, _REPORTED):
        person: Person | None = request.scope.get(PERSON)
        who = "nobody" if person is None else person.name
        what = f"{request.method} {request.url.path} as {who}: {error}"
        service.doorkeeper.watch.saw("refused", address_of(request.scope), what)
    return problem_response(request, error)


async def _refuse(service: Service, request: Request, error: Exception) -> Response:
    assert isinstance(error, GyrofleetError)
    return _problem(service, request, error)


async def _refuse_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    path = request.url.path
    if error.status_code == 404:
        return problem_response(request, NotFound(f"there is nothing at {path[:200]}; /api/openapi.json lists the API"))
    if error.status_code == 405:
        methods = (error.headers or {}).get("Allow", "")
        answer = problem_response(request, WrongMethod(f"{path[:200]} does not take {request.method}, but {methods}"))
        answer.headers["Allow"] = methods
        return answer
    return problem_response(request, HttpProblem(str(error.detail)))


async def _fail(request: Request, error: Exception) -> Response:
    del error  # the server's log has it
    return problem_response(
        request, GyrofleetError("the server made a mistake; its log says which. Please report it with what you did")
    )
