"""The last samples of a signal: limits on a record may come after the first samples of that record."""

from collections import deque
from collections.abc import Iterable, Iterator

from stream.batch import SampleBatch
from stream.errors import EstimatorError, WireError
from stream.wire.batches import decode_batch, encode_batch

# documents are behind samples by what a recorder takes to pass them on: 4 s at 1 kHz, 20 s at 200 Hz
_KEPT = 4096


class RecentSamples:
    """The batches that have the last `kept` samples, and no samples before those.

    >>> from uuid import UUID
    >>> import numpy as np
    >>> recent = RecentSamples(kept=100)
    >>> for seq in (0, 70, 140):
    ...     recent.add(SampleBatch("U", "rate", "r", UUID(int=1), seq, seq * 10, 10, "deg/s", values=np.zeros(70)))
    >>> [(batch.seq, len(batch)) for batch in recent.since(900)]
    [(110, 30), (140, 70)]
    >>> [(batch.seq, len(batch)) for batch in recent.since(1500)]
    [(140, 70)]
    """

    def __init__(self, *, kept: int = _KEPT) -> None:
        self._kept = kept
        self._batches: deque[SampleBatch] = deque()
        self._samples = 0

    def add(self, batch: SampleBatch) -> None:
        """Take in the next batch of the signal."""
        n = len(batch)
        # a part, since a whole batch would keep the times and values that estimators have derived from it
        self._batches.append(batch.part(max(0, n - self._kept), n))
        self._samples += min(n, self._kept)
        while (excess := self._samples - self._kept) > 0:
            first = self._batches.popleft()
            if excess < len(first):
                self._batches.appendleft(first.part(excess, len(first)))
            self._samples -= min(excess, len(first))

    def since(self, t_ns: int) -> Iterator[SampleBatch]:
        """Batches with samples at or after a time; they may have some before it as well."""
        return (batch for batch in tuple(self._batches) if batch.last_ns >= t_ns)

    def export_state(self) -> list[bytes]:
        """The state, in plain values."""
        return [encode_batch(batch) for batch in self._batches]

    def import_state(self, state: Iterable[bytes]) -> None:
        """Go on from the state of another one; an EstimatorError if it cannot be read."""
        try:
            for payload in state:
                self.add(decode_batch(payload))
        except WireError as error:
            raise EstimatorError(f"samples in a checkpoint cannot be read: {error}") from error
