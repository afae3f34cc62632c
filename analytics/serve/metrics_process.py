"""Metrics of a large lake, computed in a process of their own: a server that computed them would keep pages waiting.

``python -m analytics.serve.metrics_process STORE`` computes what the store does not keep yet, and keeps it.
"""

import os
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

from storage.sql.catalog import Catalog
from storage.store import Store
from stream.closing import Closing

LARGE_SAMPLES = 100_000_000
_NICER = 10


class MetricsProcess(Closing):
    """Computes the metrics of a store; one process at a time, ended with the server."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._process: subprocess.Popen[bytes] | None = None
        self._is_closed = False
        self._lock = threading.Lock()

    def run(self) -> None:
        """Compute what is not kept; what goes wrong is found again by who needs the metrics."""
        command = [sys.executable, "-P", "-m", "analytics.serve.metrics_process", str(self._store.folder.resolve())]
        with self._lock:
            if self._is_closed:
                return
            self._process = subprocess.Popen(  # noqa: S603  a module of ours
                command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
        self._process.wait()

    def close(self) -> None:
        """End it."""
        with self._lock:
            self._is_closed = True
            if self._process is not None:
                self._process.kill()


def main() -> None:
    """Compute the metrics of the store that the command line names."""
    with suppress(OSError):
        os.nice(_NICER)
    with Catalog(Store.open(Path(sys.argv[1]))) as catalog:
        catalog.fill()


if __name__ == "__main__":
    main()
