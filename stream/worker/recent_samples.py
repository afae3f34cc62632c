"""The last samples of a signal: limits on a record may come after the first samples of that record."""

from collections import deque
from collections.abc import Iterable, Iterator
from functools import cached_property

from stream.batch import SampleBatch
from stream.errors import EstimatorError, WireError
from stream.wire.batches import decode_batch, encode_batch

# documents are behind samples by what a recorder takes to pass them on: 4 s at 1 kHz, 20 s at 200 Hz
_KEPT = 4096
_DERIVED = tuple(name for name, value in vars(SampleBatch).items() if isinstance(value, cached_property))


class RecentSamples:
    """The last `kept` samples, as batches.

    >>> from uuid import UUID
    >>> import numpy as np
    >>> recent = RecentSamples(kept=100)
    >>> for seq in (0, 70, 140):
    ...     recent.add(SampleBatch("U", "rate", "r", UUID(int=1), seq, seq * 10, 10, "deg/s", values=np.zeros(70)))
    >>> [(batch.seq, len(batch)) for batch in recent.since(900)]
    [(110, 30), (140, 70)]
    >>> [(batch.seq, len(batch)) for batch in recent.since(1500)]
    [(140, 70)]
    >>> recent.unseen_s(900)  # of 210 samples every 10 ns, the first 110 were let go
    2e-07
    """

    def __init__(self, *, kept: int = _KEPT) -> None:
        self._kept = kept
        self._batches: deque[SampleBatch] = deque()
        self._samples = 0

    def add(self, batch: SampleBatch) -> None:
        """Take in the next batch; what was derived from it, its times and values, is let go."""
        for name in _DERIVED:
            vars(batch).pop(name, None)
        self._batches.append(batch)
        self._samples += len(batch)
        while self._samples - len(self._batches[0]) >= self._kept:
            self._samples -= len(self._batches.popleft())

    def since(self, t_ns: int) -> Iterator[SampleBatch]:
        """Batches with samples at or after a time; they may have some before it as well."""
        return (batch for batch in self._last() if batch.last_ns >= t_ns)

    def unseen_s(self, since_ns: int) -> float:
        """How long it took after a time until the first sample that is kept; 0 where none was let go."""
        if self._samples < self._kept:
            return 0.0
        return max(0, self._last()[0].t0_ns - since_ns) / 1e9

    def _last(self) -> list[SampleBatch]:
        if (excess := self._samples - self._kept) <= 0:
            return list(self._batches)
        first, *others = self._batches
        return [first.part(excess, len(first)), *others]

    def export_state(self) -> list[bytes]:
        """The state, in plain values."""
        return [encode_batch(batch) for batch in self._last()]

    def import_state(self, state: Iterable[bytes]) -> None:
        """Go on from the state of another one; an EstimatorError if it cannot be read."""
        try:
            for payload in state:
                self.add(decode_batch(payload))
        except WireError as error:
            raise EstimatorError(f"samples in a checkpoint cannot be read: {error}") from error
