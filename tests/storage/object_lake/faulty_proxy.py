"""A proxy in front of an object store that fails as networks and servers do, where a test asks for it."""

import http.client
import re
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


@dataclass
class Fault:
    """What happens to the next `times` requests of a method whose path matches.

    `kind`: refused (500, nothing happens), failed (it happens, 500 is answered), lost (it happens, no answer), late (no
    answer in time, it happens), cut (half of the answer), half (half of the upload arrives), flipped (a bit of what is
    uploaded), or before (`action` runs first, then it happens).
    """

    kind: str
    method: str
    path: str
    times: int = 1
    action: Callable[[], None] | None = None


@dataclass
class FaultyProxy:
    """Forwards requests to `port`; `seen` are methods and paths of all."""

    port: int
    faults: list[Fault] = field(default_factory=list)
    seen: list[tuple[str, str]] = field(default_factory=list)
    late_s: float = 3.0

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        handler = type("Handler", (_Handler,), {"proxy": self})
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"

    def fault(self, method: str, path: str) -> Fault | None:
        with self._lock:
            self.seen.append((method, path))
            for each in self.faults:
                if each.times and each.method == method and re.search(each.path, path):
                    each.times -= 1
                    return each
        return None

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    proxy: FaultyProxy

    def log_message(self, *_: Any) -> None:
        pass

    def _handle(self) -> None:
        fault = self.proxy.fault(self.command, self.path)
        kind = "" if fault is None else fault.kind
        length = int(self.headers.get("Content-Length") or 0)
        if kind == "half":
            self.rfile.read(length // 2)
            self._hang_up()
            return
        body = self.rfile.read(length)
        if kind == "refused":
            self._answer(500, [], b"<Error><Code>InternalError</Code></Error>")
            return
        if kind == "before":
            assert fault is not None
            assert fault.action is not None
            fault.action()
        if kind == "flipped":
            body = bytes([body[0] ^ 1]) + body[1:]
        if kind == "late":
            time.sleep(self.proxy.late_s)
        upstream = http.client.HTTPConnection("127.0.0.1", self.proxy.port, timeout=30)
        headers = {
            name: value for name, value in self.headers.items() if name.lower() not in {"connection", "content-md5"}
        }
        upstream.request(self.command, self.path, body, headers)
        answer = upstream.getresponse()
        content = answer.read()
        upstream.close()
        if kind == "lost":
            self._hang_up()
        elif kind == "failed":
            self._answer(500, [], b"<Error><Code>InternalError</Code></Error>")
        elif kind == "cut":
            self._answer(answer.status, answer.getheaders(), content, sent=len(content) // 2)
            self._hang_up()
        else:
            self._answer(answer.status, answer.getheaders(), content)

    do_GET = do_PUT = do_POST = do_DELETE = do_HEAD = _handle

    def _answer(self, status: int, headers: list[tuple[str, str]], body: bytes, sent: int | None = None) -> None:
        try:
            self.send_response_only(status)
            for name, value in headers:
                if name.lower() not in {"transfer-encoding", "connection", "content-length"}:
                    self.send_header(name, value)
            length = (
                {name.lower(): value for name, value in headers}.get("content-length")
                if self.command == "HEAD"
                else None
            )
            self.send_header("Content-Length", length or str(len(body)))
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(body[:sent])
                self.wfile.flush()
        except OSError:
            self.close_connection = True  # the client has given up

    def _hang_up(self) -> None:
        self.close_connection = True
        with_connection = self.connection
        try:
            with_connection.shutdown(socket.SHUT_RDWR)
        except OSError:
            return
