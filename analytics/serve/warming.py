"""Catalogues opened before somebody asks: as the server starts, and when lake or log have changed."""

import gc
import importlib
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from uuid import UUID

import numpy as np

from analytics.serve.live.follower import FloorFollower
from analytics.serve.live.fresh_views import FreshViews
from analytics.serve.metrics_process import LARGE_SAMPLES
from analytics.serve.shared_lake import LakeState, SharedCatalogue, SharedLake
from storage.store import writer_is_active
from stream.batch import SampleBatch
from stream.closing import Closing
from stream.errors import GyrofleetError
from stream.quantities import read_definitions
from stream.transport.scheduling import be_nicer

_LOOK_S = 0.1
_METRICS_LOOK_S = 1.0
# a request is answered from what was the newest at most so long ago; on a busy machine, where the next version takes
# long to open, at most so many times that long
_STALE_S, _STALE_TIMES, _MOST_STALE_S = 1.25, 5.0, 10.0
# catalogues are opened for a third of the time at most, metrics for a tenth
_PAUSES, _METRICS_PAUSES = 2.0, 9.0
_NEXT_S = 0.7
_METRICS_NEXT_S = 20.0  # unless somebody waits for them
_WANTED_S = 10.0
_FIRST_PAGES_S = 3.0
_NICER = 10
# imported by what answers when it is first needed
_MODULES = (
    "analytics.certificate.record", "analytics.curves.allan_curve", "analytics.evaluation.selection",
    "analytics.evaluation.table", "analytics.loop.model.model_use", "analytics.specifications.verdicts",
    "analytics.trends.document", "analytics.trends.trend", "anyio.streams.tls",
)  # fmt: skip


class Warming(Closing):
    """Threads that open the views of each version of lake and log, and its metrics if any page has used them lately.

    A request takes the version that is open, if that was the newest a moment ago, so that it does not wait for the
    next one. While a recorder is at work, and of a large lake, metrics of the version before are shown until those of
    the newest are there. `is_busy` says whether requests are being answered: metrics wait for the first of them.
    """

    def __init__(
        self, lake: SharedLake, live: FloorFollower, fresh: SharedCatalogue[FreshViews], is_busy: Callable[[], bool]
    ) -> None:
        self._lake, self._live, self._fresh, self._is_busy = lake, live, fresh, is_busy
        self._open: tuple[LakeState, float] | None = None  # and when it was seen to be the newest
        self._is_opening = False
        self._asked = threading.Event()  # for metrics
        self._changed_s = 0.0
        self._took_s = 0.0  # to open the version before
        self.tasks: list[Callable[[], object]] = []  # what else pages need, such as their templates
        self._ends = threading.Event()
        self._threads = [
            threading.Thread(target=target, daemon=True, name=name)
            for name, target in (("warming", self._watch), ("metrics", self._watch_metrics))
        ]

    def start(self) -> None:
        """Begin, with the metrics as well: whoever starts a server looks at it."""
        for each in self._threads:
            each.start()

    def opened(self) -> LakeState | None:
        """The version that a request is answered from at once; None if it has to wait for the newest."""
        opened = self._open
        if opened is None or opened[1] < max(time.monotonic() - self._stale_s(), self._changed_s):
            return None
        state, metrics = opened[0], self._metrics_of(opened[0])
        return state if metrics is state.metrics else replace(state, metrics=metrics)

    def _stale_s(self) -> float:
        """How old what is shown may be: who waits for the next version on a busy machine holds up others as well."""
        return min(max(_STALE_S, _STALE_TIMES * self._took_s), _MOST_STALE_S)

    def want_metrics(self) -> None:
        """Open the metrics of the newest version now: somebody waits for them."""
        self._lake.metrics.uses += 1
        self._asked.set()

    def has_metrics(self) -> bool:
        """Whether nothing is gained by waiting longer for metrics: they are open, or cannot be opened."""
        is_at_work = self._threads[1].is_alive() and (self._asked.is_set() or self._is_opening)
        return not is_at_work or self.newest().metrics is not None

    def changed(self) -> None:
        """Let nobody who asks from now on see what was before a change that has just been made here."""
        self._changed_s = time.monotonic()

    def newest(self) -> LakeState:
        """The newest version; StoreError if the manifest of the lake is damaged."""
        state, (documents, rows) = self._lake.state(), self._live.log_versions
        return replace(state, log_version=rows, log_documents=documents, metrics=self._metrics_of(state))

    def _metrics_of(self, state: LakeState) -> LakeState | None:
        """The version whose metrics are shown with one: its own, or those before it while they take long."""
        opened = self._lake.metrics.state
        if opened is None or opened.tag == state.tag:
            return opened
        # beside a recorder there is always something newer
        may_lag = state.samples >= LARGE_SAMPLES or writer_is_active(self._lake.store.folder)
        return opened if may_lag and opened.entered == state.entered else None

    def close(self) -> None:
        """End when the catalogue at work is open, or leave it to the end of the process."""
        self._ends.set()
        self._asked.set()
        for each in self._threads:
            if each.ident is not None:
                each.join(timeout=0.1)

    def _watch(self) -> None:
        uses, wanted_s = 0, time.monotonic()
        while not self._ends.is_set():
            began_s = time.monotonic()
            if self._fresh.uses != uses:
                uses, wanted_s = self._fresh.uses, began_s
            took_s = 0.0
            try:
                newest, opened = self.newest(), self._open
                if opened is not None and opened[0].has_all_of(newest):
                    self._open = opened[0], began_s
                elif opened is None or opened[0].tag != newest.tag or began_s - wanted_s < _WANTED_S:
                    with self._lake.views.lease(newest.lake):
                        pass
                    with self._fresh.lease(newest):
                        pass
                    uses += 1
                    self._open = newest, began_s
                    took_s = self._took_s = time.monotonic() - began_s
                self._lake.views.sweep()
                self._fresh.sweep()
            except (GyrofleetError, OSError):
                pass  # the next request reports it
            self._ends.wait(max(_LOOK_S if took_s == 0.0 else _NEXT_S - took_s, _PAUSES * took_s))

    def _watch_metrics(self) -> None:
        be_nicer(_NICER)  # planning hundreds of views takes a second of the processor
        self._live.wait()
        until_s = time.monotonic() + _FIRST_PAGES_S
        while self._is_busy() and time.monotonic() < until_s:
            self._ends.wait(_LOOK_S)
        _load_libraries()
        for task in self.tasks:
            task()
        metrics, uses, has_kernels = self._lake.metrics, -1, False
        while not self._ends.is_set():
            began_s, has_opened = time.monotonic(), False
            try:
                state, opened = self._lake.state(), metrics.state
                self._is_opening = True
                self._asked.clear()
                if (opened is None or not opened.has_all_of(state)) and metrics.uses > uses:
                    with metrics.lease(state):
                        pass
                    uses, has_opened = metrics.uses, True
                metrics.sweep()
            except (GyrofleetError, OSError):
                pass
            finally:
                self._is_opening = False
            if not has_kernels:
                has_kernels = True
                _load_kernels()
                # what is loaded stays: collections would look at all of it again and again
                gc.collect()
                gc.freeze()
            pause_s = _METRICS_PAUSES * (time.monotonic() - began_s)
            self._asked.wait(max(_METRICS_LOOK_S, pause_s, _METRICS_NEXT_S if has_opened else 0.0))


def _load_libraries() -> None:
    """Load what the first requests would wait for."""
    read_definitions()
    for name in _MODULES:
        importlib.import_module(name)


def _load_kernels() -> None:
    """Compile what computes an Allan deviation, or load it: on a new machine the first curve would take seconds."""
    from stream.estimators.allan_variance import AllanDeviation
    from stream.estimators.full_overlap.deviation_forms import Deviation
    from stream.estimators.full_overlap.full_overlap import FullOverlap

    counts = np.arange(1000, dtype=np.int32) % 7
    batch = SampleBatch("warm", "rate", "warm", UUID(int=1), 0, 0, 10**7, "deg/s", counts=counts)
    with FullOverlap() as curve:
        curve.update(batch)
        curve.evaluate(Deviation.OVERLAPPING_ALLAN, 1, None)
    strided = AllanDeviation()
    strided.update(batch)
    strided.estimate()
