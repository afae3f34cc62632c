"""The page of SQL: an editor, tables and examples; the result where a statement was sent."""

import functools
from typing import Any

import anyio.to_thread
import msgspec
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from analytics.serve.api import sql as api
from analytics.serve.api.encoding import Form
from analytics.serve.api.operation import Call, Nothing, link
from analytics.serve.doors.admission import admitted, check_change
from analytics.serve.doors.roles import Role
from analytics.serve.pages.login import form_of
from analytics.serve.pages.render import page
from analytics.serve.service import Service
from stream.errors import GyrofleetError

_SHOWN_ROWS = 500


async def sql(request: Request, *, service: Service) -> Response:
    """The editor with the statement of the address; with its result where the form was sent."""
    person = admitted(request.scope, Role.VIEWER)
    statement, is_sent = request.query_params.get("sql", ""), request.method == "POST"
    if is_sent:
        fields = await form_of(request)
        check_change(request.scope, fields.get("csrf"))
        statement = fields.get("sql", "")

    def made() -> HTMLResponse:
        with Call(service, person, service.lake.state()) as call:
            return page(request, "sql.html.jinja", _content(call, statement, is_sent=is_sent))

    limiter = functools.partial(anyio.to_thread.run_sync, limiter=service.slow, abandon_on_cancel=True)
    answer = await limiter(made)
    answer.headers["Cache-Control"] = "private, no-cache"
    return answer


def _content(call: Call, statement: str, *, is_sent: bool) -> dict[str, Any]:
    result, problem = None, None
    if is_sent:
        asked = api.SqlAsked(sql=statement, rows=_SHOWN_ROWS, shape="arrays")
        try:
            # the handler gives a result that encodes itself
            encoded = api.sql(call, asked).encoded(Form.JSON)  # type: ignore[attr-defined]
            result = msgspec.json.decode(encoded.body)
        except GyrofleetError as error:
            problem = str(error)
    known = api.sql_tables(call, Nothing())
    address = link("sql", sql=statement)
    return {"statement": statement, "result": result, "problem": problem, "known": known, "address": address}
