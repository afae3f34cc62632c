"""An operation as a route: who may, what is asked, the kept answer or a new one, its form."""

import functools
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace
from typing import Any
from urllib.parse import urlencode

import anyio
import anyio.to_thread
import msgspec
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from analytics.serve.answer_cache import Answer
from analytics.serve.api.encoding import Form, encoded, form_of
from analytics.serve.api.operation import UNFINISHED, Call, NotYet, Operation
from analytics.serve.doors.admission import admitted, check_change
from analytics.serve.doors.roles import Role
from analytics.serve.problems import TooLarge, TooSlow
from analytics.serve.service import Service
from analytics.serve.shared_lake import LakeState
from stream.decoding import converted, decode_json
from stream.errors import BadInput, GyrofleetError, NotEnoughData, NotFound

MOST_BODY_BYTES = 1 << 20
_LONGEST_BODY_S = 30.0
_FORMAT = "format"


def route(operation: Operation[Any, Any], service: Service) -> Route:
    """The route of an operation."""
    respond = functools.partial(_respond, operation=operation, service=service)
    return Route(operation.path, respond, methods=[operation.method], name=operation.name)


def forms_of(operation: Operation[Any, Any]) -> list[Form]:
    """Forms in which an operation answers."""
    return [Form.JSON] if operation.table is None else list(Form)


async def _respond(request: Request, *, operation: Operation[Any, Any], service: Service) -> Response:
    person = admitted(request.scope, operation.role)
    named, form = None, Form.JSON
    if operation.method == "POST":
        check_change(request.scope, request.headers.get("x-csrf-token"))
        asked: msgspec.Struct = body_of(await limited_body(request), operation.asked)
        named = getattr(asked, _FORMAT, None)
        if hasattr(operation.asked, _FORMAT):
            form = form_of(request.headers.get("accept", ""), named, list(Form))
    else:
        asked, others = query_of(request, operation.asked, (_FORMAT,))
        named = others.get(_FORMAT)
        form = form_of(request.headers.get("accept", ""), named, forms_of(operation))
    state = await service.state()
    call = functools.partial(Call, service, person, path=dict(request.path_params), url=url_of(request))

    def answer(state: LakeState, *, is_patient: bool) -> Answer:
        with call(state, is_patient=is_patient) as leased:
            given = operation(leased, asked)
            made = encoded(given, form, operation.table)
        is_unfinished = operation.is_unfinished is not None and operation.is_unfinished(given)
        return replace(made, status=UNFINISHED) if is_unfinished else made

    limiter = service.slow if operation.is_slow else service.fast
    is_repeated = operation.role is Role.VIEWER  # what changes something is done once
    compute = functools.partial(computed, service, state, answer, limiter, is_repeated=is_repeated)
    if not operation.is_kept:
        try:
            made = await service.result(_shared(request, operation, service, state, form, compute))
        finally:
            if not is_repeated:
                service.has_changed()
        return Response(made.body, made.status or operation.status, dict(made.headers), made.media_type)
    version = operation.version(service, state, request.path_params)
    tag = f'"{service.nonce}-{version}-{form}"'
    headers = {"ETag": tag, "Cache-Control": "private, no-cache", "Vary": "Accept"}
    if tag in {each.strip().removeprefix("W/") for each in request.headers.get("if-none-match", "").split(",")}:
        return Response(status_code=304, headers=headers)
    made = await service.result(service.cache.answer((url_of(request), form, version), compute))
    return Response(made.body, operation.status, headers | dict(made.headers), made.media_type)


async def _shared(
    request: Request, operation: Operation[Any, Any], service: Service, state: LakeState, form: Form,
    compute: Callable[[], Awaitable[Answer]],
) -> Answer:  # fmt: skip
    """An answer, or the one that somebody has got a moment ago."""
    if not operation.shared_s:
        return await compute()
    key = ("shared", url_of(request), form, f"{state.tag}-{state.log_version}", str(service.changed))
    return await service.cache.answer(key, compute, operation.shared_s)


async def computed(
    service: Service, state: LakeState, answer: Callable[..., Answer], limiter: anyio.CapacityLimiter,
    *, is_repeated: bool = True,
) -> Answer:  # fmt: skip
    """Compute an answer in a thread; once more if the lake has changed under it, where it `is_repeated`."""
    run = functools.partial(anyio.to_thread.run_sync, limiter=limiter, abandon_on_cancel=True)
    if is_repeated:
        try:
            return await run(functools.partial(answer, state, is_patient=False))
        except NotYet:
            await service.metrics()
            state = await service.state()
        except GyrofleetError as error:
            state, before = await run(service.warming.newest), state
            # what is not there yet may be in what the log has got since
            is_newer = isinstance(error, NotFound | NotEnoughData) and state.log_version != before.log_version
            if state.number == before.number and not is_newer:
                raise
    return await run(functools.partial(answer, state, is_patient=True))


async def limited_body(request: Request) -> bytes:
    """The body of a request; TooLarge if it has more than 1 MiB, TooSlow if it takes more than 30 s."""
    content = bytearray()
    try:
        with anyio.fail_after(_LONGEST_BODY_S):
            async for piece in request.stream():
                content += piece
                if len(content) > MOST_BODY_BYTES:
                    raise TooLarge(f"the request has more than {MOST_BODY_BYTES:,} bytes")
    except TimeoutError as error:
        raise TooSlow(f"the request has not come whole within {_LONGEST_BODY_S:.0f} s") from error
    return bytes(content)


def body_of(content: bytes, kind: type[Any]) -> Any:
    """A body in JSON; BadInput names the field that is not right."""
    try:
        return decode_json(content or b"{}", kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadInput(f"the body is not what is expected: {error}") from error


def query_of(request: Request, kind: type[Any], others: Sequence[str]) -> tuple[Any, dict[str, str]]:
    """Parameters of a request, and those of the names `others`; BadInput names the one that is not right."""
    fields = _fields(kind)  # type: ignore[arg-type]  # a type can be hashed
    given: dict[str, Any] = {}
    for name, value in request.query_params.multi_items():
        if name in fields and getattr(fields[name].type, "__origin__", None) is tuple:
            given.setdefault(name, []).append(value)
        elif name in given:
            raise BadInput(f"parameter {name} is given twice")
        else:
            given[name] = value
    apart = {name: given.pop(name) for name in others if name in given}
    try:
        return converted(given, kind, strict=False), apart
    except msgspec.ValidationError as error:
        known = ", ".join([*fields, *others])
        raise BadInput(f"a parameter is not what is expected: {error}; there are {known}") from error


@functools.cache
def _fields(kind: type[Any]) -> dict[str, msgspec.structs.FieldInfo]:
    """Parameters by their names; to resolve their types takes longer than to read a request."""
    return {each.encode_name: each for each in msgspec.structs.fields(kind)}


def url_of(request: Request) -> str:
    """Path and parameters of a request but its language, which the API has not."""
    query = urlencode([pair for pair in request.query_params.multi_items() if pair[0] != "lang"])
    return f"{request.url.path}?{query}" if query else request.url.path
