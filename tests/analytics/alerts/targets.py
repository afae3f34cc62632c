"""Servers that misbehave as targets of alerts, and a book with alerts for them."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from analytics.alerts.book import AlertBook
from analytics.alerts.conditions.role import DiskCondition
from analytics.alerts.finding import Finding
from analytics.alerts.rules import Rule
from analytics.alerts.sender import TargetSender
from analytics.alerts.targets import Target
from analytics.loop.bilingual import Bilingual
from storage.store import Store

RULE = Rule(name="disk", condition=DiskCondition(), to=("shift",), severity="alarm", clear_after_s=0.0)


def until(is_so: Callable[[], Any], timeout_s: float = 60.0) -> Any:
    deadline = time.monotonic() + timeout_s
    while not (found := is_so()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return found


def finding(key: str, subject: str = "SIM-0001", *, is_event: bool = True) -> Finding:
    return Finding(key, subject, Bilingual(f"unit {subject} has FAIL", f"产品{subject}判定为FAIL"), is_event=is_event)


@contextmanager
def book_with(folder: Path, *findings: Finding) -> Iterator[AlertBook]:
    now_ns = time.time_ns()
    with AlertBook(Store.create(folder / "S"), now_ns) as book:
        for each in findings:
            book.see(RULE, each, now_ns, now_ns)
        book.save()
        yield book


def sender(book: AlertBook, target: Target, said: list[str], longest_send_s: float = 60.0) -> TargetSender:
    return TargetSender("shift", target, None, book, "S", said.append, time.time_ns, longest_send_s, 0.2)


class LineServer:
    """Listens on TCP and lets `talk` answer each connection, with its number."""

    def __init__(self, talk: Callable[[socket.socket, int], None]) -> None:
        self._talk = talk
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self.connections = 0
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        with suppress(OSError):
            while True:
                line, _ = self._listening.accept()
                self.connections += 1
                with line, suppress(OSError):
                    self._talk(line, self.connections)

    def close(self) -> None:
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self._thread.join(10)


def read_post(line: socket.socket) -> bytes:
    """Head and body of a POST."""
    content = b""
    while b"\r\n\r\n" not in content:
        content += line.recv(65536)
    head, _, body = content.partition(b"\r\n\r\n")
    length = next(int(each.split(b":")[1]) for each in head.splitlines() if each.lower().startswith(b"content-length"))
    while len(body) < length:
        body += line.recv(65536)
    return head + b"\r\n\r\n" + body
