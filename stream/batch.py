"""A batch of consecutive samples of one signal: the unit of transport, storage and estimation."""

from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite, nan
from typing import Any, TypeVar
from uuid import UUID

import numpy as np
import numpy.typing as npt

from stream.bounds import MAX_INTERVAL_NS, MAX_MOMENT_NS, MAX_NAME_CHARS, MAX_SEQ, MIN_MOMENT_NS
from stream.errors import BadInput

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]
CountArray = npt.NDArray[np.int32]
FlagArray = npt.NDArray[np.uint8]
BoolArray = npt.NDArray[np.bool_]

Number = TypeVar("Number", np.float64, np.int64)

INT64_MAX = np.iinfo(np.int64).max


@dataclass(frozen=True, eq=False)
class SampleBatch:
    """Consecutive samples of one signal of one unit.

    A BadInput is raised if the arrays do not fit together, a scale is not finite, or a number or name is beyond its
    bounds.

    Parameters
    ----------
    epoch: Power-on of the source; `seq` counts within it.
    seq: Number of the first sample within the epoch.
    t0_ns: Time of the first sample, nanoseconds UTC (from 1970, or from the run's start where the date is unknown).
    dt_ns: Nominal sample interval in nanoseconds, at least 1.
    unit_of_measure: Unit of the values.
    counts: shape (n,); raw counts of the device: value = counts * scale + offset.
    values: shape (n,); the values, where the device gives no counts. Exactly one of `counts` and `values` is set.
    times_ns: shape (n,); true times; None where sample i is at exactly t0_ns + i * dt_ns.
    irregular: True where the samples do not lie within a tenth of an interval of a grid of `dt_ns`.
    flags: shape (n,); set only where a sample of the batch has one.

    >>> from uuid import UUID
    >>> batch = SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, 10_000_000, "deg/s",
    ...                     counts=np.array([1, 2, 3], np.int32), scale=0.5)
    >>> len(batch), batch.value_array.tolist(), batch.last_ns
    (3, [0.5, 1.0, 1.5], 20000000)
    """

    unit: str
    signal: str
    run: str
    epoch: UUID
    seq: int
    t0_ns: int
    dt_ns: int
    unit_of_measure: str
    counts: CountArray | None = None
    values: FloatArray | None = None
    times_ns: IntArray | None = None
    irregular: bool = False
    scale: float = 1.0
    offset: float = 0.0
    flags: FlagArray | None = None

    def __post_init__(self) -> None:
        """Check that the parts fit together."""
        if (self.counts is None) == (self.values is None):
            raise BadInput(f"{self.label}: a batch holds either counts or values, exactly one of them")
        n = len(self)
        if n == 0:
            raise BadInput(f"{self.label}: a batch holds at least one sample")
        for name in ("times_ns", "flags"):
            array = getattr(self, name)
            if array is not None and len(array) != n:
                raise BadInput(f"{self.label}: {len(array)} {name} for {n} samples")
        if not (isfinite(self.scale) and isfinite(self.offset)):
            raise BadInput(f"{self.label}: scale {self.scale} or offset {self.offset} is not a finite number")
        if not 1 <= self.dt_ns <= MAX_INTERVAL_NS or not 0 <= self.seq <= MAX_SEQ - n:
            raise BadInput(f"{self.label}: dt_ns {self.dt_ns} or seq {self.seq} is outside its range")
        if not (is_moment(self.t0_ns) and is_moment(self.last_ns)) or not are_moments(self.times_ns):
            raise BadInput(f"{self.label}: times from {self.t0_ns} ns on are not between 1897 and 2116")
        if len(self.run) > MAX_NAME_CHARS or len(self.unit_of_measure) > MAX_NAME_CHARS:
            raise BadInput(f"{self.label[:300]}: run or unit of measure has more than {MAX_NAME_CHARS} characters")

    def __len__(self) -> int:
        data = self.counts if self.counts is not None else self.values
        assert data is not None
        return len(data)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SampleBatch):
            return NotImplemented
        return all(_same(getattr(self, name), getattr(other, name)) for name in self.__dataclass_fields__)

    __hash__ = None  # type: ignore[assignment]

    @property
    def label(self) -> str:
        """Run, unit and signal, for messages."""
        return f"run {self.run}, unit {self.unit}, signal {self.signal}"

    @property
    def next_seq(self) -> int:
        """Number of the sample that follows this batch."""
        return self.seq + len(self)

    @property
    def last_ns(self) -> int:
        """Time of the last sample, nanoseconds."""
        if self.times_ns is not None:
            return int(self.times_ns[-1])
        return self.t0_ns + (len(self) - 1) * self.dt_ns

    def part(self, start: int, stop: int) -> "SampleBatch":
        """Samples `start` to `stop` of the batch, as a batch; the arrays are views."""
        return replace(
            self,
            seq=self.seq + start,
            t0_ns=self.t0_ns + start * self.dt_ns if self.times_ns is None else int(self.times_ns[start]),
            counts=None if self.counts is None else self.counts[start:stop],
            values=None if self.values is None else self.values[start:stop],
            times_ns=None if self.times_ns is None else self.times_ns[start:stop],
            flags=None if self.flags is None else self.flags[start:stop],
        )

    @cached_property
    def own_values(self) -> FloatArray:
        """The values, writeable, for machine code; see `writable`."""
        return writable(self.value_array)

    @cached_property
    def finite(self) -> int:
        """Samples with a finite value."""
        return len(self) if self.values is None else count_finite(self.values)

    @cached_property
    def time_array(self) -> IntArray:
        """Time of every sample, nanoseconds, shape (n,)."""
        if self.times_ns is not None:
            return self.times_ns
        return self.t0_ns + self.dt_ns * np.arange(len(self), dtype=np.int64)

    @cached_property
    def value_array(self) -> FloatArray:
        """Value of every sample in `unit_of_measure`, shape (n,)."""
        if self.values is not None:
            return self.values
        assert self.counts is not None
        values = np.multiply(self.counts, self.scale, dtype=np.float64)
        values += self.offset
        return values


def is_moment(t_ns: int) -> bool:
    """Whether a time is between 1897 and 2116."""
    return MIN_MOMENT_NS <= t_ns <= MAX_MOMENT_NS


def are_moments(times_ns: IntArray | None) -> bool:
    """Whether all times are between 1897 and 2116."""
    return times_ns is None or (is_moment(int(times_ns.min())) and is_moment(int(times_ns.max())))


def checked_batch(**parts: Any) -> SampleBatch:
    """A batch of parts that the caller has checked; omitted ones have their defaults."""
    batch = object.__new__(SampleBatch)
    vars(batch).update(parts)
    return batch


def writable(array: npt.NDArray[Number]) -> npt.NDArray[Number]:
    """The array, copied unless contiguous and writeable: numba would compile its code once more for read-only ones."""
    flags = array.flags
    return array if flags.c_contiguous and flags.writeable else array.copy()


def first_finite(values: FloatArray) -> float:
    """The first finite value, NaN where there is none."""
    finite = np.flatnonzero(np.isfinite(values))
    return float(values[finite[0]]) if len(finite) else nan


def count_finite(values: FloatArray) -> int:
    """How many values are finite."""
    return int(np.count_nonzero(np.isfinite(values)))


def _same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and a.tobytes() == b.tobytes()
    return type(a) is type(b) and a == b
