"""Times of the frames of a message with counter and interval: on an exact grid, beside the times of reception."""

from dataclasses import dataclass, field

import numpy as np

from ingest.can.forward_times import JITTER_NS
from ingest.seen_interval import APART_NS, IntervalWatch, SeenInterval, after
from stream.batch import IntArray

_EARLY_NS = 5_000_000  # a frame that came so long before its place shows that the grid is late


@dataclass
class GridTimes:
    """Places numbered frames at whole intervals after the first.

    On a bus (`is_live`) the grid begins with the earliest frame of the first block; frames that come 5 ms or more
    before their places move it, as none is sampled after it was received. If the frames certainly come at another
    interval (`seen`, looked for where `is_watched`), those of a bus have the times of reception from then on.

    >>> grid = GridTimes(10_000_000, 256, is_live=True)
    >>> grid.place(np.array([83_000_000, 83_000_001, 83_000_002]), np.array([0, 1, 2]), np.array([0, 1, 2])).tolist()
    [63000002, 73000002, 83000002]
    >>> grid.place(np.array([86_500_000, 90_000_000]), np.array([3, 4]), np.array([3, 4])).tolist()
    [84000002, 90000000]
    """

    interval_ns: int
    modulus: int
    is_live: bool = False
    is_watched: bool = False
    seen: SeenInterval | None = None
    off_grid_s: float = 0.0  # largest distance of a reception from its place
    set_back: int = 0  # places where the receiving clock went back
    set_back_s: float = 0.0  # by how much at most
    _anchor_ns: int | None = None
    _last: tuple[int, int, int] | None = None  # received, sampled, number
    _counted: int = 0
    _counter: int | None = None
    _watch: IntervalWatch = field(init=False)

    def __post_init__(self) -> None:
        """Begin to watch."""
        self._watch = IntervalWatch(self.interval_ns)

    def begin(self, received_ns: int) -> None:
        """The first frame of all was received then."""
        if self._anchor_ns is None:
            self._anchor_ns = received_ns

    @property
    def is_wrong(self) -> bool:
        """Whether the stated interval is wrong."""
        return self.seen is not None and self.seen.is_wrong

    def restart(self) -> None:
        """The counter has begun again."""
        self._watch.restart()

    def place(self, received_ns: IntArray, numbers: IntArray, counters: IntArray) -> IntArray:
        """Times of new frames; their order of number is that of their times."""
        if not len(received_ns):
            return received_ns
        if self.is_watched:
            self._see(received_ns, counters)
        if self.is_live and self.is_wrong:
            return self._received(received_ns)
        if self._anchor_ns is None or (self.is_live and self._last is None):
            self._anchor_ns = int((received_ns - numbers * self.interval_ns).min())
        times_ns = self._anchor_ns + numbers * self.interval_ns
        if self.is_live and self._last is not None and int((times_ns - received_ns).max()) > _EARLY_NS:
            self._anchor_ns = int((received_ns - numbers * self.interval_ns).min())
            times_ns = self._anchor_ns + numbers * self.interval_ns
        if self.is_live and self._last is not None:
            times_ns = after(times_ns, numbers - self._last[2], self._last[1], self.interval_ns)
        self._account(received_ns, times_ns)
        self._last = int(received_ns[-1]), int(times_ns[-1]), int(numbers[-1])
        return times_ns

    def _received(self, received_ns: IntArray) -> IntArray:
        """Times of reception, a nanosecond apart until they have passed those of the grid."""
        last_ns = int(received_ns[0]) - 1 if self._last is None else self._last[1]
        index = np.arange(len(received_ns))
        times_ns = np.maximum(np.maximum.accumulate(received_ns - index), last_ns + 1) + index
        self._last = int(received_ns[-1]), int(times_ns[-1]), 0
        return np.asarray(times_ns)

    def _see(self, received_ns: IntArray, counters: IntArray) -> None:
        first = counters[0] if self._counter is None else self._counter
        counted = self._counted + np.cumsum(np.diff(counters, prepend=np.int64(first)) % self.modulus)
        self._counted, self._counter = int(counted[-1]), int(counters[-1])
        _, rows = np.unique(received_ns // APART_NS, return_index=True)
        for row in rows.tolist():
            seen = self._watch.see(int(counted[row]), int(received_ns[row]))
            if seen is not None and (self.seen is None or seen.uncertainty_ns < self.seen.uncertainty_ns):
                self.seen = seen

    def _account(self, received_ns: IntArray, sampled_ns: IntArray) -> None:
        """How far receptions are from the grid, and where the clock that stamps them was set back."""
        self.off_grid_s = max(self.off_grid_s, int(np.abs(received_ns - sampled_ns).max()) / 1e9)
        last = (received_ns[0], sampled_ns[0]) if self._last is None else self._last[:2]
        received, sampled = (
            np.diff(each, prepend=end) for each, end in zip((received_ns, sampled_ns), last, strict=True)
        )
        is_back = received < -JITTER_NS
        if is_back.any():
            self.set_back += int(np.count_nonzero(is_back))
            self.set_back_s = max(self.set_back_s, int((sampled - received)[is_back].max()) / 1e9)
