"""Everything that is estimated of one signal while it flows, and the documents that say so."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self
from uuid import UUID, uuid5

import msgspec

from stream.batch import SampleBatch
from stream.early_decisions import EarlyDecisions
from stream.errors import GyrofleetError
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import Estimator, NoEstimate
from stream.estimators.follower import Follower
from stream.estimators.noise_fit import fit_noise
from stream.estimators.snapshot import restore, take_snapshot
from stream.estimators.spectral_density import SpectralDensity
from stream.events import (
    AnyDocument,
    EstimatePublished,
    LimitsApplied,
    NoiseFitted,
    SpectralLinesFound,
)
from stream.identity import Place
from stream.quantities import ANGULAR_RATE_UNIT

NOISE_COEFFICIENTS = "noise_coefficients"
SPECTRAL_LINES = "spectral_lines"
EARLY_DECISION = "early_decision"

_NAMESPACE = UUID("8d3f3c5e-6a2f-4d53-9a3c-5f0c7f0a9b11")


class SignalState(msgspec.Struct, frozen=True):
    """A signal's analysis as it is kept in a checkpoint."""

    place: tuple[str, str]
    run: str
    unit: str
    signal: str
    next_due_ns: int
    first_ns: int
    last_ns: int
    refusal: str | None
    snapshots: tuple[bytes, ...]
    decisions: dict[str, Any]


class SignalAnalysis:
    """The estimators, the spectrum and the early decisions of one signal of one run.

    Parameters
    ----------
    place : Place
        Where the signal comes from.
    name : tuple of str
        Run, unit and signal.
    first_ns, last_ns : int
        Times of its first sample and of the last one taken in, nanoseconds.
    next_due_ns, every_ns : int
        When documents are due next in the signal's own time, and how often, nanoseconds.
    followers : sequence of Follower
        Estimators and the spectral density.
    decisions : EarlyDecisions, optional
        Those of the run on this signal.
    refusal : str, optional
        Why the signal cannot be estimated.
    """

    def __init__(
        self,
        place: Place,
        name: tuple[str, str, str],
        *,
        first_ns: int,
        last_ns: int,
        next_due_ns: int,
        every_ns: int,
        followers: Sequence[Follower],
        decisions: EarlyDecisions | None = None,
        refusal: str | None = None,
    ) -> None:
        self.place = place
        self.run, self.unit, self.signal = name
        self.refusal = refusal
        self.last_ns = last_ns
        self._first_ns = first_ns
        self._every_ns = every_ns
        self._next_due_ns = next_due_ns
        self._followers = list(followers)
        self._decisions = EarlyDecisions(self.signal) if decisions is None else decisions

    @classmethod
    def begin(cls, place: Place, batch: SampleBatch, every_ns: int, followers: Sequence[Follower]) -> Self:
        """Begin with the first batch of a signal, which is not taken in yet."""
        return cls(
            place,
            (batch.run, batch.unit, batch.signal),
            first_ns=batch.t0_ns,
            last_ns=batch.last_ns,
            next_due_ns=batch.t0_ns + every_ns,
            every_ns=every_ns,
            followers=followers,
        )

    def apply_limits(self, limits: LimitsApplied) -> None:
        """Decide early on those limits of the run that are on this signal."""
        self._decisions.apply(limits)

    def update(self, batch: SampleBatch) -> bool:
        """Take in the next batch; whether documents are due. A signal that is refused once stays so."""
        if self.refusal is None:
            try:
                for follower in self._followers:
                    follower.update(batch)
                self._decisions.update(batch)
            except GyrofleetError as error:
                self.refusal = str(error)
        self.last_ns = batch.last_ns
        if batch.last_ns < self._next_due_ns:
            return False
        passed = (batch.last_ns - self._next_due_ns) // self._every_ns + 1
        self._next_due_ns += passed * self._every_ns
        return True

    def documents(self, *, final: bool) -> list[tuple[str, AnyDocument]]:
        """What is known now, with the name under which it is published; the same data give the same documents."""
        found: list[tuple[str, AnyDocument]] = []
        points: dict[str, EstimatePublished] = {}
        for follower in self._followers:
            if isinstance(follower, Estimator):
                points[follower.key] = document = self._estimate(follower, final=final)
                found.append((follower.key, document))
                if final and isinstance(follower, AllanDeviation):
                    found.append((NOISE_COEFFICIENTS, self._noise(follower, document)))
            elif final and isinstance(follower, SpectralDensity):
                found.append((SPECTRAL_LINES, self._lines(follower)))
        # to the end of the last sample's interval: then a test of its planned length is finished
        interval_s = max((follower.sample_interval_s for follower in self._followers), default=0.0)
        elapsed_s = (self.last_ns - self._first_ns) / 1e9 + interval_s
        for number, decision in enumerate(self._decisions.look(elapsed_s, points)):
            found.append((EARLY_DECISION, decision.document(self._head(f"decision-{number}", final=final))))
        return found

    def _head(self, what: str, *, final: bool) -> dict[str, Any]:
        name = f"{self.run}/{self.unit}/{self.signal}/{what}/{self.last_ns}/{final}"
        uid = uuid5(_NAMESPACE, name).hex
        return {"run": self.run, "t_ns": self.last_ns, "uid": uid, "unit": self.unit, "signal": self.signal}

    def _estimate(self, estimator: Estimator, *, final: bool) -> EstimatePublished:
        estimate = NoEstimate(self.refusal) if self.refusal else estimator.estimate()
        return EstimatePublished(
            **self._head(estimator.key, final=final),
            estimator=estimator.key,
            unit_of_measure=estimator.unit_of_measure,
            confidence=estimator.confidence,
            samples=estimator.samples,
            missing=estimator.missing,
            sample_interval_s=estimator.sample_interval_s,
            final=final,
            points=() if isinstance(estimate, NoEstimate) else estimate,
            reason=estimate.reason if isinstance(estimate, NoEstimate) else None,
        )

    def _noise(self, allan: AllanDeviation, estimate: EstimatePublished) -> NoiseFitted:
        head = self._head(NOISE_COEFFICIENTS, final=True)
        if allan.unit_of_measure != ANGULAR_RATE_UNIT:
            return NoiseFitted(**head, reason=f"the signal is in {allan.unit_of_measure}, not an angular rate")
        fit = NoEstimate(estimate.reason) if estimate.reason else fit_noise(estimate.points)
        if isinstance(fit, NoEstimate):
            return NoiseFitted(**head, reason=fit.reason)
        return NoiseFitted(**head, coefficients=msgspec.to_builtins(fit))

    def _lines(self, spectral: SpectralDensity) -> SpectralLinesFound:
        head = self._head(SPECTRAL_LINES, final=True)
        lines = NoEstimate(self.refusal) if self.refusal else spectral.lines()
        if isinstance(lines, NoEstimate):
            return SpectralLinesFound(**head, lines=None, reason=lines.reason)
        lo_hz, hi_hz = spectral.searched_hz
        return SpectralLinesFound(
            **head,
            unit_of_measure=spectral.unit_of_measure,
            lines=tuple(msgspec.to_builtins(line) for line in lines),
            searched_lo_hz=lo_hz,
            searched_hi_hz=hi_hz,
            bin_width_hz=spectral.bin_width_hz,
            segments=spectral.segments,
        )

    def export_state(self) -> SignalState:
        """Everything that is kept, for a checkpoint."""
        return SignalState(
            place=(self.place.site, self.place.station),
            run=self.run,
            unit=self.unit,
            signal=self.signal,
            next_due_ns=self._next_due_ns,
            first_ns=self._first_ns,
            last_ns=self.last_ns,
            refusal=self.refusal,
            snapshots=tuple(take_snapshot(follower) for follower in self._followers),
            decisions=self._decisions.export_state(),
        )

    @classmethod
    def from_state(cls, state: SignalState, every_ns: int) -> Self:
        """Go on from a checkpoint.

        Raises
        ------
        EstimatorError
            If a snapshot in it is damaged or of another version.
        """
        return cls(
            Place(*state.place),
            (state.run, state.unit, state.signal),
            first_ns=state.first_ns,
            last_ns=state.last_ns,
            next_due_ns=state.next_due_ns,
            every_ns=every_ns,
            followers=[restore(snapshot) for snapshot in state.snapshots],
            decisions=EarlyDecisions.from_state(state.signal, state.decisions),
            refusal=state.refusal,
        )


def fresh_followers(factories: Mapping[str, Callable[[], Estimator]]) -> list[Follower]:
    """One of each estimator, and a spectral density."""
    return [*(make() for make in factories.values()), SpectralDensity()]
