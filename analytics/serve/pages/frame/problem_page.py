"""Problems as answers: JSON for programs, a page with a sentence for people, the login where nobody is known."""

from urllib.parse import urlencode

import msgspec
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from analytics.serve.pages.frame.render import page
from analytics.serve.problems import Unauthorised, document_of, headers_of, status_of
from stream.errors import GyrofleetError

# of too many tries, and of a store or server that is away for a while
_PASSING = (429, 503)
_AGAIN_S = "5"
_OF_PROGRAMS = ("/api/", "/health", "/metrics", "/static/")


def problem_response(request: Request, error: GyrofleetError) -> Response:
    """The answer to a request that fails."""
    status = status_of(error)
    path = request.url.path
    if path.startswith(_OF_PROGRAMS) or "text/html" not in request.headers.get("accept", ""):
        return Response(msgspec.json.encode(document_of(error)), status, headers_of(error), "application/json")
    written = _written(request)
    if isinstance(error, Unauthorised) and not written:
        return _to_login(request)
    shown = {"status": status, "message": str(error), "written": written}
    answer = page(request, "frame/problem.html.jinja", shown, status)
    answer.headers.update(headers_of(error))
    if request.method == "GET" and status in _PASSING:
        answer.headers["Refresh"] = answer.headers.get("Retry-After", _AGAIN_S)  # the browser asks once more by itself
    return answer


def _written(request: Request) -> str:
    """What a person typed into a form of this site that was refused: a session that has ended must not lose it."""
    is_own = request.headers.get("sec-fetch-site") == "same-origin"
    return str(getattr(request.state, "written", "")) if is_own else ""


def _to_login(request: Request) -> Response:
    """The login page; after a click on another site the page asks once more, now with the cookie."""
    wanted = request.url.path + (f"?{request.url.query}" if request.url.query else "")
    if request.method == "GET" and request.headers.get("sec-fetch-site") == "cross-site":
        return page(request, "frame/again.html.jinja", {"url": wanted})
    parameters = urlencode({"next": wanted}) if request.method == "GET" and wanted != "/" else ""
    return RedirectResponse(f"/login?{parameters}" if parameters else "/login", 303)
