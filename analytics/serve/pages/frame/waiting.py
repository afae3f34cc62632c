"""Pages that take long: a word at once, the page when it is made, made once however often it is asked for."""

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable, Callable

from starlette.requests import Request
from starlette.responses import Response

from analytics.serve.pages.frame.render import page
from analytics.serve.service import Service

_PATIENCE_S = 0.5
_MOST = 64
# the window asks again at once, and that request is held
_AGAIN_S, _HELD_S = 0, 10.0
_OF_READER = ("cookie", "accept-language", "authorization")


class Waiting:
    """Pages in the making, by who asks for them."""

    def __init__(self) -> None:
        self._making: OrderedDict[tuple[str, ...], asyncio.Task[Response]] = OrderedDict()

    async def answer(self, request: Request, service: Service, make: Callable[[], Awaitable[Response]]) -> Response:
        """The page; after 0.5 s a page that says it is being made, and asks again, where a browser's window waits.

        Who asks again gets the page as soon as it is made.
        """
        if request.headers.get("sec-fetch-dest") != "document":
            return await service.result(make())
        key = (str(request.url), *(request.headers.get(name, "") for name in _OF_READER))
        task = self._making.get(key)
        patience_s = _PATIENCE_S if task is None else _HELD_S
        if task is None:
            task = self._making[key] = asyncio.ensure_future(make())
            while len(self._making) > _MOST:
                self._making.popitem(last=False)[1].cancel()
        done, _ = await service.result(asyncio.wait({task}, timeout=patience_s))
        if not done:
            answer: Response = page(request, "frame/waiting.html.jinja", {}, 202)
            answer.headers["Refresh"] = str(_AGAIN_S)
            return answer
        self._making.pop(key, None)
        return task.result()
