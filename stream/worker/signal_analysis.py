"""All estimates of one signal while it flows, and the documents that report them."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self
from uuid import UUID, uuid5

import msgspec

from stream.errors import GyrofleetError
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import Estimator, NoEstimate, PointEstimator, held_share
from stream.estimators.noise.noise_fit import NoiseFit, fit_noise
from stream.estimators.snapshot import restore, take_snapshot
from stream.estimators.spectral_density import SpectralDensity
from stream.events import AnyDocument, EarlyDecision, EstimatePublished, LimitsApplied, NoiseFitted, SpectralLinesFound
from stream.identity import Place
from stream.quantities import ANGULAR_RATE_UNIT
from stream.wire.batches import WireBatch
from stream.worker.early_decisions import EarlyDecisions, decision_document
from stream.worker.piece_buffer import BufferedPiece, PieceBuffer

NOISE_COEFFICIENTS = "noise_coefficients"
SPECTRAL_LINES = "spectral_lines"
EARLY_DECISION = "early_decision"

Documents = list[tuple[str, AnyDocument]]

_NAMESPACE = UUID("8d3f3c5e-6a2f-4d53-9a3c-5f0c7f0a9b11")


class SignalState(msgspec.Struct, frozen=True):
    """State of a signal's analysis in a checkpoint."""

    place: tuple[str, str]
    buffer: PieceBuffer = msgspec.field(name="gathering")
    first_ns: int | None
    last_ns: int
    refusal: str | None
    snapshots: tuple[bytes, ...]
    decisions: dict[str, Any]


class SignalAnalysis:
    """The estimators, the spectrum and the early decisions of one signal of one run.

    Documents are due whenever the signal's own time passes a multiple of the interval, counted from its first sample,
    and when its run ends. Their content and times are a function of the samples alone, not of the batches in which they
    came, nor of when they came. `name` is unit, signal and run.
    """

    def __init__(
        self, place: Place, name: tuple[str, str, str], every_ns: int, estimators: Sequence[Estimator[Any]]
    ) -> None:
        self.place = place
        self.unit, self.signal, self.run = name
        self._every_ns = every_ns
        self._estimators = list(estimators)
        self.pieces = PieceBuffer(name, every_ns)
        self._decisions = EarlyDecisions(self.signal)
        self._refusal: str | None = None
        self._first_ns: int | None = None
        self._last_ns = 0
        self.judged: tuple[EstimatePublished, ...] = ()  # once finished: the estimates that limits are compared with
        self.decided: tuple[EarlyDecision, ...] = ()  # once finished: the last look at each limit

    @property
    def name(self) -> tuple[str, str, str]:
        """Unit, signal and run."""
        return self.pieces.name

    def apply_limits(self, limits: LimitsApplied) -> None:
        """Decide early on those limits of the run that are on this signal."""
        self._decisions.apply(limits)

    def take(self, batch: WireBatch) -> Documents:
        """Take in the next batch; returns the documents that are due, with the names under which they are published."""
        found: Documents = []
        for piece in self.pieces.take(batch):
            self._take_piece(piece)
            if piece.is_due:
                found += self._documents(final=False)
        return found

    def finish(self) -> Documents:
        """Take in the remaining samples of a run that has ended; returns its last documents, marked final."""
        for piece in self.pieces.rest():
            self._take_piece(piece)
        return self._documents(final=True)

    def _take_piece(self, piece: BufferedPiece) -> None:
        """Update all estimators; a signal that is refused once stays refused."""
        batch = piece.batch
        if self._first_ns is None:
            self._first_ns, self._last_ns = int(batch.time_array[0]), piece.last_ns
        self._last_ns = max(self._last_ns, piece.last_ns)
        if self._refusal is not None:
            return
        try:
            for estimator in self._estimators:
                estimator.update(batch)
            self._decisions.update(batch)
        except GyrofleetError as error:
            self._refusal = str(error)

    def _documents(self, *, final: bool) -> Documents:
        found: Documents = []
        points: dict[str, EstimatePublished] = {}
        for estimator in self._estimators:
            if estimator.has_points:
                points[estimator.key] = document = self._estimate(estimator, final=final)
                found.append((estimator.key, document))
            if final and isinstance(estimator, AllanDeviation):
                found.append((NOISE_COEFFICIENTS, self._noise(estimator, document)))
            elif final and isinstance(estimator, SpectralDensity):
                found.append((SPECTRAL_LINES, self._lines(estimator)))
        # to the end of the last sample's interval, where a test of its planned length is finished
        interval_s = max((estimator.sample_interval_s for estimator in self._estimators), default=0.0)
        elapsed_s = (self._last_ns - (self._first_ns or 0)) / 1e9 + interval_s
        if (since_ns := self._decisions.since_ns) is not None:
            elapsed_s = max(0.0, (self._last_ns - since_ns) / 1e9 + interval_s)
            points = {each.key: self._estimate_of_record(each, final=final) for each in self._decisions.estimators}
        if final:
            exact = self._decisions.exact_points()
            self.judged = tuple(
                msgspec.structs.replace(each, points=(*exact, *each.points)) if key == AllanDeviation.key else each
                for key, each in points.items()
            )
        looks = [
            decision_document(self._head(f"decision-{number}", final=final), *looked)
            for number, looked in enumerate(self._decisions.look(elapsed_s, points))
        ]
        if final:
            self.decided = tuple(looks)
        return [*found, *((EARLY_DECISION, each) for each in looks)]

    def _head(self, what: str, *, final: bool) -> dict[str, Any]:
        name = f"{self.run}/{self.unit}/{self.signal}/{what}/{self._last_ns}/{final}"
        uid = uuid5(_NAMESPACE, name).hex
        return {"run": self.run, "t_ns": self._last_ns, "uid": uid, "unit": self.unit, "signal": self.signal}

    @property
    def unseen_s(self) -> float:
        """Seconds of the record that came too long before its limits to be judged."""
        return self._decisions.unseen_s

    def _estimate(self, estimator: PointEstimator, *, final: bool) -> EstimatePublished:
        estimate = NoEstimate(self._refusal) if self._refusal else estimator.estimate()
        return EstimatePublished(
            **self._head(estimator.key, final=final), estimator=estimator.key,
            unit_of_measure=estimator.unit_of_measure, confidence=estimator.confidence, samples=estimator.samples,
            missing=estimator.missing, sample_interval_s=estimator.sample_interval_s, every_ns=self._every_ns,
            final=final, points=() if isinstance(estimate, NoEstimate) else estimate,
            reason=estimate.reason if isinstance(estimate, NoEstimate) else None,
            longest_still=self._decisions.still.longest,
        )  # fmt: skip

    def _estimate_of_record(self, estimator: PointEstimator, *, final: bool) -> EstimatePublished:
        """An estimate from the samples of a record; its reason says what of the record is not in it."""
        estimate = self._estimate(estimator, final=final)
        if (unseen := self._decisions.unseen) is None:
            return estimate
        return msgspec.structs.replace(estimate, reason="; ".join(filter(None, (estimate.reason, unseen[0]))))

    def _noise(self, allan: AllanDeviation, estimate: EstimatePublished) -> NoiseFitted:
        head = self._head(NOISE_COEFFICIENTS, final=True)
        if allan.unit_of_measure != ANGULAR_RATE_UNIT:
            return NoiseFitted(**head, reason=f"the signal is in {allan.unit_of_measure}, not an angular rate")
        fit = NoEstimate(estimate.reason) if estimate.reason else _fit(estimate)
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
            **head, unit_of_measure=spectral.unit_of_measure,
            lines=tuple(msgspec.to_builtins(line) for line in lines), searched_lo_hz=lo_hz, searched_hi_hz=hi_hz,
            bin_width_hz=spectral.bin_width_hz, segments=spectral.segments,
        )  # fmt: skip

    def export_state(self) -> SignalState:
        """The state, for a checkpoint."""
        return SignalState(
            place=(self.place.site, self.place.station), buffer=self.pieces, first_ns=self._first_ns,
            last_ns=self._last_ns, refusal=self._refusal,
            snapshots=tuple(take_snapshot(estimator) for estimator in self._estimators),
            decisions=self._decisions.export_state(),
        )  # fmt: skip

    @classmethod
    def from_state(cls, state: SignalState) -> Self:
        """Resume from a checkpoint; an EstimatorError if a snapshot in it is damaged or of another version."""
        estimators = [restore(snapshot) for snapshot in state.snapshots]
        analysis = cls(Place(*state.place), state.buffer.name, state.buffer.every_ns, estimators)
        analysis.pieces = state.buffer
        analysis._decisions = EarlyDecisions.from_state(analysis.signal, state.decisions)
        analysis._refusal = state.refusal
        analysis._first_ns, analysis._last_ns = state.first_ns, state.last_ns
        return analysis


def _fit(estimate: EstimatePublished) -> NoiseFit | NoEstimate:
    return fit_noise(estimate.points, held=held_share(estimate.samples, estimate.missing))


def new_estimators(
    factories: Mapping[str, Callable[[], PointEstimator]], *, spectrum: bool = True
) -> list[Estimator[Any]]:
    """One of each estimator, and a spectral density if `spectrum`."""
    return [*(make() for make in factories.values()), *([SpectralDensity()] if spectrum else [])]
