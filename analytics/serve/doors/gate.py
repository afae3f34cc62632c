"""The gate before all routes: names of the host, who asks, headers of every answer."""

import time
from collections.abc import Callable, Collection

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request, cookie_parser
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from analytics.serve.doors.doorkeeper import Doorkeeper
from analytics.serve.doors.headers import SECURITY_HEADERS
from analytics.serve.doors.origin import is_named
from analytics.serve.doors.proxy import Caller, ForgedProxy
from analytics.serve.doors.roles import Person
from analytics.serve.problems import HttpProblem, Misdirected, TooMany
from stream.errors import GyrofleetError

PERSON = "gyrofleet.person"
_PEER = "gyrofleet.peer"
# who listens is asked for again so often
_CHECK_S = 5.0


class Gate:
    """Puts the person who asks into the scope of each request, or refuses it.

    Parameters
    ----------
    app: What is behind the gate.
    doorkeeper: Who knows people and programs.
    names: Names of the host.
    refuse: Makes the answer of a problem.
    count: Called for each request.
    """

    def __init__(
        self,
        app: ASGIApp,
        doorkeeper: Doorkeeper,
        names: Collection[str],
        refuse: Callable[[Request, GyrofleetError], Response],
        count: Callable[[], None],
    ) -> None:
        self._app, self._doorkeeper, self._names = app, doorkeeper, names
        self._refuse, self._count = refuse, count

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
            return
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        checked_s = time.monotonic()
        is_over = False

        async def send_with_headers(message: Message) -> None:
            nonlocal checked_s, is_over
            if is_over:
                return
            if message.get("more_body") and time.monotonic() - checked_s > _CHECK_S:
                checked_s = time.monotonic()
                if is_over := not self._is_still(scope):
                    message = {"type": "http.response.body", "body": b"", "more_body": False}
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in SECURITY_HEADERS.items():
                    headers.setdefault(name, value)
                headers.setdefault("Cache-Control", "no-store")
                headers.update({"Connection": "close"} if _has_two_lengths(scope) else {})
            await send(message)

        self._count()
        scope[PERSON] = None
        if self._doorkeeper.is_secure:
            scope["scheme"] = "https"  # also where a proxy has ended TLS
        try:
            scope[PERSON] = self._known(scope)
        except GyrofleetError as problem:
            response = self._refuse(Request(scope, receive), problem)
            await response(scope, receive, send_with_headers)
            return
        await self._app(scope, receive, send_with_headers)

    def _is_still(self, scope: Scope) -> bool:
        """Whether who has asked for a long answer may still have it: logged in, with a role that is no lower."""
        before: Person | None = scope[PERSON]
        if before is None:
            return True  # nothing that needs somebody
        try:
            now = self._known(scope)
        except TooMany:
            return True
        except GyrofleetError:
            return False
        return now is not None and now.name == before.name and now.role >= before.role

    def _known(self, scope: Scope) -> Person | None:
        headers = Headers(scope=scope)
        if _has_two_lengths(scope):
            raise HttpProblem("the request has a Content-Length and a Transfer-Encoding; send one of them")
        if not is_named(headers.get("host", ""), self._names):
            raise Misdirected(
                "the request is for another host; call this server by its address, or start it with --name HOST"
            )
        caller = self._caller(headers, scope)
        cookies = cookie_parser(headers.get("cookie", ""))
        return self._doorkeeper.identify(headers, cookies, address_of(scope), caller)

    def _caller(self, headers: Headers, scope: Scope) -> Caller | None:
        """Whom the proxy names; its address is that of the request from here on. What is forged counts for nothing."""
        proxy, peer = self._doorkeeper.proxy, scope.setdefault(_PEER, address_of(scope))
        if proxy is None:
            return None
        try:
            caller = proxy.caller(headers, peer)
        except ForgedProxy as problem:
            self._doorkeeper.watch.saw("header ignored", peer, str(problem))
            return None
        if caller is not None:
            scope["client"] = (caller.address, 0)
        return caller


def _has_two_lengths(scope: Scope) -> bool:
    """Whether a proxy might take the end of a request for the begin of another one (RFC 9112 6.1)."""
    names = {name.lower() for name, _ in scope["headers"]}
    return {b"content-length", b"transfer-encoding"} <= names


def address_of(scope: Scope) -> str:
    """Address of who sends a request."""
    client = scope.get("client")
    return str(client[0]) if client else "unknown"
