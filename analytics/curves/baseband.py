"""Lines of a record brought to frequency 0: block by block, to follow their amplitudes and phases."""

import numpy as np
import numpy.typing as npt

from stream.batch import FloatArray, IntArray

ComplexArray = npt.NDArray[np.complex128]
_FINER = 8
_ROUNDS = 6


class Baseband:
    """Means of x exp(-2 pi i f t) under the Hann window over blocks of `size` slots, half overlapping, for frequencies.

    Frequencies are in cycles a slot; t is 0 on slot 0. A sinusoid a cos(2 pi f t + phi) gives a/2 exp(i phi), noise of
    the one-sided density S the variance S 3/(4 size dt). Blocks with a missing sample are left out.

    >>> base = Baseband([0.1], 64)
    >>> base.take(0, 3.0 * np.cos(2.0 * np.pi * 0.1 * np.arange(640) + 0.5))
    >>> starts, means = base.blocks()
    >>> len(starts), bool(np.allclose(means, 1.5 * np.exp(0.5j), atol=1e-3))
    (19, True)
    """

    def __init__(self, frequencies: list[float], size: int) -> None:
        self.frequencies, self.size = np.array(frequencies), size
        self._half = size // 2
        turns = np.exp(-2j * np.pi * np.outer(np.arange(self._half), self.frequencies))
        wave = 2.0 * np.cos(2.0 * np.pi * np.arange(self._half) / size)
        self._table = np.concatenate([turns, wave[:, np.newaxis] * turns], axis=1)
        self._begun = -1
        self._buffer = np.full(self._half, np.nan)
        self._places: list[IntArray] = []
        self._sums: list[ComplexArray] = []

    def take(self, first_slot: int, values: FloatArray) -> None:
        """Take in values on the slots from `first_slot` on; NaN is missing."""
        if not len(values):
            return
        half = self._half
        first, begin = divmod(first_slot, half)
        rows = -(-(begin + len(values)) // half)
        padded = np.full(rows * half, np.nan)
        padded[begin : begin + len(values)] = values
        if self._begun == first:
            padded[:begin] = self._buffer[:begin]
        table = padded.reshape(rows, half)
        whole = np.flatnonzero(np.isfinite(table).all(axis=1))
        self._begun, self._buffer = first + rows - 1, table[-1].copy()
        if len(whole):
            places = first + whole
            phase = np.exp(-2j * np.pi * np.outer(places * half, self.frequencies))
            self._places.append(places)
            self._sums.append((table[whole] @ self._table) * np.tile(phase, 2))

    def blocks(self) -> tuple[IntArray, ComplexArray]:
        """Numbers of the blocks, block j beginning on slot j size/2, and the means: a row a block, a column a line."""
        lines = len(self.frequencies)
        if not self._places:
            return np.zeros(0, np.int64), np.zeros((0, lines), np.complex128)
        places, sums = np.concatenate(self._places), np.concatenate(self._sums)
        left = np.flatnonzero(np.diff(places) == 1)
        straight = sums[left, :lines] + sums[left + 1, :lines]
        turned = sums[left, lines:] - sums[left + 1, lines:]
        return places[left], (0.5 * straight - 0.25 * turned) / self._half

    def response(self, offsets: FloatArray) -> ComplexArray:
        """What a unit phasor gives so many cycles a slot beside a frequency, in a block that begins on slot 0.

        Exact for samples, so that images beyond the Nyquist frequency are those that there are.
        """
        size = self.size

        def mean(turn: FloatArray) -> ComplexArray:
            turn = turn - np.round(turn)
            down = np.sin(np.pi * turn)
            near = np.abs(down) < 1e-12
            ratio = np.where(near, size, np.sin(np.pi * size * turn) / np.where(near, 1.0, down))
            return np.asarray(np.exp(1j * np.pi * turn * (size - 1)) * ratio / size, np.complex128)

        sides = mean(offsets + 1.0 / size) + mean(offsets - 1.0 / size)
        return np.asarray(mean(offsets) - 0.5 * sides, np.complex128)


def phasor(places: IntArray, means: ComplexArray, reach: float) -> tuple[complex, float]:
    """The steady phasor c exp(2 pi i d j) of least squares through means of blocks j: c, and d (cycles a block).

    d is at most `reach`; found on a fine grid, then by parabolas.
    """
    span = int(places[-1] - places[0]) + 1
    size = 1 << (_FINER * span - 1).bit_length()
    dense = np.zeros(span, np.complex128)
    dense[places - places[0]] = means
    power = np.abs(np.fft.fft(dense, size))
    turns = np.fft.fftfreq(size)
    power[np.abs(turns) > reach] = -1.0
    best, step = float(turns[power.argmax()]), 1.0 / size
    for _ in range(_ROUNDS):
        tried = best + step * np.array([-1.0, 0.0, 1.0])
        left, middle, right = np.abs(means @ np.exp(-2j * np.pi * np.outer(places - places[0], tried))) ** 2
        bend = left - 2.0 * middle + right
        best += 0.0 if bend >= 0.0 else step * float(np.clip(0.5 * (left - right) / bend, -1.0, 1.0))
        step *= 0.3
    return complex((means * np.exp(-2j * np.pi * best * places)).mean()), best
