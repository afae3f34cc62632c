"""What opening a page costs a person: time until it shows what was asked for, and bytes over the wire."""

import json
import socket
import threading
import time
from contextlib import suppress
from typing import Any

from stream.closing import Closing
from tests.browser import Browser

# a page that says that another one is being made counts for nothing but its time and bytes
HOOK = """
const kept = JSON.parse(sessionStorage.getItem("bench") ?? "{}");
kept.began ??= performance.timeOrigin;
kept.loads = (kept.loads ?? 0) + 1;
const keep = () => sessionStorage.setItem("bench", JSON.stringify(kept));
const since = () => performance.timeOrigin + performance.now() - kept.began;
keep();
new MutationObserver(() => {
  const shown = document.querySelector('canvas[aria-label], [role=application][aria-label] canvas, [data-figure] svg');
  if (!shown || kept.drawn !== undefined) return;
  requestAnimationFrame(() => setTimeout(() => { kept.drawn ??= since(); keep(); }));
}).observe(document, {subtree: true, childList: true, attributes: true});
addEventListener("load", () => setTimeout(() => {
  const paint = performance.getEntriesByName("first-contentful-paint")[0];
  if (paint) kept.paint = performance.timeOrigin + paint.startTime - kept.began;
  keep();
}, 500));
"""


class Wire(Closing):
    """A relay in front of a server that counts the bytes in both directions; `port` is its own."""

    def __init__(self, port: int) -> None:
        self.bytes = 0
        self._target = ("127.0.0.1", port)
        self._lock = threading.Lock()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listening.getsockname()[1])
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Take no more connections."""
        self._listening.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listening.accept()
                far = socket.create_connection(self._target)
                for each in (near, far):
                    each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self._relay, args=(near, far), daemon=True).start()
                threading.Thread(target=self._relay, args=(far, near), daemon=True).start()

    def _relay(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while content := source.recv(1 << 16):
                with self._lock:
                    self.bytes += len(content)
                target.sendall(content)
        with suppress(OSError):
            target.shutdown(socket.SHUT_WR)


def opened(browser: Browser, wire: Wire, path: str, settle_s: float = 3.0) -> dict[str, Any]:
    """Open a page of the server behind a wire, with an empty cache, and wait until it is whole."""
    browser.command("Network.clearBrowserCache")
    browser.ask("sessionStorage.clear()")
    before = wire.bytes
    browser.open(f"http://127.0.0.1:{wire.port}{path}", width=1280)
    time.sleep(settle_s)
    kept = json.loads(browser.ask("sessionStorage.getItem('bench')"))
    return {
        "heading": browser.ask("document.querySelector('h1').textContent"),
        "first_paint_ms": kept.get("paint"),
        "drawn_ms": kept.get("drawn"),
        "kilobytes": (wire.bytes - before) / 1000,
        "loads": kept["loads"],
    }
