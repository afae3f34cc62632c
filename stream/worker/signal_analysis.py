"""Everything that is estimated of one signal while it flows, and the documents that say so."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self
from uuid import UUID, uuid5

import msgspec

from stream.errors import GyrofleetError
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import Estimator, NoEstimate
from stream.estimators.follower import Follower
from stream.estimators.noise.noise_fit import fit_noise
from stream.estimators.snapshot import restore, take_snapshot
from stream.estimators.spectral_density import SpectralDensity
from stream.events import AnyDocument, EstimatePublished, LimitsApplied, NoiseFitted, SpectralLinesFound
from stream.identity import Place
from stream.quantities import ANGULAR_RATE_UNIT
from stream.wire.batches import WireBatch
from stream.worker.early_decisions import EarlyDecisions
from stream.worker.piece_buffer import Piece, PieceBuffer, PieceBufferState

NOISE_COEFFICIENTS = "noise_coefficients"
SPECTRAL_LINES = "spectral_lines"
EARLY_DECISION = "early_decision"

Documents = list[tuple[str, AnyDocument]]

_NAMESPACE = UUID("8d3f3c5e-6a2f-4d53-9a3c-5f0c7f0a9b11")


class SignalState(msgspec.Struct, frozen=True):
    """A signal's analysis as it is kept in a checkpoint."""

    place: tuple[str, str]
    gathering: PieceBufferState
    first_ns: int | None
    last_ns: int
    refusal: str | None
    snapshots: tuple[bytes, ...]
    decisions: dict[str, Any]


class SignalAnalysis:
    """The estimators, the spectrum and the early decisions of one signal of one run.

    Documents are due whenever the signal's own time passes a multiple of the interval, counted from its first sample,
    and when its run ends. What they say, and when, is a function of the samples alone: not of the batches in which they
    came, nor of the moments.

    Parameters
    ----------
    place: Where the signal comes from.
    name: Unit, signal and run.
    every_ns: Interval between documents in the signal's own time, nanoseconds.
    followers: Estimators and the spectral density.

    Attributes
    ----------
    judged: Once it is finished: the final estimates that limits are compared with.
    """

    def __init__(self, place: Place, name: tuple[str, str, str], every_ns: int, followers: Sequence[Follower]) -> None:
        self.place = place
        self.unit, self.signal, self.run = name
        self._every_ns = every_ns
        self._followers = list(followers)
        self._pieces = PieceBuffer(name, every_ns)
        self._decisions = EarlyDecisions(self.signal)
        self._refusal: str | None = None
        self._first_ns: int | None = None
        self._last_ns = 0
        self.judged: tuple[EstimatePublished, ...] = ()

    def apply_limits(self, limits: LimitsApplied) -> None:
        """Decide early on those limits of the run that are on this signal."""
        self._decisions.apply(limits)

    def take(self, batch: WireBatch) -> Documents:
        """Take in the next batch; the documents that are due, with the names under which they are published."""
        found: Documents = []
        for piece in self._pieces.take(batch):
            self._follow(piece)
            if piece.is_due:
                found += self._documents(final=False)
        return found

    def finish(self) -> Documents:
        """Take in what is left: the run has ended; the documents that say what is known, marked final."""
        for piece in self._pieces.rest():
            self._follow(piece)
        return self._documents(final=True)

    def _follow(self, piece: Piece) -> None:
        """Let all follow; a signal that is refused once stays so."""
        batch = piece.batch
        if self._first_ns is None:
            self._first_ns, self._last_ns = int(batch.time_array[0]), piece.last_ns
        self._last_ns = max(self._last_ns, piece.last_ns)
        if self._refusal is not None:
            return
        try:
            for follower in self._followers:
                follower.update(batch)
            self._decisions.update(batch)
        except GyrofleetError as error:
            self._refusal = str(error)

    def _documents(self, *, final: bool) -> Documents:
        found: Documents = []
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
        elapsed_s = (self._last_ns - (self._first_ns or 0)) / 1e9 + interval_s
        if (since_ns := self._decisions.since_ns) is not None:
            elapsed_s = max(0.0, (self._last_ns - since_ns) / 1e9 + interval_s)
            points = {each.key: self._estimate(each, final=final) for each in self._decisions.estimators}
        if final:
            exact = self._decisions.exact_points()
            self.judged = tuple(
                msgspec.structs.replace(each, points=(*exact, *each.points)) if key == AllanDeviation.key else each
                for key, each in points.items()
            )
        for number, decision in enumerate(self._decisions.look(elapsed_s, points)):
            found.append((EARLY_DECISION, decision.document(self._head(f"decision-{number}", final=final))))
        return found

    def _head(self, what: str, *, final: bool) -> dict[str, Any]:
        name = f"{self.run}/{self.unit}/{self.signal}/{what}/{self._last_ns}/{final}"
        uid = uuid5(_NAMESPACE, name).hex
        return {"run": self.run, "t_ns": self._last_ns, "uid": uid, "unit": self.unit, "signal": self.signal}

    def _estimate(self, estimator: Estimator, *, final: bool) -> EstimatePublished:
        estimate = NoEstimate(self._refusal) if self._refusal else estimator.estimate()
        return EstimatePublished(
            **self._head(estimator.key, final=final),
            estimator=estimator.key,
            unit_of_measure=estimator.unit_of_measure,
            confidence=estimator.confidence,
            samples=estimator.samples,
            missing=estimator.missing,
            sample_interval_s=estimator.sample_interval_s,
            every_ns=self._every_ns,
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
        lines = NoEstimate(self._refusal) if self._refusal else spectral.lines()
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
            gathering=self._pieces.export_state(),
            first_ns=self._first_ns,
            last_ns=self._last_ns,
            refusal=self._refusal,
            snapshots=tuple(take_snapshot(follower) for follower in self._followers),
            decisions=self._decisions.export_state(),
        )

    @classmethod
    def from_state(cls, state: SignalState) -> Self:
        """Go on from a checkpoint.

        Raises
        ------
        EstimatorError: If a snapshot in it is damaged or of another version.
        """
        followers = [restore(snapshot) for snapshot in state.snapshots]
        analysis = cls(Place(*state.place), state.gathering.name, state.gathering.every_ns, followers)
        analysis._pieces = PieceBuffer.from_state(state.gathering)
        analysis._decisions = EarlyDecisions.from_state(analysis.signal, state.decisions)
        analysis._refusal = state.refusal
        analysis._first_ns, analysis._last_ns = state.first_ns, state.last_ns
        return analysis


def fresh_followers(factories: Mapping[str, Callable[[], Estimator]], *, spectrum: bool = True) -> list[Follower]:
    """One of each estimator, and a spectral density if it is wanted."""
    return [*(make() for make in factories.values()), *([SpectralDensity()] if spectrum else [])]
