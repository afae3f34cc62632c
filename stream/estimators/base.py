"""Base class of estimators: they take batches of one signal, keep a bounded state and say what they know."""

import functools
import importlib
import inspect
import math
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Generic, NamedTuple, Self, TypeVar

import msgspec
import numpy.typing as npt

from stream.batch import FloatArray, SampleBatch
from stream.clock import GridTracker, Piece, contiguous_runs
from stream.errors import EstimatorError
from stream.events import EstimatePoint
from stream.quantities import report_unit

LEAST_SHARE = 0.9  # an average counts if it holds this share of its samples
_PACKAGE = __name__.rpartition(".")[0]


def held_share(samples: int, missing: int) -> float:
    """The least share of their samples that the averages of a record hold as a rule, 1 where none is missing.

    The mean of those that an average holds stands for all. White noise then scatters more, by up to the inverse root.

    >>> held_share(99, 1), held_share(50, 50), held_share(0, 0)
    (0.99, 0.9, 1.0)
    """
    return max(LEAST_SHARE, samples / (samples + missing)) if samples else 1.0


Result = TypeVar("Result", covariant=True)
Points = tuple[EstimatePoint, ...]


class NoEstimate(msgspec.Struct, frozen=True):
    """There is no estimate; `reason` says what is lacking, for people."""

    reason: str


class EstimatorState(NamedTuple):
    """Everything that an estimator keeps of its signal, in plain numbers and arrays."""

    signal: tuple[str, str, str]
    tracker: dict[str, int]
    reference: float
    arrays: tuple[npt.NDArray[Any], ...]


class SignalInput:
    """The signal taken in and the grid of its samples; `unit_of_measure` of the results, deg/h for angular rates."""

    def __init__(self) -> None:
        self.tracker = GridTracker()
        self._signal = ("", "", "")
        self.unit_of_measure = ""
        self._factor = 1.0

    @property
    def samples(self) -> int:
        """Samples with a finite value that were taken in."""
        return self.tracker.samples

    @property
    def missing(self) -> int:
        """Slots of the grid up to the last sample that hold no finite value."""
        return self.tracker.missing

    @property
    def late(self) -> int:
        """Samples left out because their time was not after that of one already taken in."""
        return self.tracker.late

    @property
    def sample_interval_s(self) -> float:
        """Nominal sample interval in seconds, 0 before the first batch."""
        return self.tracker.sample_interval_s

    def _no_grid(self, quantity: str) -> NoEstimate:
        unit, signal, _ = self._signal
        return NoEstimate(
            f"unit {unit}, signal {signal}: the samples lie on no grid of {self.sample_interval_s:g} s, and the "
            f"{quantity} needs one; resample by block means, --resample SECONDS"
        )

    def _too_large(self) -> NoEstimate:
        unit, signal, _ = self._signal
        return NoEstimate(f"unit {unit}, signal {signal}: values too large to be squared; check the source")

    def _too_small(self) -> NoEstimate:
        unit, signal, _ = self._signal
        return NoEstimate(
            f"unit {unit}, signal {signal}: values differ by too little to be squared; give them in a smaller unit"
        )

    def _begin(self, batch: SampleBatch, what: str) -> None:
        """Take the signal of the first batch; refuse a batch of another one. `what` is computed, for the message."""
        if self.unit_of_measure:
            unit, signal, measure = self._signal
            raise EstimatorError(
                f"run {batch.run}: the {what} of unit {unit}, signal {signal} in {measure} cannot take a batch of unit "
                f"{batch.unit}, signal {batch.signal} in {batch.unit_of_measure}; begin a new one for each signal"
            )
        self._signal = (batch.unit, batch.signal, batch.unit_of_measure)
        self.unit_of_measure, self._factor = report_unit(batch.unit_of_measure)


class Estimator(SignalInput, ABC, Generic[Result]):
    """A quantity of one signal, known while the signal flows.

    Every concrete subclass in this package is found automatically (`estimator_classes`) and checked against the laws
    of estimators: the result does not depend on how the stream is cut into batches, the input is not modified, gaps
    and NaN take their true place in time, memory is bounded, and too little data is a `NoEstimate`.
    Neighbouring parts of a signal can be estimated separately and merged (`continuation`, `merge`).
    One instance is used by one thread at a time; different instances share nothing.

    `key` is its name in key expressions and files, `names` are those for people, by language: ``en`` and ``zh``.
    `confidence` is the level of its bounds. `variants` are arguments of the instances that every signal has by default;
    `has_points` says whether `estimate` gives points over an averaging time, published while the signal flows.
    """

    key: str
    names: Mapping[str, str]
    confidence: float = 0.95
    variants: ClassVar[tuple[dict[str, Any], ...]] = ({},)
    has_points: ClassVar[bool] = True

    _state: tuple[npt.NDArray[Any], ...]

    def __init__(self) -> None:
        super().__init__()
        self._reference = math.nan

    @property
    @abstractmethod
    def arguments(self) -> Mapping[str, int | float]:
        """Arguments of the constructor, by name."""

    @abstractmethod
    def estimate(self) -> Result | NoEstimate:
        """What is known now, in `unit_of_measure`; never NaN or infinite."""

    @abstractmethod
    def _take_run(self, first_slot: int, values: FloatArray) -> None:
        """Take in values on the slots from `first_slot` on; NaN is missing."""

    @abstractmethod
    def _continue_from(self, earlier: Self) -> None:
        """Let the empty state begin where that of the earlier part ends."""

    @abstractmethod
    def _append(self, later: Self) -> None:
        """Append the state of the part that follows."""

    def update(self, batch: SampleBatch) -> None:
        """Take in the next batch; EstimatorError if it is of another signal, unit of measure or sample interval."""
        if (batch.unit, batch.signal, batch.unit_of_measure) != self._signal:
            self._begin(batch, self.names["en"])
        values = batch.values
        if values is None or not (values.flags.writeable and values.flags.c_contiguous):
            values = batch.own_values
        first_slot = self.tracker.place_next(batch, len(values))
        if first_slot >= 0:
            self._take_run(first_slot, values)
            return
        pieces = self.tracker.place(batch)
        if pieces:
            self._take(batch, pieces)

    def _take(self, batch: SampleBatch, pieces: list[Piece]) -> None:
        """Take in the samples of a batch that are not late."""
        for first_slot, values in contiguous_runs(batch, pieces):
            self._take_run(first_slot, values)

    @property
    def state_bytes(self) -> int:
        """Size of the arrays that are kept of the signal, bytes."""
        return sum(array.nbytes for array in self._state)

    def export_state(self) -> EstimatorState:
        """Copy everything that is kept of the signal."""
        arrays = tuple(array.copy() for array in self._state)
        return EstimatorState(self._signal, self.tracker.export_state(), self._reference, arrays)

    def import_state(self, state: EstimatorState) -> None:
        """Take over a state; EstimatorError if its arrays have other shapes or types than this estimator's."""
        room = self._room_for(state.arrays)
        mine, theirs = (", ".join(f"{each.dtype} {each.shape}" for each in arrays) for arrays in (room, state.arrays))
        if mine != theirs:
            raise EstimatorError(
                f"the {self.names['en']} keeps {mine}, the state to be taken over has {theirs}: it is of another "
                "estimator"
            )
        for array, values in zip(room, state.arrays, strict=True):
            array[...] = values
        self._state = room
        self.tracker.import_state(state.tracker)
        self._reference = state.reference
        self._signal = state.signal
        if state.signal[2]:
            self.unit_of_measure, self._factor = report_unit(state.signal[2])

    def _room_for(self, arrays: tuple[npt.NDArray[Any], ...]) -> tuple[npt.NDArray[Any], ...]:  # noqa: ARG002
        """Arrays that imported ones are copied to: those of the state, where their sizes never change."""
        return self._state

    def copy(self) -> Self:
        """An independent copy."""
        other: Self = type(self)(**self.arguments)
        other.import_state(self.export_state())
        return other

    def continuation(self) -> Self:
        """An empty estimator of the same kind for the part of the signal that follows.

        The two can be merged, in any order among neighbours. A part can be computed elsewhere, or be kept to
        be merged with others, as a rolling window does.
        """
        later: Self = type(self)(**self.arguments)
        later._signal, later.unit_of_measure, later._factor = self._signal, self.unit_of_measure, self._factor
        later._reference = self._reference
        later.tracker = self.tracker.continuation()
        later._continue_from(self)
        return later

    def merge(self, later: Self) -> None:
        """Become the estimator of both parts; EstimatorError if `later` is no `continuation` of this one as it is."""
        if type(later) is not type(self) or later.arguments != self.arguments:
            raise EstimatorError(
                f"the {self.names['en']} {dict(self.arguments)} cannot be merged with the {later.names['en']} "
                f"{dict(later.arguments)}: kind and settings must agree"
            )
        if self.unit_of_measure and later._signal != self._signal:
            mine, theirs = (f"unit {unit}, signal {name} in {si}" for unit, name, si in (self._signal, later._signal))
            raise EstimatorError(f"the {self.names['en']} of {mine} cannot be merged with that of {theirs}")
        self.tracker.merge(later.tracker)
        self._signal, self.unit_of_measure, self._factor = later._signal, later.unit_of_measure, later._factor
        if math.isnan(self._reference):
            self._reference = later._reference
        self._append(later)


PointEstimator = Estimator[Points]


def estimator_classes() -> tuple[type[Estimator[Any]], ...]:
    """Every concrete estimator of this package, by class name.

    >>> [cls.__name__ for cls in estimator_classes()]
    ['AllanDeviation', 'BiasStability', 'SpectralDensity']
    """
    package = importlib.import_module(_PACKAGE)
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{_PACKAGE}.{module.name}")
    classes: list[type[Estimator[Any]]] = Estimator.__subclasses__()
    for cls in classes:
        classes += cls.__subclasses__()
    found = {cls for cls in classes if not inspect.isabstract(cls) and cls.__module__.startswith(f"{_PACKAGE}.")}
    return tuple(sorted(found, key=lambda cls: cls.__name__))


def all_estimators() -> dict[str, Callable[[], Estimator[Any]]]:
    """Factories of every estimator that a signal has by default, by their keys.

    >>> sorted(all_estimators().keys() - default_estimators().keys())
    ['spectral_density']
    """
    factories = [functools.partial(cls, **variant) for cls in estimator_classes() for variant in cls.variants]
    return {factory().key: factory for factory in factories}


def default_estimators() -> dict[str, Callable[[], PointEstimator]]:
    """Factories of those whose points are published while the signal flows.

    >>> sorted(default_estimators())  # doctest: +NORMALIZE_WHITESPACE
    ['allan_deviation', 'bias_stability_100s', 'bias_stability_10s', 'bias_stability_10s_over_3600s',
     'bias_stability_1s', 'bias_stability_raw']
    """
    return {key: factory for key, factory in all_estimators().items() if factory().has_points}
