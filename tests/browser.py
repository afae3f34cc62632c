"""A real browser: Chromium without a screen, through the WebDriver protocol of its chromedriver."""

import json
import shutil
import subprocess
import time
import urllib.error
import urllib.request
from typing import Any

from tests.free_ports import free_endpoint

PROGRAMS = ("chromium", "chromedriver")
IS_THERE = all(shutil.which(name) for name in PROGRAMS)
_PATIENCE_S = 60.0
_OPTIONS = {
    "capabilities": {
        "alwaysMatch": {
            "goog:chromeOptions": {"args": ["--headless=new", "--no-sandbox", "--disable-gpu"]},
            "goog:loggingPrefs": {"browser": "ALL"},
        }
    }
}


class Browser:
    """A window of a browser of its own."""

    def __enter__(self) -> "Browser":
        port = free_endpoint().rpartition(":")[2]
        self._url = f"http://127.0.0.1:{port}"
        self._driver = subprocess.Popen(
            ["chromedriver", f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            try:
                self._session = "/session/" + self._asked("POST", "/session", _OPTIONS)["sessionId"]
                return self
            except urllib.error.URLError:
                if time.monotonic() > deadline or self._driver.poll() is not None:
                    self._driver.kill()
                    raise
                time.sleep(0.1)

    def __exit__(self, *_: object) -> None:
        self._asked("DELETE", self._session)
        self._driver.terminate()
        self._driver.wait()

    def open(self, url: str, *, width: int = 1100) -> None:
        """Show a page in a window of this width, pixels."""
        self._asked("POST", f"{self._session}/window/rect", {"width": width, "height": 900})
        self._asked("POST", f"{self._session}/url", {"url": url})

    def emulate(self, theme: str) -> None:
        """Show pages as ``light`` or ``dark``."""
        self.command("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": theme}])

    def command(self, name: str, /, **parameters: Any) -> Any:
        """Send a command of the DevTools protocol; its answer."""
        body = {"cmd": name, "params": parameters}
        return self._asked("POST", f"{self._session}/goog/cdp/execute", body)

    def before_pages(self, script: str) -> None:
        """Run a script in every page before its own ones."""
        self.command("Page.addScriptToEvaluateOnNewDocument", source=script)

    def ask(self, expression: str) -> Any:
        """Value of an expression in the page."""
        return self._asked("POST", f"{self._session}/execute/sync", {"script": f"return {expression}", "args": []})

    def complaints(self) -> list[str]:
        """What the page had to complain of since the last time."""
        return [str(each["message"]) for each in self._asked("POST", f"{self._session}/se/log", {"type": "browser"})]

    def _asked(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self._url + path, data, {"Content-Type": "application/json"}, method=method)
        with urllib.request.urlopen(request, timeout=_PATIENCE_S) as answer:
            return json.load(answer)["value"]
