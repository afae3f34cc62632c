"""Compensation of all signals with live error models: batches and documents in and out."""

from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from uuid import UUID, uuid5

from analytics.loop.live.epoch_compensation import PATIENCE_BATCHES, PATIENCE_S, SUFFIX, EpochCompensation
from analytics.loop.model.live_terms import live_part, needed_channels
from analytics.loop.model.model_registry import ModelRegistry, ModelVersion
from analytics.loop.model.model_use import InUse, Uses
from stream import events
from stream.batch import SampleBatch
from stream.errors import GyrofleetError
from stream.identity import Place

_OWN, _INSTRUMENT, _SUPPOSED = 2, 1, 0
_KEPT_NS = round(PATIENCE_S * 1e9)
_AUTHOR = "gyrofleet compensate"

Out = tuple[Place, SampleBatch | events.AnyDocument]  # output, and the station that it belongs to


@dataclass
class _Run:
    place: Place
    epochs: dict[tuple[str, str, str], EpochCompensation] = field(default_factory=dict)
    power_ons: dict[tuple[str, str], int] = field(default_factory=dict)
    kept: dict[tuple[str, str], deque[SampleBatch]] = field(default_factory=dict)
    longest_ns: dict[tuple[str, str], int] = field(default_factory=dict)
    units: set[str] = field(default_factory=set)
    next_seq: dict[tuple[str, str, str], int] = field(default_factory=dict)
    positions: set[str] = field(default_factory=set)
    refused: set[tuple[str, str, str]] = field(default_factory=set)
    ended: events.RunEnded | None = None


class LiveCompensator:
    """Compensates every signal that has a live error model, power-on by power-on.

    A power-on keeps the model that is live at its first sample: a promotion or rollback acts from the next power-on or
    run on. `uses` are the models in use at the start; later activations arrive as documents. `begun` has the hash of
    the model of each compensation that has started, by run, unit, signal and epoch (hexadecimal).

    A channel is the unit's own signal of that name, else that of the only instrument of the run that has it.
    ``table_rate`` replaces a missing ``input_rate`` unless a step gives a position or axis. The channel readings of the
    last ten minutes are kept for a power-on whose first sample arrives after them.
    """

    def __init__(
        self, registry: ModelRegistry, uses: Uses, begun: Mapping[tuple[str, str, str, str], str] | None = None
    ) -> None:
        self._registry = registry
        self._uses = dict(uses)
        self._begun = dict(begun or {})
        self._versions: dict[tuple[str, str], ModelVersion] = {}
        self._runs: dict[str, _Run] = {}
        self._wanted_now: frozenset[str] | None = None
        self.samples = 0

    def take(self, place: Place, batch: SampleBatch) -> list[Out]:
        """Add samples; the output that is ready."""
        if batch.signal.endswith(SUFFIX):
            return []
        run = self._run(batch.run, place)
        stream = (batch.unit, batch.signal, batch.epoch.hex)
        run.next_seq[stream] = max(batch.next_seq, run.next_seq.get(stream, 0))
        out: list[Out] = []
        if stream not in run.epochs and stream not in run.refused:
            out += self._begin(place, run, batch)
        if (own := run.epochs.get(stream)) is not None:
            own.take(batch)
            self.samples += len(batch)
            out += self._ready(place, own)
        out += self._offer(place, run, batch)
        return out + self._finish_if_complete(run)

    def take_document(self, place: Place, document: events.AnyDocument) -> list[Out]:
        """Add a document; the output that is ready."""
        match document:
            case events.ModelActivated():
                whose = (document.unit, document.signal)
                self._uses[whose] = self._uses.get(whose, InUse()).after(document)
                self._wanted_now = None
            case events.RunStarted():
                self._run(document.run, place).units.update(document.units)
            case events.UnitMounted():
                self._run(document.run, place).units.add(document.unit)
            case events.PowerOn():
                run = self._run(document.run, place)
                run.units.add(document.unit)
                run.power_ons[document.unit, document.epoch.replace("-", "")] = document.t_ns
            case events.StepStarted() if document.words.position is not None or document.words.axis is not None:
                self._run(document.run, place).positions.add(document.unit)
            case events.RunEnded() if document.run in self._runs:
                run = self._runs[document.run]
                run.ended = document
                return self._finish_if_complete(run)
        return []

    def _run(self, name: str, place: Place) -> _Run:
        return self._runs.setdefault(name, _Run(place))

    def finish(self, run_name: str) -> list[Out]:
        """End a run that is complete; its remaining output."""
        run = self._runs.pop(run_name, None)
        if run is None:
            return []
        out: list[Out] = []
        for own in run.epochs.values():
            out += [(run.place, _cannot(own))] if own.lacking else []
            out += [(run.place, batch) for batch in own.due(is_last=True)]
        return out

    def totals(self, run_name: str) -> tuple[events.StreamTotal, ...]:
        """Numbers of compensated samples of a run if it is complete."""
        epochs = self._runs[run_name].epochs if run_name in self._runs else {}
        return tuple(
            events.StreamTotal(unit=unit, signal=own.signal, epoch=str(own.epoch), samples=own.next_seq - own.first_seq)
            for (unit, _, _), own in epochs.items()
            if not own.lacking
        )

    def _begin(self, place: Place, run: _Run, batch: SampleBatch) -> list[Out]:
        """Start the compensation of a power-on if it has a model."""
        stream = (batch.unit, batch.signal, batch.epoch.hex)
        model = self._begun.get((batch.run, *stream))
        is_begun = model is not None
        if model is None:
            live = self._uses.get((batch.unit, batch.signal), InUse()).live
            model = None if live is None else live.model
        if model is None:
            run.refused.add(stream)
            return []
        try:
            version = self._version(batch.unit, model)
            own = EpochCompensation(version, batch, run.power_ons.get((batch.unit, batch.epoch.hex)))
        except GyrofleetError as error:
            run.refused.add(stream)
            uid = uuid5(batch.epoch, f"{batch.run}/refused").hex
            note = events.NoteAdded(
                run=batch.run, t_ns=batch.t0_ns, text=str(error), author=_AUTHOR, unit=batch.unit, uid=uid
            )
            return [(place, note)]
        run.units.add(batch.unit)
        run.epochs[stream] = own
        for kept in run.kept.values():
            for readings in kept:
                self._give(run, batch.unit, own, readings)
        if is_begun:
            return []
        started = events.CompensationStarted(
            run=batch.run,
            t_ns=batch.t0_ns,
            uid=own.epoch.hex,
            unit=batch.unit,
            signal=batch.signal,
            epoch=str(batch.epoch),
            model=model,
            version=version.version,
            compensated=own.signal,
            compensated_epoch=str(own.epoch),
            first_seq=own.first_seq,
        )
        return [(place, started)]

    def _version(self, unit: str, model: str) -> ModelVersion:
        if (unit, model) not in self._versions:
            self._versions[unit, model] = self._registry.by_hash(unit, model)
            self._wanted_now = None
        return self._versions[unit, model]

    def _offer(self, place: Place, run: _Run, batch: SampleBatch) -> list[Out]:
        """Pass readings to the compensations that need them, and keep recent ones for later power-ons."""
        if batch.signal not in self._wanted():
            return []
        kept = run.kept.setdefault((batch.unit, batch.signal), deque())
        kept.append(batch)
        longest_ns = max(run.longest_ns.get((batch.unit, batch.signal), 0), batch.last_ns - batch.t0_ns)
        run.longest_ns[batch.unit, batch.signal] = longest_ns
        while kept[0].last_ns < batch.last_ns - max(_KEPT_NS, round(PATIENCE_BATCHES * longest_ns)):
            kept.popleft()
        out: list[Out] = []
        for (unit, _, _), own in run.epochs.items():
            if self._give(run, unit, own, batch):
                out += self._ready(place, own)
        return out

    def _wanted(self) -> frozenset[str]:
        """Signals that any live model reads."""
        if self._wanted_now is None:
            for (unit, _), use in self._uses.items():
                if use.live is not None:
                    with suppress(GyrofleetError):  # reported when the compensation of the unit starts
                        self._version(unit, use.live.model)
            self._wanted_now = frozenset(name for each in self._versions.values() for name in _names(each))
        return self._wanted_now

    @staticmethod
    def _give(run: _Run, unit: str, own: EpochCompensation, batch: SampleBatch) -> bool:
        """Pass a batch to a compensation if it is one of its channels."""
        if batch.unit != unit and batch.unit in run.units:
            return False  # a signal of another unit under test
        if batch.signal in own.channels:
            own.take_reading(batch.signal, batch, _OWN if batch.unit == unit else _INSTRUMENT)
            return True
        if batch.signal == "table_rate" and "input_rate" in own.channels and unit not in run.positions:
            own.take_reading("input_rate", batch, _SUPPOSED)
            return True
        return False

    @staticmethod
    def _ready(place: Place, own: EpochCompensation) -> list[Out]:
        out: list[Out] = [(place, batch) for batch in own.due()]
        return out + [(place, _stopped(own, name, at_s)) for name, at_s in own.newly_held().items()]

    def _finish_if_complete(self, run: _Run) -> list[Out]:
        """End a run if its end and all its samples have arrived."""
        if run.ended is None:
            return []
        for total in run.ended.totals:
            reached = run.next_seq.get((total.unit, total.signal, total.epoch.replace("-", "")), 0)
            if not total.signal.endswith(SUFFIX) and reached < total.samples:
                return []
        return self.finish(run.ended.run)


def lacking_uid(epoch: UUID) -> str:
    """Identity of the note that an epoch is not compensated, since a channel is missing."""
    return uuid5(epoch, "lacking").hex


def _names(version: ModelVersion) -> tuple[str, ...]:
    names = needed_channels(live_part(version.model))
    return (*names, "table_rate") if "input_rate" in names else names


def _cannot(own: EpochCompensation) -> events.NoteAdded:
    lacking = "; ".join(f"channel {name}: {why}" for name, why in own.lacking.items())
    return _note(
        own,
        lacking_uid(own.epoch),
        f"is not compensated: version {own.version.version} of its error model needs {lacking}; record it once, or "
        "remove the term from the model",
    )


def _stopped(own: EpochCompensation, name: str, at_s: float) -> events.NoteAdded:
    return _note(
        own,
        uuid5(own.epoch, f"{name} stops").hex,
        f"is compensated with the last reading of channel {name} from now on: it stops at {at_s:.0f} s and has been "
        f"missing for {own.patience_s:.0f} s; check its source",
    )


def _note(own: EpochCompensation, uid: str, text: str) -> events.NoteAdded:
    whole = f"run {own.run}, unit {own.unit}: {own.signal.removesuffix(SUFFIX)} {text}"
    return events.NoteAdded(run=own.run, t_ns=own.t0_ns, text=whole, author=_AUTHOR, unit=own.unit, uid=uid)
