"""The documents and samples of a procedure's run, and how far it is: what is sent, and what is remembered."""

import dataclasses
import threading
from collections.abc import Iterable, Mapping
from functools import partial
from uuid import NAMESPACE_URL, UUID, uuid4, uuid5

from msgspec.structs import replace

from ingest.procedures.procedure import PlannedStep
from ingest.station.run_state import Outcome, StationRunState, check_same, read_station_run, write_station_run
from ingest.station.station import Station
from ingest.station.step_coverage import StepCoverage
from ingest.station_clock import StationClock
from stream.batch import SampleBatch
from stream.delivery.publisher import Sender
from stream.delivery.spool import Spool
from stream.events import (
    AnyDocument,
    NoteAdded,
    PowerOff,
    PowerOn,
    RunEnded,
    RunResumed,
    RunStarted,
    StepEnded,
    StepStarted,
    StreamTotal,
)
from stream.identity import SampleKey, event_key, parse_key, sample_key
from stream.wire.acknowledgement import StreamId


class RunLog:
    """What is said of one run, from its first document to its last, taken up where it is.

    Parameters
    ----------
    run: Its id.
    procedure, plan: Name of the procedure, and the SHA-256 of its steps.
    units: Serial numbers.
    station: Where.
    spool: Where everything that is sent is kept until it is recorded; the run's state lies in its folder.
    clock: The station's clock.

    Raises
    ------
    BadInput: If the run was started as another one.
    StoreError: If its state cannot be read, or, from every method, not be written.

    Attributes
    ----------
    state: How far it is.
    is_resumed: Whether another process began it.
    gap_s: How long nothing was measured before it was taken up, seconds at the station.
    coverage: What units deliver in the step that is recorded.
    """

    def __init__(
        self, run: str, procedure: str, plan: str, units: tuple[str, ...], station: Station, spool: Spool,
        clock: StationClock,
    ) -> None:  # fmt: skip
        self._station = station
        self._spool = spool
        self._clock = clock
        found = read_station_run(spool.folder)
        self.is_resumed = found is not None
        if found is None:
            now_ns = clock.now_ns()
            found = StationRunState(run=run, procedure=procedure, plan=plan, units=units, t0_ns=now_ns, seen_ns=now_ns)
        check_same(found, procedure, plan, units)
        self.state = found
        self.gap_s = 0.0
        self._first: dict[StreamId, int] = {}
        self._counting = threading.Lock()
        self.coverage = StepCoverage(found.units)
        self._sender: Sender | None = None
        self._uid = partial(_uid, f"{run}/{found.t0_ns}")
        self._notes = 0

    @property
    def samples(self) -> int:
        """Samples of the run so far, whichever process has sent them."""
        return sum(total.samples for total in self._all_totals())

    def epoch_of(self, unit: str) -> UUID:
        """Epoch of a unit's present power-on."""
        return UUID(self.state.epochs[unit])

    def deliver(self, batch: SampleBatch) -> None:
        """Send samples of a source; from its thread. After an interruption their numbers go on."""
        assert self._sender is not None
        key = sample_key(self._station.place, batch.unit, batch.signal)
        stream = StreamId(key, batch.epoch.hex)
        if stream not in self._first:
            self._first[stream] = self._spool.position(stream) - batch.seq
        first = self._first[stream]
        if first:
            batch = dataclasses.replace(batch, seq=batch.seq + first)
        self._sender.send_batch(key, batch)
        self.coverage.see(batch)

    def begin(
        self,
        sender: Sender,
        mounted: Iterable[AnyDocument],
        about: Mapping[str, str],
        *,
        operator: str | None,
        lot: str | None,
        at: int | None = None,
        warnings: Iterable[str] = (),
    ) -> None:
        """Send the documents with which the run starts, or goes on.

        Parameters
        ----------
        sender: Takes documents and samples, from now on.
        mounted: Which units are where.
        about: What else is to be remembered of the run.
        operator, lot: Who is responsible, and the production lot.
        at: Index of the step that it goes on with; by default that at which it was.
        warnings: What people were warned of; remembered with a run that starts.
        """
        self._sender = sender
        if self.state.phase == "starting":
            self.save()  # killed from here on, it is taken up as the same run
            self._send(
                RunStarted(
                    run=self.state.run,
                    t_ns=self.state.t0_ns,
                    uid=self._uid("started"),
                    simulated=self._station.table.simulated,
                    source=f"station {self._station.table.name}",
                    units=self.state.units,
                    procedure=self.state.procedure,
                    details=dict(about),
                    operator=operator,
                    lot=lot,
                )
            )
            for document in mounted:
                self._send(document)
            for warning in warnings:
                self.note(warning)
        elif self.is_resumed and self.state.phase == "running":
            self._resume(self.state.step if at is None else at)
        if self.state.phase == "starting":
            self.save(phase="running")

    def end(self, outcome: Outcome) -> None:
        """Send the document with which the run ends."""
        if self.state.phase == "ended":
            return
        self.end_steps(outcome)
        self.save(phase="ending", outcome=outcome)
        self._send(
            RunEnded(
                run=self.state.run,
                t_ns=self._clock.now_ns(),
                uid=self._uid("ended"),
                outcome=outcome,
                totals=self._all_totals(),
            )
        )

    def close(self) -> None:
        """Remember that a recorder has everything."""
        self.save(phase="ended")

    def note(self, text: str, unit: str | None = None) -> None:
        """Have something remembered with the run, or with a unit in it; from any thread."""
        with self._counting:
            self._notes += 1
            number = self._notes
        uid = self._uid("note", str(self.state.starts), str(number))
        now_ns = self._clock.now_ns()
        self._send(NoteAdded(run=self.state.run, t_ns=now_ns, uid=uid, text=text, author="station", unit=unit))

    def begin_step(self, step: PlannedStep) -> int:
        """Say that a step begins for all units now; when that is, nanoseconds."""
        t_ns = self._clock.now_ns()
        settled_ns = t_ns + round(step.settle_s * 1e9)
        self.coverage.begin(settled_ns, settled_ns + round(step.record_s * 1e9))
        uids = {unit: self._uid("step", str(step.number), unit, str(t_ns)) for unit in self.state.units}
        self.save(open_steps=uids)  # first, so that no crash leaves a step that nobody ends
        for unit, uid in uids.items():
            self._send(StepStarted(run=self.state.run, t_ns=t_ns, uid=uid, unit=unit, words=step.words))
        return t_ns

    def end_steps(self, outcome: str, t_ns: int | None = None) -> None:
        """Say how the step that is being recorded has ended, now or at another time; completed, the next one is due."""
        if self.state.open_steps:
            t_ns = self._clock.now_ns() if t_ns is None else t_ns
            self.save(
                open_steps={}, closed_steps=self.state.open_steps, closed_as=outcome, closed_ns=t_ns,
                step=self.state.step + (outcome == "completed"),
                steps_done=self.state.steps_done + (outcome == "completed"),
            )  # fmt: skip
            self._say_closed()

    def power_on(self) -> None:
        """All units have power: a new epoch of each."""
        epochs = {unit: str(uuid4()) for unit in self.state.units}
        self.save(epochs=epochs, is_powered=True, powered_ns=self._clock.now_ns())
        self._say_powered()

    def power_off(self, t_ns: int | None = None) -> None:
        """No unit has power, from now on or from another time; said once."""
        t_ns = self._clock.now_ns() if t_ns is None else t_ns
        for unit, epoch in self.state.epochs.items():
            self._send(PowerOff(run=self.state.run, t_ns=t_ns, uid=self._uid("off", epoch), unit=unit, epoch=epoch))
        self.save(is_powered=False, epochs={})

    def save(self, **changes: object) -> None:
        """Remember how far the run is."""
        seen_ns = max(self.state.seen_ns, self._clock.now_ns())
        self.state = write_station_run(self._spool.folder, replace(self.state, seen_ns=seen_ns, **changes))

    def _resume(self, at: int) -> None:
        now_ns = self._clock.now_ns()
        gap_ns = max(0, now_ns - self.state.seen_ns)  # a clock that was set back says nothing of a gap
        self.gap_s = gap_ns / 1e9
        self._say_closed()  # the crash may have come before it
        if self.state.is_powered:
            self._say_powered()
        self.end_steps("interrupted", self.state.seen_ns)
        again = f"step {self.state.step + 1} is begun again"
        cut = again if self.state.closed_as == "interrupted" else "no step was cut"
        back = f", from step {at + 1} on" if at < self.state.step else ""
        self.save(starts=self.state.starts + 1, step=at, steps_done=at)
        self._send(
            RunResumed(
                run=self.state.run,
                t_ns=now_ns,
                uid=self._uid("resumed", str(self.state.starts)),
                gap_ns=gap_ns,
                reason=f"taken up again at step {at + 1}; {cut}{back}",
            )
        )

    def _say_closed(self) -> None:
        state = self.state
        for unit, uid in state.closed_steps.items():
            self._send(
                StepEnded(
                    run=state.run, t_ns=state.closed_ns, uid=self._uid("step-ended", uid), unit=unit, step_uid=uid,
                    outcome=state.closed_as,
                )
            )  # fmt: skip

    def _say_powered(self) -> None:
        for unit, epoch in self.state.epochs.items():
            uid = self._uid("on", epoch)
            self._send(PowerOn(run=self.state.run, t_ns=self.state.powered_ns, uid=uid, unit=unit, epoch=epoch))

    def _all_totals(self) -> tuple[StreamTotal, ...]:
        """Of every stream of the run, whichever process has sent it, how many samples there are in all."""
        totals = []
        for stream, state in self._spool.streams.items():
            key = parse_key(stream.key)
            if isinstance(key, SampleKey):
                epoch = str(UUID(stream.epoch))
                totals.append(StreamTotal(unit=key.unit, signal=key.signal, epoch=epoch, samples=state.appended))
        return tuple(sorted(totals, key=lambda total: (total.unit, total.signal, total.epoch)))

    def _send(self, document: AnyDocument) -> None:
        assert self._sender is not None
        self._sender.send_event(event_key(self._station.place), document)


def _uid(*parts: str) -> str:
    return uuid5(NAMESPACE_URL, "gyrofleet:station-run/" + "/".join(parts)).hex
