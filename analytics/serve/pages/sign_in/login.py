"""Login and logout of people."""

from urllib.parse import parse_qs

import anyio.to_thread
from starlette.requests import Request
from starlette.responses import Response

from analytics.serve.api.endpoint import limited_body
from analytics.serve.doors.admission import check_change
from analytics.serve.doors.gate import PERSON, address_of
from analytics.serve.doors.origin import is_of_this_site, local_path
from analytics.serve.pages.frame.render import page
from analytics.serve.pages.sign_in.single_sign_on import logged_out
from analytics.serve.problems import Forbidden, TooMany
from analytics.serve.service import Service
from stream.errors import BadInput


async def login(request: Request, *, service: Service) -> Response:
    """The form of the login, or the login itself: by the token in the printed address, or by what the form sends."""
    doorkeeper, address = service.doorkeeper, address_of(request.scope)
    if request.method == "GET":
        token = request.query_params.get("token")
        target = local_path(request.query_params.get("next", "/"))
        if token is None:
            return _form(request, service, target, "")
        if request.headers.get("sec-fetch-dest", "document") != "document":
            # a picture of another site would use up the tries of this machine
            raise Forbidden("a login by an address is for the browser's address bar; open it there")
        cookie = doorkeeper.begin_by_token(token, address)
        return _entered(request, service, cookie, target)
    if not is_of_this_site(request.headers, is_secure=request.scope["scheme"] == "https"):
        raise Forbidden("a page of another site sent this login; open /login on this server")
    fields = await form_of(request)
    target = local_path(fields.get("next", "/"))
    try:
        if fields.get("token"):
            cookie = doorkeeper.begin_by_token(fields["token"], address)
        else:
            name, password = fields.get("name", ""), fields.get("password", "")
            cookie = await anyio.to_thread.run_sync(
                doorkeeper.begin_by_password, name, password, address, limiter=service.logins, abandon_on_cancel=True
            )
    except TooMany as problem:
        answer = _form(request, service, target, str(problem), problem.status)
        answer.headers["Retry-After"] = f"{problem.wait_s:.0f}"
        return answer
    return _entered(request, service, cookie, target)


async def logout(request: Request, *, service: Service) -> Response:
    """End the session."""
    fields = await form_of(request)
    if request.scope[PERSON] is not None:
        check_change(request.scope, fields.get("csrf"))
    session = service.doorkeeper.sessions.end(request.cookies.get(service.doorkeeper.cookie, ""))
    answer = await logged_out(request, service, session)
    answer.headers["Set-Cookie"] = service.doorkeeper.set_cookie("")
    return answer


async def form_of(request: Request) -> dict[str, str]:
    """Fields of a form; BadInput if it is none."""
    content = await limited_body(request)
    try:
        fields = parse_qs(content.decode(), keep_blank_values=True, max_num_fields=50)
    except ValueError as error:
        raise BadInput(f"the form cannot be read: {error}") from error
    return {name: values[-1] for name, values in fields.items()}


def _entered(request: Request, service: Service, cookie: str | None, target: str) -> Response:
    if cookie is None:
        return _form(request, service, target, "wrong", 403)
    # a page that goes on by itself: after a redirect from another site browsers would leave the cookie out
    answer = page(request, "frame/again.html.jinja", {"url": target})
    answer.headers["Set-Cookie"] = service.doorkeeper.set_cookie(cookie)
    return answer


def _form(request: Request, service: Service, target: str, problem: str, status: int = 200) -> Response:
    context = {
        "next": target, "problem": problem, "has_users": service.doorkeeper.users is not None,
        "has_token": bool(service.doorkeeper.token), "has_provider": service.doorkeeper.oidc is not None,
    }  # fmt: skip
    return page(request, "sign_in/login.html.jinja", context, status)
