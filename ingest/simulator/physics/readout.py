"""Read-out, from a rate to counts: saturation, resolution, missing samples, stuck values, start-up."""

import math
from collections.abc import Iterator
from typing import Annotated, NamedTuple

import msgspec
import numpy as np

from ingest.simulator.physics.draws import NotNegative, Positive, RangeMask, SampleRange, Seeds, random_ranges
from stream.batch import BoolArray, CountArray, FloatArray
from stream.compiled import compiled

_INT32 = np.iinfo(np.int32)


class ReadoutFault(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Ranges of faulty samples.

    A loose contact or a busy controller loses messages or repeats old ones. Gaps and lengths are geometric:
    P(gap = k) = p (1 - p)^k, P(length = k) = (1/m)(1 - 1/m)^(k - 1).
    """

    probability: Annotated[float, msgspec.Meta(ge=0, le=1)]  # probability that a range begins at a sample
    mean_samples: Annotated[float, msgspec.Meta(ge=1)] = 1.0  # mean length


class StartUp(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The first seconds after power-on.

    The loop closes once the source has come up, and then settles to its working point.
    counts = word for t < t_0, then Omega_out + A exp(-(t - t_0)/tau).
    """

    invalid_s: NotNegative = 0.0  # time during which the output is a fixed word
    invalid_counts: Annotated[int, msgspec.Meta(ge=int(_INT32.min), le=int(_INT32.max))] = 0  # that word
    transient_deg_per_s: float = 0.0  # error of the rate when the output begins
    time_constant_s: Positive = 1.0  # of its decay


class Readout(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Conversion of the output rate to counts.

    counts = r round(K clip(Omega_out)/r); with the rest carried, the sum of the counts follows the angle to half a
    step.
    """

    saturation_deg_per_s: Positive | None = None  # largest rate in both directions; without it that of int32
    resolution_counts: Annotated[int, msgspec.Meta(ge=1)] = 1  # counts are multiples of this
    carries_rest: bool = False  # whether the rounding error is added to the next sample, as in an angle counter
    dropout: ReadoutFault | None = None  # samples that are missing
    stuck: ReadoutFault | None = None  # samples that repeat the one before


class Samples(NamedTuple):
    """Consecutive samples: number of the first, counts, which are not missing, and which are past the start-up."""

    first: int
    counts: CountArray
    present: BoolArray
    ready: BoolArray


@compiled
def _to_counts(
    rate: FloatArray, counts_per_rate: float, limit: float, step: float, carries: bool, rest: float, out: CountArray
) -> float:
    for i in range(rate.shape[0]):
        value = min(max(rate[i], -limit), limit) * counts_per_rate + rest
        count = np.rint(value / step) * step
        if carries:
            rest = value - count
        out[i] = np.int32(min(max(count, -2147483648.0), 2147483647.0))
    return rest


@compiled
def _repeat(stuck: BoolArray, last: int, out: CountArray) -> int:
    for i in range(out.shape[0]):
        if stuck[i]:
            out[i] = last
        last = out[i]
    return last


@compiled
def _add_transient(t_s: FloatArray, begin_s: float, size: float, time_constant_s: float, out: FloatArray) -> None:
    for i in range(t_s.shape[0]):
        if t_s[i] >= begin_s:
            out[i] += size * math.exp(-(t_s[i] - begin_s) / time_constant_s)


class ReadoutEffect:
    """Read-out of one power-on, with a nominal scale factor and the sample interval in nanoseconds."""

    def __init__(
        self, readout: Readout, start_up: StartUp | None, counts_per_deg_per_s: float, interval_ns: int, seeds: Seeds
    ) -> None:
        self._readout, self._start_up, self._seeds = readout, start_up, seeds
        self._counts_per_rate, self._interval_ns = counts_per_deg_per_s, interval_ns
        # beyond int32, so that the product is finite
        limit = 2.0**32 / counts_per_deg_per_s
        self._limit = min(limit, readout.saturation_deg_per_s or limit)
        self._rest = 0.0
        self._last = 0
        self._missing = RangeMask(self.dropouts())
        self._stuck = RangeMask(self.stuck())

    def dropouts(self) -> Iterator[SampleRange]:
        """Ranges of missing samples, from the first on."""
        return _ranges(self._readout.dropout, self._seeds.of_power_on("dropout"))

    def stuck(self) -> Iterator[SampleRange]:
        """Ranges of samples that repeat the one before, from the first on."""
        return _ranges(self._readout.stuck, self._seeds.of_power_on("stuck"))

    def read(self, first: int, rate_deg_per_s: FloatArray) -> Samples:
        """Samples of the next output rates; adds the transient to `rate_deg_per_s` in place."""
        p, start_up = self._readout, self._start_up
        n = len(rate_deg_per_s)
        counts, ready = np.empty(n, np.int32), np.ones(n, np.bool_)
        if start_up is not None:
            elapsed_s = np.asarray((first + np.arange(n, dtype=np.int64)) * self._interval_ns * 1e-9, np.float64)
            ready = elapsed_s >= start_up.invalid_s
            size, time_constant_s = start_up.transient_deg_per_s, start_up.time_constant_s
            _add_transient(elapsed_s, start_up.invalid_s, size, time_constant_s, rate_deg_per_s)
        step = float(p.resolution_counts)
        self._rest = _to_counts(
            rate_deg_per_s, self._counts_per_rate, self._limit, step, p.carries_rest, self._rest, counts
        )
        if start_up is not None:
            counts[~ready] = start_up.invalid_counts
        if p.stuck is not None:
            self._last = _repeat(self._stuck.take(first, n), self._last, counts)
        return Samples(first, counts, ~self._missing.take(first, n), ready)


def _ranges(fault: ReadoutFault | None, generator: np.random.Generator) -> Iterator[SampleRange]:
    return iter(()) if fault is None else random_ranges(fault.probability, fault.mean_samples, generator)
