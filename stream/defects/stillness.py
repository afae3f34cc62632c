"""The longest stretch of a signal in which all samples are alike: a frozen output, or a coarse resolution."""

from collections.abc import Iterable, Iterator

import numpy as np

from stream.batch import FloatArray, SampleBatch

LEAST_SHARE = 0.05  # of the samples, as in the step records
LEAST_SAMPLES = 10


class Stillness:
    """Follows a signal and finds its longest stretch in which all samples are alike.

    `longest` is its number of samples, `samples` that of the signal. A missing sample does not end a stretch.

    >>> found = Stillness()
    >>> for piece in ([1.0, 2.0, 2.0], [2.0, np.nan, 2.0, 3.0]):
    ...     found.follow(np.array(piece))
    >>> found.longest
    4
    """

    def __init__(self) -> None:
        self.longest = self.samples = 0
        self._last, self._length = np.nan, 0

    def follow(self, values: FloatArray) -> None:
        """Take in the next samples."""
        is_finite = np.isfinite(values)
        finite = values if is_finite.all() else values[is_finite]
        if not finite.size:
            return
        self.samples += finite.size
        moves = finite[1:] != finite[:-1]
        carried = self._length if finite[0] == self._last else 0
        if moves.all():  # as of most signals
            lengths = np.ones(min(finite.size, 2), np.int64)
        else:
            lengths = np.diff(np.flatnonzero(moves) + 1, prepend=0, append=finite.size)
        lengths[0] += carried
        self.longest = max(self.longest, int(lengths.max()))
        self._last, self._length = float(finite[-1]), int(lengths[-1])

    def export_state(self) -> list[float]:
        """The state, in plain values."""
        return [self.longest, self.samples, self._length, self._last if self._length else 0.0]

    def import_state(self, state: list[float]) -> None:
        """Take over a state."""
        self.longest, self.samples, self._length = (int(each) for each in state[:3])
        self._last = state[3] if self._length else np.nan

    def watched(self, batches: Iterable[SampleBatch]) -> Iterator[SampleBatch]:
        """The batches, each taken in."""
        for batch in batches:
            self.follow(batch.value_array)
            yield batch


def is_still(longest: int, samples: int) -> bool:
    """Whether a stretch is so long that the noise of the record cannot be judged by its samples."""
    return longest >= max(LEAST_SAMPLES, LEAST_SHARE * samples)


def remark_on_stillness(longest: int, samples: int) -> tuple[str, str] | None:
    """What a reader must know of a stretch in which all samples are alike, in English and Chinese; None if it is short.

    >>> remark_on_stillness(9, 9), remark_on_stillness(49, 1000)
    (None, None)
    >>> remark_on_stillness(1000, 1000)[0]
    'all 1,000 samples are alike: the output is frozen, or its resolution too coarse to show noise'
    """
    if not is_still(longest, samples):
        return None
    if longest >= samples:
        return (
            f"all {samples:,} samples are alike: the output is frozen, or its resolution too coarse to show noise",
            f"全部 {samples:,} 个采样相同：输出冻结，或分辨率太粗而看不到噪声",
        )
    return (
        (
            f"{longest:,} of {samples:,} samples in a row are alike: the output was frozen, or its resolution is too "
            "coarse to show noise; what is computed of the whole record has this stretch in it"
        ),
        (
            f"{samples:,} 个采样中连续 {longest:,} 个相同：输出曾冻结，或分辨率太粗而看不到噪声；"
            "由整个记录算出的结果均含该段"
        ),
    )
