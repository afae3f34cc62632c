"""What all that follow a signal have in common: they take batches, keep a bounded state, and say what they know."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import msgspec
import numpy as np
import numpy.typing as npt

from stream.batch import FloatArray, SampleBatch
from stream.clock import GridTracker, Piece
from stream.errors import EstimatorError
from stream.quantities import report_unit

_JOINED_SPAN = 8


class NoEstimate(msgspec.Struct, frozen=True):
    """There is no estimate; `reason` says what is lacking, for people."""

    reason: str


class EstimatorState(NamedTuple):
    """Everything that an estimator keeps of its signal, in plain numbers and arrays."""

    signal: tuple[str, str, str]
    tracker: dict[str, int]
    reference: float
    arrays: tuple[npt.NDArray[Any], ...]


class Follower(ABC):
    """Something that follows one signal and says what it knows of it.

    A concrete one in this package is found by itself (`base.follower_classes`) and compared with the laws that all
    keep: the result does not depend on how the stream is cut into batches, the input is not
    modified, gaps and NaN take their true place in time, memory is bounded, and too little data is a `NoEstimate`.
    Neighbouring parts of a signal can be estimated apart and merged (`successor`, `merge`).
    One instance is used by one thread at a time; different instances share nothing.

    Attributes
    ----------
    key: Its name in key expressions and files.
    names: Its names for people, by language: ``en`` and ``zh``.
    confidence: Confidence level of the limits of what it says.
    """

    key: str
    names: Mapping[str, str]
    confidence: float = 0.95

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
        EstimatorError: If the arrays have other shapes or types than this estimator's.
        """
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
        EstimatorError: If `later` is of another kind, signal or setting, or was not begun by `successor` of what this
            one is now.
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

    def _room_for(self, arrays: tuple[npt.NDArray[Any], ...]) -> tuple[npt.NDArray[Any], ...]:  # noqa: ARG002
        """Arrays that exported ones are copied to: those of the state, where their sizes never change."""
        return self._state

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
        EstimatorError: If the batch is of another signal, unit of measure or sample interval than those before it.
        """
        signal = (batch.unit, batch.signal, batch.unit_of_measure)
        if signal != self._signal:
            self._begin(batch, signal)
        values = batch.values
        if values is None or not (values.flags.writeable and values.flags.c_contiguous):
            values = batch.own_values
        first_slot = self._tracker.follow(batch, len(values))
        if first_slot >= 0:
            self._take_run(first_slot, values)
            return
        pieces = self._tracker.place(batch)
        if pieces:
            self._take(batch, pieces)

    @abstractmethod
    def estimate(self) -> object:
        """What is known now, `NoEstimate` where that is nothing; never NaN or infinite."""

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
    values = batch.own_values
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


def first_finite(values: FloatArray) -> float:
    """The first finite value, NaN where there is none."""
    finite = np.flatnonzero(np.isfinite(values))
    return float(values[finite[0]]) if len(finite) else math.nan
