"""Catalogues opened before somebody asks: as the server starts, and when the lake has changed."""

import threading

from analytics.serve.live.follower import FloorFollower
from analytics.serve.shared_lake import SharedLake
from stream.closing import Closing
from stream.errors import GyrofleetError

_LOOK_S = 1.0


class Warming(Closing):
    """A thread that opens the views of each version of the lake, and its metrics if any page has used them lately."""

    def __init__(self, lake: SharedLake, live: FloorFollower) -> None:
        self._lake, self._live = lake, live
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True, name="warming")

    def start(self) -> None:
        """Begin, with the metrics as well: whoever starts a server looks at it."""
        self._thread.start()

    def close(self) -> None:
        """End when the catalogue at work is open, or leave it to the end of the process."""
        self._ends.set()
        if self._thread.ident is not None:
            self._thread.join(timeout=0.1)

    def _watch(self) -> None:
        warm, uses = "", -1
        while not self._ends.is_set():
            try:
                state = self._lake.state()
                if state.tag != warm:
                    warm = state.tag
                    with self._lake.views.lease(state):
                        pass
                    self._live.wait()  # most pages need both, and nobody waits for metrics yet
                    if self._lake.metrics.uses > uses:
                        with self._lake.metrics.lease(state):
                            pass
                        uses = self._lake.metrics.uses
            except (GyrofleetError, OSError):
                pass  # who asks is told
            self._ends.wait(_LOOK_S)
