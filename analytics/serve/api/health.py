"""For machines that watch this one: health, and figures for Prometheus."""

import shutil
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from analytics.serve.doors.admission import admitted
from analytics.serve.doors.gate import PERSON
from analytics.serve.doors.roles import Role
from analytics.serve.service import Service
from storage.store import writer_is_active
from stream.errors import GyrofleetError

if TYPE_CHECKING:
    from prometheus_client.core import Metric


async def health(_request: Request, *, service: Service) -> Response:
    """Whether the server can read its store; for everybody, so it says nothing else."""
    try:
        service.lake.state()
    except GyrofleetError:
        return JSONResponse({"status": "failing", "reason": "the store cannot be read"}, 503)
    return JSONResponse({"status": "ok"})


async def prometheus(request: Request, *, service: Service) -> Response:
    """Figures in the text form of Prometheus; without a token only where the server listens on loopback."""
    if request.scope[PERSON] is not None or not service.is_on_loopback:
        admitted(request.scope, Role.VIEWER)
    from prometheus_client import CollectorRegistry
    from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4, generate_latest

    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Figures(service))
    return Response(generate_latest(registry), headers={"Content-Type": CONTENT_TYPE_PLAIN_0_0_4})


class _Figures:
    """Figures of a server and its store; no names of units, so that the number of series stays small."""

    def __init__(self, service: Service) -> None:
        self._service = service

    def collect(self) -> "Iterator[Metric]":
        """All figures."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        service = self._service
        cache, store = service.cache, service.store
        usage = shutil.disk_usage(store.folder)
        state = service.lake.state()
        gauges: dict[str, tuple[str, Any]] = {
            "up_seconds": ("Seconds since the server started.", time.time() - service.began_s),
            "store_free_bytes": ("Free bytes of the store's disk.", usage.free),
            "store_is_written": ("Whether a recorder writes the store.", int(writer_is_active(store.folder))),
            "lake_manifest": ("Number of the lake's manifest.", state.number),
            "lake_parts": ("Parts of the lake in force.", len(state.parts)),
            "lake_samples": ("Samples in the lake.", sum(part.samples for part in state.parts)),
            "lake_bytes": ("Bytes of the lake's files.", sum(part.bytes for part in state.parts)),
            "sessions": ("Open sessions of browsers.", len(service.doorkeeper.sessions)),
            "cache_bytes": ("Bytes of kept answers.", cache.bytes),
            "threads_busy": ("Requests that threads are answering.", service.busy_threads),
        }
        for name, (about, value) in gauges.items():
            yield GaugeMetricFamily(f"gyrofleet_{name}", about, value=value)
        counters = {
            "requests": ("Requests answered.", service.requests),
            "cache_hits": ("Answers that were kept already.", cache.hits),
            "cache_misses": ("Answers that were computed.", cache.misses),
        }
        for name, (about, value) in counters.items():
            yield CounterMetricFamily(f"gyrofleet_{name}", about, value=value)
