"""Residual watch: a CUSUM on the log-likelihood of each model in use against the model that it replaced."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple
from uuid import UUID, uuid5

import numpy as np

from analytics.loop.blocks.block_reducer import BlockReducer
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.model.model_registry import ModelRegistry, ModelVersion
from analytics.loop.model.model_use import (
    InUse,
    Stage,
    enter_activations,
    logged_documents,
    rollback_documents,
    uses_of,
)
from analytics.loop.tracing.whitening.whitener import whitened_residual
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import FloatArray
from stream.errors import GyrofleetError
from stream.events import AnyDocument, ModelActivated, ResidualWatched
from stream.security.actor import Actor

THRESHOLD = math.log(200.0)  # loss of log-likelihood beyond which a model is refused: odds of 200 to 1 against it
STRETCH_S = 6 * 3600.0  # length of the stretches into which long runs are divided, seconds

_BY = Actor("residual watch", identity="")
_FEWEST_BLOCKS = 8


class WatchedStretch(NamedTuple):
    """A stretch of a run, its end, its number of blocks, and the gain in log-likelihood over the previous model."""

    number: int
    end_ns: int
    blocks: int
    gain: float


def gains(version: ModelVersion, run: RunBlocks) -> FloatArray:
    """Whitened log-likelihood of each block with the version, less that with the previous model; NaN without a channel.

    Both are evaluated with the noise of the version, which includes turn-on scatter. BadInput if the run lacks a
    channel, or is in another unit of measure.
    """
    known = np.isfinite(version.model.predict(run)) & np.isfinite(version.before.predict(run))
    both = replace(run, value=np.where(known, run.value, np.nan))
    new, old = (
        whitened_residual(model, both, version.noise, longest_s=version.longest_s)
        for model in (version.model, version.before)
    )
    return np.asarray(0.5 * (old**2 - new**2))


def stretches(version: ModelVersion, run: RunBlocks, *, is_ended: bool) -> list[WatchedStretch]:
    """The stretches of a run; of a running run, the complete ones."""
    gain = gains(version, run)
    number = (run.slot * run.block_s // STRETCH_S).astype(np.int64)
    last = int(number[-1])
    found = []
    for each in range(int(number[0]), last + 1 if is_ended else last):
        is_in = (number == each) & np.isfinite(gain)
        count = int(np.count_nonzero(is_in))
        if count >= _FEWEST_BLOCKS:
            end_ns = run.t0_ns + round((int(run.slot[is_in][-1]) + 1) * run.block_s * 1e9)
            found.append(WatchedStretch(each, end_ns, count, float(gain[is_in].sum())))
    return found


def cusum(before: float, gain: float) -> float:
    """Accumulated loss of a model after one more stretch; not below 0."""
    return max(0.0, before - gain)


def watch_store(store: Store) -> list[AnyDocument]:
    """Judge every model in use by the runs recorded since; roll back a live model that is refused or unreadable.

    Returns the documents that were written to the store's log. A repeated call writes nothing twice.
    """
    logged = logged_documents(store, (ModelActivated, ResidualWatched))
    uses = uses_of(logged)
    if not any(use.activations for use in uses.values()):
        return []
    registry = ModelRegistry(store)
    documents: list[AnyDocument] = []
    with Catalog(store) as catalog:
        for use in uses.values():
            for activated in use.activations:
                try:
                    version = registry.by_hash(activated.unit, activated.model)
                except GyrofleetError as error:  # an unreadable model cannot be used
                    documents += rollback_documents(registry, use, Stage(activated.stage), reason=str(error), by=_BY)
                    continue
                history = [
                    each for each in logged if isinstance(each, ResidualWatched) and each.activation == activated.uid
                ]
                fresh = list(_ModelWatch(catalog, version, activated, history).documents())
                documents += fresh
                if fresh and fresh[-1].is_refused and activated.stage == Stage.LIVE:
                    documents += _rolled_back(registry, use, fresh[-1])
    if documents:
        enter_activations(store, documents)
    return documents


def _rolled_back(registry: ModelRegistry, use: InUse, why: ResidualWatched) -> Sequence[AnyDocument]:
    reason = (
        f"the residual watch refuses it: up to {why.stretch} it predicts the record worse than the previous model, by "
        f"{why.cusum:.1f} in log-likelihood (limit {why.threshold:.1f}); diagnose the unit again"
    )
    return rollback_documents(registry, use, Stage.LIVE, reason=reason, by=_BY)


class _Recorded(NamedTuple):
    run: str
    is_ended: bool
    span_s: float
    last_ns: int


class _ModelWatch:
    def __init__(
        self, catalog: Catalog, version: ModelVersion, activated: ModelActivated, history: Sequence[ResidualWatched]
    ) -> None:
        self._catalog = catalog
        self._version = version
        self._activated = activated
        self._history = history
        self._cusum = history[-1].cusum if history else 0.0

    def documents(self) -> Iterator[ResidualWatched]:
        """The new documents, up to the one that refuses a live version."""
        for document in itertools.chain.from_iterable(map(self._judged, self._fresh())):
            yield document
            if document.is_refused and self._activated.stage == Stage.LIVE:
                return

    def _fresh(self) -> Iterator[_Recorded]:
        """Runs recorded since the activation that are not fully judged."""
        rows = self._catalog.rows(
            """
            select s.run, r.run is not null, (s.t_last_ns - s.t_first_ns) / 1e9, s.t_last_ns
            from signals s left join (select distinct run from events where kind = 'RunEnded') r using (run)
            where s.unit = $unit and s.signal = $signal and s.arrival_first_ns > $since order by s.t_first_ns
            """,
            {"unit": self._version.unit, "signal": self._version.signal, "since": self._activated.t_ns},
        )
        for run, is_ended, span_s, last_ns in rows:
            of_run = [each for each in self._history if each.run == run]
            is_judged = any(each.t_ns >= last_ns - 2e9 * self._version.block_s for each in of_run)
            waits = not is_ended and len(of_run) >= span_s // STRETCH_S
            if run not in self._version.runs and not is_judged and not waits:
                yield _Recorded(str(run), bool(is_ended), float(span_s), int(last_ns))

    def _judged(self, recorded: _Recorded) -> Iterator[ResidualWatched]:
        version = self._version
        known = {each.stretch for each in self._history}
        try:
            reducer = BlockReducer(self._catalog, version.signal, block_s=version.block_s, runs=[recorded.run])
            parts = reducer.reduce(version.unit).runs
            if not recorded.is_ended and len(parts) > 1:
                return  # which power-on is still running is known at the end
            found = [
                (f"{part.run.removesuffix('#1')} from {each.number * STRETCH_S / 3600:g} h", each)
                for part in parts
                for each in stretches(version, part, is_ended=recorded.is_ended)
            ]
        except GyrofleetError as error:
            if recorded.is_ended:
                yield self._document(recorded.run, recorded.run, None, recorded.last_ns, 0, str(error))
            return
        fresh = [(name, each) for name, each in found if name not in known]
        for at, (name, each) in enumerate(fresh):
            self._cusum = cusum(self._cusum, each.gain)
            is_last = recorded.is_ended and at == len(fresh) - 1
            end_ns = max(each.end_ns, recorded.last_ns) if is_last else each.end_ns
            yield self._document(recorded.run, name, each.gain, end_ns, each.blocks, None)
        if recorded.is_ended and not found:
            reason = f"fewer than {_FEWEST_BLOCKS} blocks of {version.block_s:g} s with all channels"
            yield self._document(recorded.run, recorded.run, None, recorded.last_ns, 0, reason)

    def _document(
        self, run: str, stretch: str, gain: float | None, t_ns: int, blocks: int, reason: str | None
    ) -> ResidualWatched:
        return ResidualWatched(
            run=run,
            t_ns=t_ns,
            uid=uuid5(UUID(self._activated.uid), stretch).hex,
            unit=self._version.unit,
            signal=self._version.signal,
            model=self._activated.model,
            version=self._version.version,
            activation=self._activated.uid,
            stretch=stretch,
            blocks=blocks,
            gain=gain,
            cusum=self._cusum,
            threshold=THRESHOLD,
            is_refused=gain is not None and self._cusum > THRESHOLD,
            reason=reason,
        )
