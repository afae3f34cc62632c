"""What every estimator has in common: it takes batches, keeps a bounded state, and says what it knows or why not."""

import functools
import importlib
import inspect
import math
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, Self, TypeVar
from uuid import UUID

import msgspec
import numpy as np
import numpy.typing as npt

from stream.batch import FloatArray, SampleBatch
from stream.clock import GridTracker, Piece
from stream.errors import EstimatorError
from stream.events import EstimatePoint
from stream.quantities import report_unit

_PACKAGE = __name__.rpartition(".")[0]
_JOINED_SPAN = 8

Number = TypeVar("Number", np.float64, np.int64)


class NoEstimate(msgspec.Struct, frozen=True):
    """There is no estimate; `reason` says what is lacking, for people."""

    reason: str


class EstimatorState(NamedTuple):
    """Everything that an estimator keeps of its signal, in plain numbers and arrays."""

    signal: tuple[str, str, str]
    tracker: dict[str, int]
    reference: float
    arrays: tuple[npt.NDArray[Any], ...]


class Estimator(ABC):
    """A quantity of one signal, known while the signal flows.

    A concrete estimator in this package is found by itself (`default_estimators`) and held against the laws that
    all estimators keep: the result does not depend on how the stream is cut into batches, the input is not
    modified, gaps and NaN take their true place in time, memory is bounded, and too little data is a `NoEstimate`.
    Neighbouring parts of a signal can be estimated apart and merged (`successor`, `merge`).
    One instance is used by one thread at a time; different instances share nothing.

    Attributes
    ----------
    key : str
        Name of the estimator in key expressions and files.
    names : Mapping
        Its names for people, by language: ``en`` and ``zh``.
    confidence : float
        Confidence level of the limits of a point.
    variants : tuple of dict
        Arguments of the instances that every signal is given by default.
    """

    key: str
    names: Mapping[str, str]
    confidence: float = 0.95
    variants: ClassVar[tuple[dict[str, Any], ...]] = ({},)

    _state: tuple[npt.NDArray[Any], ...]

    def __init__(self) -> None:
        self._tracker = GridTracker()
        self._signal = ("", "", "")
        self._report_unit = ""
        self._factor = 1.0
        self._reference = math.nan

    @property
    @abstractmethod
    def arguments(self) -> Mapping[str, int | float]:
        """What the constructor was given, by name."""

    @property
    def unit_of_measure(self) -> str:
        """Unit of the estimates, deg/h for angular rates; empty before the first batch."""
        return self._report_unit

    @property
    def tracker(self) -> GridTracker:
        """Where its samples lie in time; to be looked at only."""
        return self._tracker

    @property
    def samples(self) -> int:
        """Samples with a finite value that were taken in."""
        return self._tracker.samples

    @property
    def missing(self) -> int:
        """Slots of the grid up to the last sample that hold no finite value."""
        return self._tracker.missing

    @property
    def late(self) -> int:
        """Samples left out because their time was not after that of one already taken in."""
        return self._tracker.late

    @property
    def sample_interval_s(self) -> float:
        """Nominal sample interval in seconds, 0 before the first batch."""
        return self._tracker.sample_interval_s

    @property
    def state_bytes(self) -> int:
        """Size of the arrays that are kept of the signal, bytes."""
        return sum(array.nbytes for array in self._state)

    def export_state(self) -> EstimatorState:
        """Copy everything that is kept of the signal."""
        arrays = tuple(array.copy() for array in self._state)
        return EstimatorState(self._signal, self._tracker.export_state(), self._reference, arrays)

    def import_state(self, state: EstimatorState) -> None:
        """Take over what another instance with the same arguments has exported.

        Raises
        ------
        EstimatorError
            If the arrays have other shapes or types than this estimator's.
        """
        for mine, theirs in zip(self._state, state.arrays, strict=True):
            if mine.shape != theirs.shape or mine.dtype != theirs.dtype:
                raise EstimatorError(
                    f"the {self.names['en']} keeps {mine.dtype} {mine.shape}, the state to be taken over has "
                    f"{theirs.dtype} {theirs.shape}: it is of another estimator"
                )
        for mine, theirs in zip(self._state, state.arrays, strict=True):
            mine[...] = theirs
        self._tracker.import_state(state.tracker)
        self._reference = state.reference
        self._signal = state.signal
        if state.signal[2]:
            self._report_unit, self._factor = report_unit(state.signal[2])

    def copy(self) -> Self:
        """An estimator that stands where this one stands, and goes its own way from here."""
        other: Self = type(self)(**self.arguments)
        other.import_state(self.export_state())
        return other

    def successor(self) -> Self:
        """An estimator of the same kind that goes on where this one stands, for the part that follows.

        The two can be merged, in any order among neighbours. A part can be worked on elsewhere, or be kept to
        be merged with others, as a rolling window does.
        """
        later: Self = type(self)(**self.arguments)
        later._signal, later._report_unit, later._factor = self._signal, self._report_unit, self._factor
        later._reference = self._reference
        later._tracker = self._tracker.successor()
        later._go_on_from(self)
        return later

    def merge(self, later: Self) -> None:
        """Become the estimator of both parts; `later` goes on where this one ends, and is left as it is.

        Raises
        ------
        EstimatorError
            If `later` is of another kind, signal or setting, or was not begun by `successor` of what this one is now.
        """
        if type(later) is not type(self) or later.arguments != self.arguments:
            raise EstimatorError(
                f"the {self.names['en']} {dict(self.arguments)} cannot be merged with the {later.names['en']} "
                f"{dict(later.arguments)}: kind and settings must agree"
            )
        if self._report_unit and later._signal != self._signal:
            raise EstimatorError(
                f"the {self.names['en']} of unit {self._signal[0]}, signal {self._signal[1]} in {self._signal[2]} "
                f"cannot be merged with that of unit {later._signal[0]}, signal {later._signal[1]} in "
                f"{later._signal[2]}"
            )
        self._tracker.merge(later._tracker)
        self._signal, self._report_unit, self._factor = later._signal, later._report_unit, later._factor
        if math.isnan(self._reference):
            self._reference = later._reference
        self._append(later)

    @abstractmethod
    def _go_on_from(self, earlier: Self) -> None:
        """Let the empty state begin where that of the earlier part stands."""

    @abstractmethod
    def _append(self, later: Self) -> None:
        """Put the state of the part that follows behind this one's."""

    def update(self, batch: SampleBatch) -> None:
        """Take in the next batch of the signal.

        Raises
        ------
        EstimatorError
            If the batch is of another signal, unit of measure or sample interval than those before it.
        """
        signal = (batch.unit, batch.signal, batch.unit_of_measure)
        if signal != self._signal:
            self._begin(batch, signal)
        first_slot = self._tracker.follow(batch)
        if first_slot >= 0:
            self._take_run(first_slot, for_kernel(batch.value_array))
            return
        pieces = self._tracker.place(batch)
        if pieces:
            self._take(batch, pieces)

    @abstractmethod
    def estimate(self) -> tuple[EstimatePoint, ...] | NoEstimate:
        """What is known now, in `unit_of_measure`; never NaN or infinite."""

    def _take(self, batch: SampleBatch, pieces: list[Piece]) -> None:
        """Take in the samples of a batch that are not late."""
        for first_slot, values in contiguous_runs(batch, pieces):
            self._take_run(first_slot, values)

    @abstractmethod
    def _take_run(self, first_slot: int, values: FloatArray) -> None:
        """Take in values on the slots from `first_slot` on; NaN is missing."""

    def _begin(self, batch: SampleBatch, signal: tuple[str, str, str]) -> None:
        if self._report_unit:
            raise EstimatorError(
                f"run {batch.run}: the {self.names['en']} of unit {self._signal[0]}, signal {self._signal[1]} in "
                f"{self._signal[2]} was given a batch of unit {batch.unit}, signal {batch.signal} in "
                f"{batch.unit_of_measure}; each signal needs an estimator of its own"
            )
        self._signal = signal
        self._report_unit, self._factor = report_unit(batch.unit_of_measure)


def contiguous_runs(batch: SampleBatch, pieces: list[Piece]) -> list[tuple[int, FloatArray]]:
    """Values of the pieces, each with the slot of its first.

    Pieces that lie close together come as one, NaN between them: a call for each would cost more than the NaN.
    """
    values = for_kernel(batch.value_array)
    if len(pieces) == 1:
        first_slot, start, stop = pieces[0]
        return [(first_slot, values if stop - start == len(values) else values[start:stop])]
    origin, last = pieces[0].first_slot, pieces[-1]
    span = last.first_slot + last.stop - last.start - origin
    if span > _JOINED_SPAN * len(values):
        return [(slot, values[start:stop]) for slot, start, stop in pieces]
    joined = np.full(span, np.nan)
    for slot, start, stop in pieces:
        joined[slot - origin : slot - origin + stop - start] = values[start:stop]
    return [(origin, joined)]


def for_kernel(array: npt.NDArray[Number]) -> npt.NDArray[Number]:
    """The array, copied unless it is contiguous and writeable.

    Arrays off the wire are read-only, which numba takes for another type and would compile its code for once more.
    """
    flags = array.flags
    return array if flags.c_contiguous and flags.writeable else array.copy()


def first_finite(values: FloatArray) -> float:
    """The first finite value, NaN where there is none."""
    finite = np.flatnonzero(np.isfinite(values))
    return float(values[finite[0]]) if len(finite) else math.nan


def estimator_classes() -> tuple[type[Estimator], ...]:
    """Every concrete estimator of this package, by name of its class."""
    package = importlib.import_module(_PACKAGE)
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{_PACKAGE}.{module.name}")
    found: set[type[Estimator]] = set()
    waiting = list(Estimator.__subclasses__())
    while waiting:
        cls = waiting.pop()
        waiting.extend(cls.__subclasses__())
        if not inspect.isabstract(cls) and cls.__module__.startswith(f"{_PACKAGE}."):
            found.add(cls)
    return tuple(sorted(found, key=lambda cls: cls.__name__))


def default_estimators() -> dict[str, Callable[[], Estimator]]:
    """Factories of the estimators that a signal is given unless told otherwise, by their keys.

    Examples
    --------
    >>> sorted(default_estimators())  # doctest: +NORMALIZE_WHITESPACE
    ['allan_deviation', 'bias_stability_100s', 'bias_stability_10s', 'bias_stability_10s_over_3600s',
     'bias_stability_1s', 'bias_stability_raw']
    """
    factories = [functools.partial(cls, **variant) for cls in estimator_classes() for variant in cls.variants]
    return {factory().key: factory for factory in factories}


def warm_up() -> None:
    """Compile the machine code of all estimators, or load it where it was compiled before.

    It is kept on disk beside the modules, or in the user's cache directory where that cannot be written; compiling
    takes some seconds, once an installation.
    """
    values = np.array([1.0, np.nan, 2.0, 4.0])
    times_ns = np.array([0, 1, 5, 6], np.int64) * 10**9
    regular = SampleBatch("unit", "signal", "run", UUID(int=0), 0, 0, 10**9, "1", values=values)
    irregular = SampleBatch(
        "unit", "signal", "run", UUID(int=0), 0, 0, 10**9, "1", values=values, times_ns=times_ns, irregular=True
    )
    for factory in default_estimators().values():
        for batch in (regular, irregular):
            estimator = factory()
            estimator.update(batch)
            estimator.merge(estimator.successor())
            estimator.estimate()
