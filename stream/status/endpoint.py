"""`/metrics` for Prometheus and `/health` of a role, over HTTP."""

import json
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.exposition import make_wsgi_app
from prometheus_client.registry import Collector, CollectorRegistry

from stream.closing import Closing
from stream.errors import BadInput
from stream.status.role_status import RoleState, RoleStatus
from stream.terminal.option_checks import parse_listen

Collect = Callable[[], RoleStatus]
_CONDITIONS = {
    RoleState.WORKING: 1.0, RoleState.ENDED: 1.0, RoleState.PAUSED: 0.5, RoleState.FAILED: 0.0,
    RoleState.INTERRUPTED: 0.0,
}  # fmt: skip


def families(statuses: Iterable[RoleStatus]) -> Iterator[Metric]:
    """The numbers of roles as Prometheus has them: ``gyrofleet_ROLE_NUMBER{name="..."}``."""
    found: dict[str, GaugeMetricFamily] = {}

    def add(name: str, about: str, labels: dict[str, str], value: float) -> None:
        family = found.setdefault(name, GaugeMetricFamily(name, about, labels=list(labels)))
        family.add_metric(list(labels.values()), value)

    for status in statuses:
        labels = {"name": status.name, "host": status.host}
        numbers = {
            "up": _CONDITIONS.get(RoleState(status.state), 0.0) if status.condition == status.state else 0.0,
            "started_seconds": status.began_ns / 1e9, "reported_seconds": status.at_ns / 1e9, **status.numbers,
        }  # fmt: skip
        if status.run is not None:
            labels["run"] = status.run.run
            numbers |= {"step": float(status.run.step), "steps": float(status.run.steps)}
            numbers |= {} if status.run.left_s is None else {"left_seconds": status.run.left_s}
        for number, value in numbers.items():
            add(f"gyrofleet_{status.role}_{number}", f"{number} of `gyrofleet {status.role}`", labels, value)
    yield from found.values()


class _Statuses(Collector):
    def __init__(self, collect: Collect) -> None:
        self._collect = collect

    def collect(self) -> Iterable[Metric]:
        return families([self._collect()])


class StatusEndpoint(Closing):
    """Serves `/metrics` and `/health` of a role at ``HOST:PORT``, in a thread; port 0 takes a free one.

    `/health` answers 200 while the role works and 503 while it does not, with its trouble. Raises a BadInput if the
    address cannot be listened on.
    """

    def __init__(self, address: str, collect: Collect) -> None:
        place = parse_listen(address)
        registry = CollectorRegistry()
        registry.register(_Statuses(collect))
        metrics = make_wsgi_app(registry)

        def answer(environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
            if environ["PATH_INFO"] == "/metrics":
                return list(metrics(environ, start_response))
            if environ["PATH_INFO"] != "/health":
                start_response("404 Not Found", [("Content-Type", "text/plain")])
                return [b"/metrics and /health are here\n"]
            status = collect()
            is_well = status.state is RoleState.WORKING
            start_response("200 OK" if is_well else "503 Service Unavailable", [("Content-Type", "application/json")])
            about = {"role": status.role, "name": status.name, "state": status.state, "trouble": status.trouble}
            return [json.dumps(about).encode()]

        try:
            self._server = _Server(place, _Handler)
        except (OSError, ValueError, OverflowError) as error:
            raise BadInput(f"--status-listen {address}: {error}; write it as 127.0.0.1:9464, a free port") from error
        self._server.set_app(answer)
        self.address = f"{self._server.server_address[0]!s}:{self._server.server_address[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="gyrofleet-metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(WSGIServer):
    daemon_threads = True

    def server_bind(self) -> None:
        """Bind without asking a name server for the host's name."""
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])
        self.setup_environ()


class _Handler(WSGIRequestHandler):
    timeout = 5.0

    def log_message(self, *_: object) -> None:
        """Print nothing for each request."""
