"""The server's process: sockets, signals, an end at once."""

import asyncio
import gc
import math
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

import uvicorn

from analytics.serve.app import application
from analytics.serve.doors.doorkeeper import Doorkeeper
from analytics.serve.doors.line import line_class
from analytics.serve.doors.login_file import LoginFile
from analytics.serve.doors.proxy import Proxy
from analytics.serve.doors.server_log import watch_log
from analytics.serve.doors.users_file import UsersFile
from analytics.serve.live.follower import FloorFollower
from analytics.serve.service import Service
from analytics.serve.settings import Settings
from analytics.serve.shared_lake import SharedLake
from analytics.serve.sql_pool import SqlPool
from storage.store import Store
from stream.errors import BadInput
from stream.no_pandas import hide_pandas

if TYPE_CHECKING:
    from analytics.serve.doors.oidc.oidc_login import OidcLogin

_GRACE_S = 2
_KEEP_ALIVE_S = 20
_BACKLOG = 512
_SAME_S = 1.0
# the recorder of the same machine goes first
_NICER = 1
# Python's 5 ms let a request wait that long at each step beside a thread that computes
_SWITCH_S = 0.0005
# collections of reference cycles, of which requests leave few, hold up all threads: 11 % of the time by default
_COLLECTED = (10_000, 20, 20)


class _Server(uvicorn.Server):
    """A server whose signals are handled by `serve`, and which says when it is ready."""

    def __init__(self, config: uvicorn.Config, on_ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._on_ready = on_ready

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals alone."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start, and say so."""
        await super().startup(sockets)
        self._on_ready()


def serve(store: Store, settings: Settings, on_ready: Callable[[str], None]) -> None:
    """Serve a store until SIGINT or SIGTERM; `on_ready` gets the server's URL, without a path."""
    settings.check()
    users = None if settings.users_path is None else UsersFile(settings.users_path)
    file = LoginFile() if settings.login_path is None else LoginFile.read(settings.login_path)
    proxy = None if file.proxy is None else Proxy(file.proxy, file.proxy_secret())
    listening = _listening(settings)
    port = listening.getsockname()[1]
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    url = f"{'https' if settings.certificate else 'http'}://{host}:{port}"
    name = f"gyrofleet_{port}"
    try:
        oidc = _oidc(file, settings, settings.url or url)
    except BaseException:
        listening.close()
        raise
    doorkeeper = Doorkeeper(
        token=settings.token, token_role=settings.token_role, users=users,
        cookie=f"__Host-{name}" if settings.is_secure else name, is_secure=settings.is_secure, proxy=proxy, oidc=oidc,
    )  # fmt: skip
    live = FloorFollower(store)
    service = Service(
        store, doorkeeper, SharedLake(store, live.entered), SqlPool(store), live, is_on_loopback=settings.is_on_loopback
    )
    watch_log(doorkeeper.watch)
    config = uvicorn.Config(
        application(service, settings.all_names), log_config=None, access_log=False, ws="none", server_header=False,
        proxy_headers=False, lifespan="on", timeout_graceful_shutdown=_GRACE_S, timeout_keep_alive=_KEEP_ALIVE_S,
        ssl_certfile=settings.certificate, ssl_keyfile=settings.key,
        http=line_class(doorkeeper.watch),
    )  # fmt: skip
    hide_pandas()
    with suppress(OSError):
        os.nice(_NICER)
    sys.setswitchinterval(_SWITCH_S)
    gc.set_threshold(*_COLLECTED)
    try:
        asyncio.run(_run(_Server(config, lambda: on_ready(url)), listening, service))
    finally:
        service.close()


def _oidc(file: LoginFile, settings: Settings, site: str) -> "OidcLogin | None":
    """Logins by the provider that a file names."""
    if file.oidc is None:
        return None
    from analytics.serve.doors.oidc.oidc_login import OidcLogin  # its libraries are an extra

    if not settings.url and not settings.is_on_loopback:
        raise BadInput(
            f"--host {settings.host} with a login by a provider needs --url, to which it sends browsers back, as "
            "--url https://bench7.plant:8766"
        )
    return OidcLogin(file.oidc, file, site)


async def _run(server: _Server, listening: socket.socket, service: Service) -> None:
    first_s = math.inf

    def stop() -> None:
        nonlocal first_s
        first_s = min(first_s, time.monotonic())
        # a second signal waits for nobody; one at once is the same Ctrl-C, passed on by the program that started this
        server.force_exit = time.monotonic() - first_s > _SAME_S
        server.should_exit = True
        service.stop()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop)
    await server.serve(sockets=[listening])


def _listening(settings: Settings) -> socket.socket:
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)  # else asyncio would delay small answers
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((settings.host, settings.port))
        listening.listen(_BACKLOG)
    except (OSError, OverflowError) as error:
        listening.close()
        raise BadInput(
            f"cannot listen on {settings.host}, port {settings.port}: {error}; give another --port, or 0 for a free one"
        ) from error
    listening.setblocking(False)
    return listening
