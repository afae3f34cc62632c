"""Loops over arrays of block sums, the parts of `pyramid_kernel`.

The compiled kernel is kept on disk as long as its own file stays as it is: after a change here, touch that one.
"""

from stream.batch import FloatArray, IntArray
from stream.compiled import kernel_part

SUM, COUNT = 0, 1


@kernel_part("reassoc")
def subtract(values: FloatArray, reference: float, out: FloatArray) -> bool:
    """Write values - reference; whether all are finite (0 * NaN and 0 * inf are NaN)."""
    zero = 0.0
    for i in range(values.shape[0]):
        difference = values[i] - reference
        out[i] = difference
        zero += difference * 0.0
    return zero == 0.0


@kernel_part()
def mask(sums: FloatArray, counts: FloatArray) -> None:
    """Replace values that are not finite by empty blocks."""
    for i in range(sums.shape[0]):
        if sums[i] - sums[i] == 0.0:
            counts[i] = 1.0
        else:
            sums[i] = 0.0
            counts[i] = 0.0


@kernel_part()
def prefix_sums(line: FloatArray, out: FloatArray) -> None:
    """Prefix sums, out[0] = 0; groups of four, so that one addition in four waits for the one before."""
    total = 0.0
    out[0] = 0.0
    whole = line.shape[0] - line.shape[0] % 4
    for i in range(0, whole, 4):
        two = line[i] + line[i + 1]
        out[i + 1] = total + line[i]
        out[i + 2] = total + two
        out[i + 3] = total + (two + line[i + 2])
        total += two + (line[i + 2] + line[i + 3])
        out[i + 4] = total
    for i in range(whole, line.shape[0]):
        total += line[i]
        out[i + 1] = total


@kernel_part("reassoc", "contract")
def sum_of_squares(late: FloatArray, middle: FloatArray, early: FloatArray) -> float:
    """Sum of the squared differences of adjacent windows, from three stretches of the prefix sums."""
    total = 0.0
    for i in range(late.shape[0]):
        difference = (late[i] + early[i]) - 2.0 * middle[i]
        total += difference * difference
    return total


@kernel_part("reassoc", "contract")
def sums_of_squares(
    p0: FloatArray, p1: FloatArray, p2: FloatArray, p4: FloatArray, p8: FloatArray, p16: FloatArray, p32: FloatArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """Add those of the lags 1, 2, 4, 8 and 16 at once; p_n is the prefix n blocks before p0."""
    by_1 = by_2 = by_4 = by_8 = by_16 = 0.0
    for i in range(p0.shape[0]):
        last = p0[i]
        difference = (last + p2[i]) - 2.0 * p1[i]
        by_1 += difference * difference
        difference = (last + p4[i]) - 2.0 * p2[i]
        by_2 += difference * difference
        difference = (last + p8[i]) - 2.0 * p4[i]
        by_4 += difference * difference
        difference = (last + p16[i]) - 2.0 * p8[i]
        by_8 += difference * difference
        difference = (last + p32[i]) - 2.0 * p16[i]
        by_16 += difference * difference
    out[0] += by_1
    out[1] += by_2
    out[2] += by_4
    out[3] += by_8
    out[4] += by_16


@kernel_part()
def add_pairs(line: FloatArray, out: FloatArray, pairs: int) -> None:
    """Write the sums of neighbours."""
    for i in range(pairs):
        out[i] = line[2 * i] + line[2 * i + 1]


@kernel_part()
def sum_of_squares_with_gaps(
    sums: FloatArray, counts: FloatArray, lag: int, first: int, stop: int, needed: float, slots: float
) -> tuple[float, int]:
    """Differences of window means, times the slots of a window, where both windows hold enough samples."""
    total = 0.0
    windows = 0
    for i in range(first, stop):
        late = counts[i] - counts[i - lag]
        early = counts[i - lag] - counts[i - 2 * lag]
        if late >= needed and early >= needed:
            difference = (sums[i] - sums[i - lag]) / late - (sums[i - lag] - sums[i - 2 * lag]) / early
            difference *= slots
            total += difference * difference
            windows += 1
    return total, windows


@kernel_part()
def are_full(counts: FloatArray, number: int, width: float) -> bool:
    """Whether each of the first `number` counts is `width`."""
    others = 0
    for i in range(number):
        others += counts[i] != width
    return others == 0


@kernel_part()
def accumulate(
    squares: FloatArray, windows: IntArray, lags: IntArray, prefix: FloatArray, after: int, length: int, until: int,
    full: bool, share: float, width: float,
) -> None:  # fmt: skip
    """Add the windows of a level that end after the first `after` of `length` blocks and begin before `until`."""
    sums = prefix[SUM]
    for j in range(lags.shape[0]):
        lag = lags[j]
        first = max(after + 1, 2 * lag)
        stop = min(length + 1, until + 2 * lag)
        if lag == 0 or first >= stop:
            continue
        if full:
            squares[j] += sum_of_squares(
                sums[first:stop], sums[first - lag : stop - lag], sums[first - 2 * lag : stop - 2 * lag]
            )
            windows[j] += stop - first
        else:
            slots = lag * width
            total, found = sum_of_squares_with_gaps(sums, prefix[COUNT], lag, first, stop, share * slots, slots)
            squares[j] += total
            windows[j] += found


@kernel_part()
def copy(source: FloatArray, start: int, number: int, line: FloatArray, at: int) -> None:
    """Copy sums and counts of some blocks."""
    for which in range(2):
        for i in range(number):
            line[which, at + i] = source[which, start + i]
