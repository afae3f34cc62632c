"""Forms of pages that change something: the same operations as those of the API, then back to the page."""

import functools
from typing import Any
from urllib.parse import parse_qsl

import anyio.to_thread
import msgspec
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from analytics.serve.api import alerts, jobs, notes, proposals
from analytics.serve.api.endpoint import limited_body
from analytics.serve.api.operation import Call, Operation
from analytics.serve.api.run import exclusions, run_commands
from analytics.serve.api.unit import diagnosis
from analytics.serve.doors.admission import admitted, check_change
from analytics.serve.doors.origin import local_path
from analytics.serve.service import Service
from stream.decoding import converted
from stream.errors import BadInput, NotFound

ACTIONS: dict[str, Operation[Any, Any]] = {
    each.name: each
    for each in (
        diagnosis.diagnose_unit,
        diagnosis.promote_model,
        diagnosis.roll_back_model,
        jobs.cancel_job,
        jobs.verify_store,
        notes.add_note,
        alerts.acknowledge_alert,
        proposals.approve_proposal,
        proposals.reject_proposal,
        run_commands.command_run,
        exclusions.enter_exclusion,
    )
}
_APART = ("csrf", "back")
_OF_PATH = "path."
_MOST_FIELDS = 300
_WRITTEN = ("text", "reason")  # what a person has typed


async def act(request: Request, *, service: Service) -> Response:
    """Do what a form asks; parameters of the operation's path are fields ``path.NAME``."""
    operation = ACTIONS.get(request.path_params["action"])
    if operation is None:
        raise NotFound(f"there is no action {request.path_params['action']!r}; there are {', '.join(ACTIONS)}")
    content = await limited_body(request)
    try:
        pairs = parse_qsl(content.decode(), keep_blank_values=True, max_num_fields=_MOST_FIELDS)
    except ValueError as error:
        raise BadInput(f"the form cannot be read: {error}") from error
    fields = dict(pairs)
    request.state.written = "\n".join(fields[name] for name in _WRITTEN if fields.get(name))
    person = admitted(request.scope, operation.role)
    check_change(request.scope, fields.get("csrf"))
    path = {name.removeprefix(_OF_PATH): value for name, value in fields.items() if name.startswith(_OF_PATH)}
    given: dict[str, Any] = {
        name: each for name, each in fields.items() if name not in _APART and not name.startswith(_OF_PATH)
    }
    for field in msgspec.structs.fields(operation.asked):
        if field.default == () and field.name in given:  # a choice of several, or of none
            given[field.name] = [each for name, each in pairs if name == field.name and each]
    try:
        asked = converted(given, operation.asked, strict=False)
    except msgspec.ValidationError as error:
        raise BadInput(f"the form is not complete: {error}") from error

    state = await service.state()

    def done() -> None:
        with Call(service, person, state, path) as call:
            operation(call, asked)

    run = functools.partial(anyio.to_thread.run_sync, limiter=service.slow, abandon_on_cancel=True)
    try:
        await run(done)
    finally:
        service.has_changed()
    return RedirectResponse(local_path(fields.get("back", "/")), 303)
