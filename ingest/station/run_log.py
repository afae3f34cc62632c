"""The documents and samples of a procedure's run, and how far it is."""

import dataclasses
import threading
from collections.abc import Iterable, Mapping
from typing import Any
from uuid import UUID, uuid4

from ingest.procedures.plan import PlannedStep
from ingest.run_record import Outcome, RunRecord, document_uid
from ingest.station.run_limits import NO_LIMITS, RunLimits
from ingest.station.run_state import STATE_FILE, StationRunState, check_same, read_station_run
from ingest.station.station import Station
from ingest.station.step_coverage import StepCoverage
from ingest.station_clock import StationClock
from stream import events
from stream.batch import SampleBatch
from stream.delivery.publisher import Sender
from stream.delivery.spool import Spool
from stream.identity import sample_key
from stream.wire.acknowledgement import StreamId


class RunLog(RunRecord[StationRunState]):
    """Sends the documents of one run, from the first to the last, and keeps how far it is.

    Raises BadInput if the run was started as another one; StoreError if its state cannot be read, or, from every
    method, not be written. `plan` is the SHA-256 of the steps.
    """

    def __init__(
        self, run: str, procedure: str, plan: str, units: tuple[str, ...], station: Station, spool: Spool,
        clock: StationClock,
    ) -> None:  # fmt: skip
        found = read_station_run(spool.folder)
        self.is_resumed = found is not None
        if found is None:
            now_ns = clock.now_ns()
            found = StationRunState(run=run, procedure=procedure, plan=plan, units=units, t0_ns=now_ns, seen_ns=now_ns)
        check_same(found, procedure, plan, units)
        super().__init__(found, spool.folder / STATE_FILE, spool, station.place)
        self._station, self._clock, self._limits = station, clock, NO_LIMITS
        self._first: dict[StreamId, int] = {}
        self._counting = threading.Lock()
        self._notes = 0
        self.gap_s = 0.0  # how long nothing was measured before it was resumed, seconds at the station
        self.coverage = StepCoverage(found.units)

    def epoch_of(self, name: str) -> UUID:
        """Epoch of a unit's present power-on."""
        return UUID(self.state.epochs[name])

    def deliver(self, batch: SampleBatch) -> None:
        """Send samples, from the thread of any source; they are numbered on, also where a source counts anew from 0."""
        assert self._sender is not None
        key = sample_key(self.place, batch.unit, batch.signal)
        stream = StreamId(key, batch.epoch.hex)
        if stream not in self._first:
            self._first[stream] = self._spool.position(stream) - batch.seq
        first = self._first[stream]
        if first:
            batch = dataclasses.replace(batch, seq=batch.seq + first)
        self._sender.send_batch(key, batch)
        self.coverage.see(batch)

    def begin(
        self, sender: Sender, mounted: Iterable[events.AnyDocument], about: Mapping[str, str], *, operator: str | None,
        lot: str | None, at: int | None = None, warnings: Iterable[str] = (), limits: RunLimits = NO_LIMITS,
    ) -> None:  # fmt: skip
        """Send the documents with which the run starts or resumes, from the step `at` on.

        `mounted` tells which units are where, `about` further details; `warnings`, of which the operator was warned,
        are noted with a run that starts.
        """
        self._sender, self._limits = sender, limits
        if self.state.phase == "starting":
            self._save()  # killed from here on, it is resumed as the same run
            self._send(
                events.RunStarted(
                    run=self.state.run, t_ns=self.state.t0_ns, uid=self._uid("started"),
                    simulated=self._station.table.simulated, source=f"station {self._station.table.name}",
                    units=self.state.units, procedure=self.state.procedure, details=dict(about), operator=operator,
                    lot=lot,
                )
            )  # fmt: skip
            for document in (*mounted, *limits.at_start(self.state.run, self.state.t0_ns)):
                self._send(document)
            for warning in warnings:
                self.note(warning)
            self._save(phase="running")
        elif self.is_resumed and self.state.phase == "running":
            self._resume(self.state.step if at is None else at)

    def end(self, outcome: Outcome) -> None:
        """Send the document with which the run ends."""
        if self.state.phase == "ended":
            return
        self.end_steps(outcome)
        self._save(phase="ending", outcome=outcome)
        run, now_ns, uid = self.state.run, self._clock.now_ns(), self._uid("ended")
        self._send(events.RunEnded(run=run, t_ns=now_ns, uid=uid, outcome=outcome, totals=self._totals()))

    def note(self, text: str, unit: str | None = None) -> None:
        """Add a note to the run, or to a unit in it; from any thread."""
        with self._counting:
            self._notes += 1
            number = self._notes
        run, t_ns, uid = self.state.run, self._clock.now_ns(), self._uid("note", str(self.state.starts), str(number))
        self._send(events.NoteAdded(run=run, t_ns=t_ns, uid=uid, text=text, author="station", unit=unit))

    def begin_step(self, step: PlannedStep) -> int:
        """Start a recorded step of all units now; the time, nanoseconds."""
        t_ns = self._clock.now_ns()
        settled_ns = t_ns + round(step.settle_s * 1e9)
        self.coverage.begin(settled_ns, settled_ns + round(step.record_s * 1e9))
        uids = {unit: self._uid("step", str(step.number), unit, str(t_ns)) for unit in self.state.units}
        self._save(open_steps=uids)  # first, so that no crash leaves a step that nobody ends
        for document in self._limits.at_record(self.state.run, t_ns, settled_ns, step.record_s):
            self._send(document)
        for unit, uid in uids.items():
            self._send(events.StepStarted(run=self.state.run, t_ns=t_ns, uid=uid, unit=unit, words=step.words))
        return t_ns

    def end_steps(self, outcome: str, t_ns: int | None = None) -> None:
        """End the step that is being recorded, now or at another time; after a completed one the next is due."""
        if self.state.open_steps:
            t_ns = self._clock.now_ns() if t_ns is None else t_ns
            done = outcome == "completed"
            self._save(
                open_steps={}, closed_steps=self.state.open_steps, closed_as=outcome, closed_ns=t_ns,
                step=self.state.step + done, steps_done=self.state.steps_done + done,
            )  # fmt: skip
            self._send_step_ends()

    def pass_step(self) -> None:
        """Complete a step that leaves no data."""
        self._save(step=self.state.step + 1, steps_done=self.state.steps_done + 1)

    def add_short_records(self, units: int) -> None:
        """Count units that delivered too little in a step."""
        self._save(short_records=self.state.short_records + units)

    def mark_seen(self) -> None:
        """Record that the run goes on."""
        self._save()

    def mark_unpowered(self) -> None:
        """Record that the units have, or will have, no power; `power_off` sends it."""
        self._save(is_powered=False)

    def power_on(self) -> None:
        """All units have power: a new epoch of each."""
        epochs = {unit: str(uuid4()) for unit in self.state.units}
        self._save(epochs=epochs, is_powered=True, powered_ns=self._clock.now_ns())
        self._send_power_ons()

    def power_off(self, t_ns: int | None = None) -> None:
        """No unit has power, from now on or from another time; sent once."""
        t_ns = self._clock.now_ns() if t_ns is None else t_ns
        for unit, epoch in self.state.epochs.items():
            uid = self._uid("off", epoch)
            self._send(events.PowerOff(run=self.state.run, t_ns=t_ns, uid=uid, unit=unit, epoch=epoch))
        self._save(is_powered=False, epochs={})

    def _save(self, **changes: Any) -> None:
        super()._save(seen_ns=max(self.state.seen_ns, self._clock.now_ns()), **changes)

    def _resume(self, at: int) -> None:
        now_ns = self._clock.now_ns()
        gap_ns = max(0, now_ns - self.state.seen_ns)  # a clock that was set back says nothing of a gap
        self.gap_s = gap_ns / 1e9
        self._send_step_ends()  # the crash may have come before it
        if self.state.is_powered:
            self._send_power_ons()
        self.end_steps("interrupted", self.state.seen_ns)
        cut = (
            f"step {self.state.step + 1} is begun again" if self.state.closed_as == "interrupted" else "no step was cut"
        )
        back = f", from step {at + 1} on" if at < self.state.step else ""
        self._save(starts=self.state.starts + 1, step=at, steps_done=at)
        reason, uid = f"resumed at step {at + 1}; {cut}{back}", self._uid("resumed", str(self.state.starts))
        self._send(events.RunResumed(run=self.state.run, t_ns=now_ns, uid=uid, gap_ns=gap_ns, reason=reason))

    def _send_step_ends(self) -> None:
        run, t_ns, outcome = self.state.run, self.state.closed_ns, self.state.closed_as
        for unit, step in self.state.closed_steps.items():
            uid = self._uid("step-ended", step)
            self._send(events.StepEnded(run=run, t_ns=t_ns, uid=uid, unit=unit, step_uid=step, outcome=outcome))

    def _send_power_ons(self) -> None:
        for unit, epoch in self.state.epochs.items():
            uid = self._uid("on", epoch)
            self._send(events.PowerOn(run=self.state.run, t_ns=self.state.powered_ns, uid=uid, unit=unit, epoch=epoch))

    def _uid(self, *parts: str) -> str:
        return document_uid("/".join(["gyrofleet:station-run", self.state.run, str(self.state.t0_ns), *parts]))
