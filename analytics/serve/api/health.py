"""For machines that watch this one: health, and figures for Prometheus."""

from collections.abc import Iterable

import anyio.to_thread
from prometheus_client.core import Metric
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4, generate_latest
from prometheus_client.registry import Collector, CollectorRegistry
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from analytics.serve.doors.admission import admitted
from analytics.serve.doors.gate import PERSON
from analytics.serve.doors.roles import Role
from analytics.serve.service import Service
from storage.recording.status_board import read_statuses
from stream.errors import GyrofleetError
from stream.status import role_status as stream_roles
from stream.status.endpoint import families


async def health(_request: Request, *, service: Service) -> Response:
    """Whether the server can read its store; for everybody, so it says nothing else."""
    try:
        service.lake.state()
    except GyrofleetError:
        return JSONResponse({"status": "failing", "reason": "the store cannot be read"}, 503)
    return JSONResponse({"status": "ok"})


async def prometheus(request: Request, *, service: Service) -> Response:
    """Figures in the text form of Prometheus: of this server, and of the roles that report to the store.

    Without a token only where the server listens on loopback; no names of units, so that the number of series is small.
    """
    if request.scope[PERSON] is not None or not service.is_on_loopback:
        admitted(request.scope, Role.VIEWER)
    text = await anyio.to_thread.run_sync(_figures, service, limiter=service.fast, abandon_on_cancel=True)
    return Response(text, headers={"Content-Type": CONTENT_TYPE_PLAIN_0_0_4})


class _Statuses(Collector):
    def __init__(self, service: Service) -> None:
        self._service = service

    def collect(self) -> Iterable[Metric]:
        """All figures."""
        others = [each for each in read_statuses(self._service.store) if each.role is not stream_roles.Role.SERVE]
        return families([*others, self._service.status()])


def _figures(service: Service) -> bytes:
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Statuses(service))
    return generate_latest(registry)
