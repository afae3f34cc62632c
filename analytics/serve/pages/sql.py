"""The page of SQL: an editor, tables and examples; the result where a statement was sent."""

import functools
from typing import Any

import anyio.to_thread
from starlette.requests import Request
from starlette.responses import Response

from analytics.serve.api.encoding import Form
from analytics.serve.api.operation import Call, Nothing, link
from analytics.serve.api.query import sql as api
from analytics.serve.doors.admission import admitted, check_change
from analytics.serve.doors.roles import Role
from analytics.serve.pages.frame.render import page
from analytics.serve.pages.sign_in.login import form_of
from analytics.serve.service import Service
from analytics.serve.sql_pool import MOST_ROWS
from stream.decoding import decode_json
from stream.errors import BadInput, GyrofleetError

_SHOWN_ROWS = 500
_SHOWN_BYTES = 4 << 20
_FILES = (Form.CSV, Form.PARQUET, Form.JSON)


async def sql(request: Request, *, service: Service) -> Response:
    """The editor with the statement of the address; its result where the form was sent, or the result as a file."""
    person = admitted(request.scope, Role.VIEWER)
    statement, is_sent, form = request.query_params.get("sql", ""), request.method == "POST", ""
    if is_sent:
        fields = await form_of(request)
        check_change(request.scope, fields.get("csrf"))
        statement, form = fields.get("sql", ""), fields.get("format", "")
        if form not in ("", *_FILES):
            raise BadInput(f"format {form!r} is not one of {', '.join(_FILES)}")

    state = await service.state()

    def made() -> Response:
        with Call(service, person, state) as call:
            if form:
                return _file(call, statement, Form(form))
            return page(request, "sql.html.jinja", _content(call, statement, is_sent=is_sent))

    limiter = functools.partial(anyio.to_thread.run_sync, limiter=service.slow, abandon_on_cancel=True)
    answer = await limiter(made)
    answer.headers["Cache-Control"] = "private, no-cache"
    return answer


def _file(call: Call, statement: str, form: Form) -> Response:
    """The whole result as a file."""
    encoded = api.answered(call, api.SqlAsked(sql=statement, rows=MOST_ROWS)).encoded(form)
    headers = {"Content-Disposition": f'attachment; filename="result.{form}"'}
    return Response(encoded.body, media_type=encoded.media_type, headers=headers)


def _content(call: Call, statement: str, *, is_sent: bool) -> dict[str, Any]:
    result, problem = None, None
    if is_sent:
        asked = api.SqlAsked(sql=statement, rows=_SHOWN_ROWS, shape="shown")
        try:
            encoded = api.answered(call, asked).encoded(Form.JSON, _SHOWN_BYTES)
            result = decode_json(encoded.body)
        except GyrofleetError as error:
            problem = str(error)
    known = api.sql_tables(call, Nothing())
    address = link("sql", sql=statement)
    return {"statement": statement, "result": result, "problem": problem, "known": known, "address": address}
