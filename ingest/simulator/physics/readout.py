"""From a rate to the counts that leave the gyro: saturation, resolution, dropouts, stuck values, start-up."""

import math
from collections.abc import Iterator
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from numba import njit

from ingest.simulator.physics.arrivals import Stretch, StretchMask, random_stretches
from ingest.simulator.physics.scale import NotNegative, Positive
from ingest.simulator.physics.seeds import Seeds
from stream.batch import BoolArray, CountArray, FloatArray

_INT32 = np.iinfo(np.int32)


class Fault(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Stretches of samples in which something is wrong.

    Parameters
    ----------
    probability: That a stretch begins at a sample, 0 to 1.
    mean_samples: Mean of its length, at least 1.

    Notes
    -----
    A loose contact or a busy controller loses a message or repeats an old one, now and then for a while. Gaps and
    lengths are geometric: P(gap = k) = p (1 - p)^k, P(length = k) = (1/m)(1 - 1/m)^(k - 1).
    """

    probability: Annotated[float, msgspec.Meta(ge=0, le=1)]
    mean_samples: Annotated[float, msgspec.Meta(ge=1)] = 1.0


class StartUp(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The first seconds after power-on.

    Parameters
    ----------
    invalid_s: How long the output is a fixed word.
    invalid_counts: That word.
    transient_deg_per_s, time_constant_s: Rate that is put out in error when the output begins, and the time constant of
        its decay.

    Notes
    -----
    The loop closes only once the source has come up, and then finds its working point from a wrong one.
    counts = word for t < t_0, then Omega_out + A exp(-(t - t_0)/tau).
    """

    invalid_s: NotNegative = 0.0
    invalid_counts: Annotated[int, msgspec.Meta(ge=int(_INT32.min), le=int(_INT32.max))] = 0
    transient_deg_per_s: float = 0.0
    time_constant_s: Positive = 1.0


class Readout(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What becomes of the rate at the output.

    Parameters
    ----------
    saturation_deg_per_s: Rate at which the output stops, to both sides; in any case it stops at the ends of int32.
    resolution_counts: Counts are multiples of this.
    carries_rest: Whether what rounding leaves is added to the next sample, as a counter of angle does.
    dropout, stuck: Samples that never arrive, and samples that repeat the one before.

    Notes
    -----
    The detector or the feedback ends somewhere, and a converter gives whole counts. counts =
    r round(K clip(Omega_out)/r); with the rest carried, the sum of the counts follows the angle to half a step.
    """

    saturation_deg_per_s: Positive | None = None
    resolution_counts: Annotated[int, msgspec.Meta(ge=1)] = 1
    carries_rest: bool = False
    dropout: Fault | None = None
    stuck: Fault | None = None


class Samples(NamedTuple):
    """Consecutive samples: number of the first, counts, which of them arrive, and which are past the start-up."""

    first: int
    counts: CountArray
    present: BoolArray
    ready: BoolArray


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _repeat(stuck: BoolArray, last: int, out: CountArray) -> int:
    for i in range(out.shape[0]):
        if stuck[i]:
            out[i] = last
        last = out[i]
    return last


@njit(cache=True, nogil=True)
def _add_transient(t_s: FloatArray, begin_s: float, size: float, time_constant_s: float, out: FloatArray) -> None:
    for i in range(t_s.shape[0]):
        if t_s[i] >= begin_s:
            out[i] += size * math.exp(-(t_s[i] - begin_s) / time_constant_s)


class ReadoutEffect:
    """Readout of one power-on.

    Parameters
    ----------
    readout: What is planted.
    start_up: The first seconds.
    counts_per_deg_per_s: Nominal scale factor.
    seeds: Of the power-on.
    """

    def __init__(self, readout: Readout, start_up: StartUp | None, counts_per_deg_per_s: float, seeds: Seeds) -> None:
        self._readout, self._start_up, self._seeds = readout, start_up, seeds
        self._counts_per_rate = counts_per_deg_per_s
        # beyond the ends of int32 anyway, so that a product with an infinite limit is not needed
        limit = 2.0**32 / counts_per_deg_per_s
        self._limit = min(limit, readout.saturation_deg_per_s or limit)
        self._rest = 0.0
        self._last = 0
        self._dropouts = StretchMask(self.dropouts())
        self._stuck = StretchMask(self.stuck())

    def dropouts(self) -> Iterator[Stretch]:
        """Stretches of samples that never arrive, from the first on."""
        return _stretches(self._readout.dropout, self._seeds.of_power_on("dropout"))

    def stuck(self) -> Iterator[Stretch]:
        """Stretches of samples that repeat the one before, from the first on."""
        return _stretches(self._readout.stuck, self._seeds.of_power_on("stuck"))

    def read(self, first: int, rate_deg_per_s: FloatArray, elapsed_s: FloatArray) -> Samples:
        """Samples of the next rates at the output; adds the transient to `rate_deg_per_s` in place."""
        p, start_up = self._readout, self._start_up
        n = len(rate_deg_per_s)
        counts = np.empty(n, np.int32)
        if start_up is not None and start_up.transient_deg_per_s != 0.0:
            size, time_constant_s = start_up.transient_deg_per_s, start_up.time_constant_s
            _add_transient(elapsed_s, start_up.invalid_s, size, time_constant_s, rate_deg_per_s)
        self._rest = _to_counts(
            rate_deg_per_s,
            self._counts_per_rate,
            self._limit,
            float(p.resolution_counts),
            p.carries_rest,
            self._rest,
            counts,
        )
        ready = np.ones(n, np.bool_)
        if start_up is not None and start_up.invalid_s > 0.0:
            ready = elapsed_s >= start_up.invalid_s
            counts[~ready] = start_up.invalid_counts
        if p.stuck is not None:
            self._last = _repeat(self._stuck.take(first, n), self._last, counts)
        return Samples(first, counts, ~self._dropouts.take(first, n), ready)


def _stretches(fault: Fault | None, generator: np.random.Generator) -> Iterator[Stretch]:
    if fault is None:
        return iter(())
    return random_stretches(fault.probability, fault.mean_samples, generator)
