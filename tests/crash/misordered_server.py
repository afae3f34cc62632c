"""A plant's server whose answers come doubled, in another order, and to another question; seeded.

``python -m tests.crash.misordered_server STORE ENDPOINT SEED``
"""

import random
import sys
import time
from pathlib import Path

from storage.replication.sources.bus_server import PlantServer
from storage.replication.sources.folder_source import FolderSource
from stream.transport.zenoh_bus import ZenohBus

_WRONG = 0.1


class MisorderedServer(PlantServer):
    """Answers each tenth request wrongly."""

    def __init__(self, bus: ZenohBus, source: FolderSource, seed: int) -> None:
        self._rng = random.Random(seed)
        self._last: dict[str, bytes] = {}
        super().__init__(bus, source)

    def _answer(self, key: str, payload: bytes) -> bytes:
        content = super()._answer(key, payload)
        what = key.rpartition("/")[2]
        before, self._last[what] = self._last.get(what, content), content
        if what == "plant" or self._rng.random() > _WRONG:
            return content
        if what == "read":
            return before  # the answer to the question before
        lines = content.splitlines(keepends=True)
        if self._rng.random() < 0.5:
            self._rng.shuffle(lines)
        else:
            lines = [line for line in lines for _ in range(2)]
        return b"".join(lines)


def main() -> None:
    with ZenohBus(listen=[sys.argv[2]]) as bus, FolderSource(Path(sys.argv[1])) as source:
        MisorderedServer(bus, source, int(sys.argv[3]))
        print('{"event":"serving"}', flush=True)
        while True:
            time.sleep(1.0)


if __name__ == "__main__":
    main()
