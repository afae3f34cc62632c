"""Pages of a login by a provider: there, back again, and out; failures are reported in both languages."""

import anyio.to_thread
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from analytics.serve.doors.gate import address_of
from analytics.serve.doors.oidc.oidc_problem import OidcProblem
from analytics.serve.doors.origin import local_path
from analytics.serve.doors.sessions import Session
from analytics.serve.pages.frame.render import page
from analytics.serve.service import Service
from stream.errors import NotFound

_HERE = "here"
_COOKIE_S = 600


async def start(request: Request, *, service: Service) -> Response:
    """Send the browser to the provider."""
    keeper, target = service.doorkeeper, local_path(request.query_params.get("next", "/"))
    if (oidc := keeper.oidc) is None:
        raise NotFound("this server has no login by a provider; `gyrofleet serve --login FILE` has one")
    if _HERE not in request.query_params and request.headers.get("host", "") != oidc.site.partition("://")[2]:
        # the provider sends browsers back to the server's one address: the cookie has to be of that one
        here = request.url.replace(scheme=oidc.site.partition("://")[0], netloc=oidc.site.partition("://")[2])
        return RedirectResponse(str(here.include_query_params(**{_HERE: "1"})), 303)
    try:
        begun = await anyio.to_thread.run_sync(oidc.begin, target, address_of(request.scope), limiter=service.logins)
    except OidcProblem as problem:
        return _failed(request, service, problem)
    answer = RedirectResponse(begun.url, 303)
    answer.headers["Set-Cookie"] = keeper.set_oidc_cookie(begun.cookie, _COOKIE_S)
    return answer


async def done(request: Request, *, service: Service) -> Response:
    """Take the provider's answer, and open a session."""
    keeper, address = service.doorkeeper, address_of(request.scope)
    if (oidc := keeper.oidc) is None:
        raise NotFound("this server has no login by a provider; `gyrofleet serve --login FILE` has one")
    answer, cookie = dict(request.query_params), request.cookies.get(keeper.oidc_cookie, "")
    try:
        entered = await anyio.to_thread.run_sync(oidc.end, answer, cookie, limiter=service.logins)
        session = keeper.begin_by_provider(entered, address)
    except OidcProblem as problem:
        return _failed(request, service, problem)
    # a page that goes on by itself: after a redirect from another site browsers would leave the cookie out
    found = page(request, "frame/again.html.jinja", {"url": entered.target})
    found.headers.append("Set-Cookie", keeper.set_cookie(session))
    found.headers.append("Set-Cookie", keeper.set_oidc_cookie("", 0))
    return found


async def logged_out(request: Request, service: Service, session: Session | None) -> Response:
    """Where a browser goes after its session has ended: to the provider's logout as well, if it came from there."""
    oidc = service.doorkeeper.oidc
    if session is None or not session.id_token or oidc is None:
        return RedirectResponse("/login", 303)
    back = f"{oidc.site}/login"
    try:
        url = await anyio.to_thread.run_sync(oidc.provider.logout_url, session.id_token, back, limiter=service.logins)
    except OidcProblem as problem:
        service.doorkeeper.watch.saw("logout here only", address_of(request.scope), str(problem))
        url = None
    if url is None:
        return RedirectResponse("/login", 303)
    # no redirect: the policy of forms does not let one lead to another site
    return page(request, "frame/again.html.jinja", {"url": url})


def _failed(request: Request, service: Service, problem: OidcProblem) -> Response:
    service.doorkeeper.watch.saw("login refused", address_of(request.scope), f"OIDC, {problem.reason}: {problem}")
    context = {"reason": f"oidc_{problem.reason}", "parts": problem.parts}
    return page(request, "sign_in/login_failed.html.jinja", context, problem.status)
