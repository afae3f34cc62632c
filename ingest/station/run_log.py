"""The documents and samples of a procedure's run, and how far it is."""

import dataclasses
import datetime as dt
import string
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any
from uuid import UUID, uuid4

import msgspec

from ingest.procedures.plan import PlannedStep
from ingest.run_record import Outcome, Phase, RunRecord, document_uid, read_state
from ingest.station.checks.step_coverage import StepCoverage
from ingest.station.delivery_account import DeliveryAccount
from ingest.station.releases import Release
from ingest.station.run_limits import NO_LIMITS, RunLimits
from ingest.station.station import Station
from ingest.station_clock import StationClock
from storage.recording.command_box import CommandAnswer, RunCommand
from storage.recording.run_command import answered_document, given_document
from stream import events
from stream.batch import SampleBatch
from stream.delivery.publisher import Sender
from stream.delivery.spool import Spool, spool_is_held
from stream.errors import BadInput
from stream.identity import sample_key
from stream.security.actor import UNAUTHENTICATED
from stream.security.credentials import process_security
from stream.wire.acknowledgement import StreamId

STATE_FILE = "procedure.json"
_COMMANDS_KEPT = 50


class DecidedCommand(msgspec.Struct, frozen=True, kw_only=True):
    """A command of somebody elsewhere, and its answers in their order, each with its time at the station."""

    command: RunCommand
    taken_ns: int
    answers: tuple[tuple[CommandAnswer, int], ...]


class StationRunState(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A procedure's run as it stands."""

    format: int = 1
    run: str  # its id
    procedure: str
    plan: str  # SHA-256 of its steps as they were planned
    units: tuple[str, ...]  # serial numbers
    t0_ns: int  # the station's clock when it started
    seen_ns: int  # the station's clock when it was last seen going on
    starts: int = 1  # how many processes have worked on it
    phase: Phase = "starting"
    outcome: Outcome = "completed"
    step: int = 0  # index of the step that is worked on
    open_steps: dict[str, str] = {}  # identity of the document of the step that is being recorded, by unit
    epochs: dict[str, str] = {}  # epoch of every unit's power-on by unit; none for one that is off
    steps_done: int = 0
    is_powered: bool = False  # whether the units have power
    powered_ns: int = 0  # since when
    closed_steps: dict[str, str] = {}  # identity of the document of the last step, by unit; sent again after a crash
    closed_as: str = ""  # how it ended
    closed_ns: int = 0  # when it ended
    short_records: int = 0  # records of a unit in a step that lack samples
    released: dict[str, Release] = {}  # units that were released, since their limits are decided
    released_steps: dict[str, str] = {}  # identity of the document of the step that each was released from
    unpowered: dict[str, int] = {}  # released units whose supply is off, and since when
    is_paused: bool = False
    aborted_by: str | None = None  # identity of the command that aborts it
    commands: dict[str, DecidedCommand] = {}  # the last ones, by identity; none is carried out twice


def read_station_run(folder: Path) -> StationRunState | None:
    """The run that is kept in a folder; None where there is none. Raises StoreError if it cannot be read."""
    return read_state(folder / STATE_FILE, StationRunState)


def check_same(state: StationRunState, procedure: str, plan: str, units: tuple[str, ...]) -> None:
    """Raise BadInput where a run that is to be resumed was started as another one."""
    if state.procedure != procedure:
        raise BadInput(f"run {state.run} is one of procedure {state.procedure}, not {procedure}: give another --run")
    if set(state.units) != set(units):
        added, gone = sorted(set(units) - set(state.units)), sorted(set(state.units) - set(units))
        raise BadInput(
            f"run {state.run} was started with other units (new now: {', '.join(added) or 'none'}; gone: "
            f"{', '.join(gone) or 'none'}): give the same --units, or another --run"
        )
    if state.plan != plan and state.phase == "ended":
        raise BadInput(f"run {state.run} has ended ({state.outcome}): give another --run, or none, to measure again")
    if state.plan != plan:
        raise BadInput(
            f"run {state.run} was started with other steps of {procedure}: give the same --set and the same file, or "
            f"another --run"
        )


def unfinished_runs(spool: Path) -> list[StationRunState]:
    """Runs of procedures in a store's spool that have not ended, in the order of their start."""
    found = [read_station_run(path.parent) for path in sorted(spool.glob(f"*/{STATE_FILE}"))]
    return sorted((each for each in found if each is not None and each.phase != "ended"), key=lambda each: each.t0_ns)


def left_run(spools: Path, procedure: str, units: tuple[str, ...]) -> str | None:
    """The run of this procedure and these units that is to be resumed; None where there is none."""
    wanted = [each for each in unfinished_runs(spools) if each.procedure == procedure and set(each.units) == set(units)]
    return wanted[0].run if wanted else None


def other_unfinished(spools: Path, procedure: str, run: str, own: Collection[str]) -> Iterator[str]:
    """A warning for each run of this procedure that was left unfinished with other units, or is at work with `own`."""
    for state in unfinished_runs(spools):
        if state.run != run and spool_is_held(spools / state.run):
            if both := sorted(set(own).intersection(state.units)):
                yield f"warning: run {state.run} is at work with {', '.join(both[:4])} as well: is a unit named twice?"
        elif state.procedure == procedure and state.run != run:
            units = f"{', '.join(state.units[:4])}{' and others' if len(state.units) > 4 else ''}"
            yield (
                f"warning: run {state.run} of {units} was left unfinished at step {state.step + 1}; give its --units "
                "to resume it, with --end to end it"
            )


def fresh_id(spools: Path, procedure: str, day: dt.date) -> str:
    """A run's id: the day, the procedure and a letter."""
    letters = string.ascii_uppercase
    for n in range(26 * 26):
        name = f"{day}-{procedure}-{letters[n // 26 - 1] if n >= 26 else ''}{letters[n % 26]}"
        if not any((spools / name).glob("*.json")):  # a run was begun there
            return name
    raise BadInput(f"there are {26 * 26} runs of {procedure} on {day}: give this one a name with --run")


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
        self.faults: tuple[str, ...] = ()  # of the units' sources now, as sentences
        self.late_samples = 0  # of units that were released; not recorded
        self.coverage = StepCoverage(self.units_left)
        self.account = DeliveryAccount(clock)
        self.keep_waiting: Callable[[bool], None] = lambda _: None  # for room in a full spool, or not without end

    @property
    def units_left(self) -> tuple[str, ...]:
        """Units that are not released."""
        return tuple(unit for unit in self.state.units if unit not in self.state.released)

    def epoch_of(self, name: str) -> UUID:
        """Epoch of a unit's present power-on."""
        return UUID(self.state.epochs[name])

    def deliver(self, batch: SampleBatch) -> None:
        """Send samples, from the thread of any source; they are numbered on, also where a source restarts at 0."""
        assert self._sender is not None
        if batch.unit in self.state.released:  # another unit may be in its slot by now
            self.late_samples += len(batch)
            return
        key = sample_key(self.place, batch.unit, batch.signal)
        stream = StreamId(key, batch.epoch.hex)
        if stream not in self._first:
            self._first[stream] = self._spool.position(stream) - batch.seq
        first = self._first[stream]
        if first:
            batch = dataclasses.replace(batch, seq=batch.seq + first)
        with self.account.delivering(batch):
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
        self._send(
            events.RunEnded(
                run=run, t_ns=now_ns, uid=uid, outcome=outcome, totals=self._totals(),
                released=len(self.state.released), saved_s=self.saved_s,
            )
        )  # fmt: skip

    def note(self, text: str, unit: str | None = None) -> None:
        """Add a note to the run, or to a unit in it; from any thread."""
        with self._counting:
            self._notes += 1
            number = self._notes
        run, t_ns, uid = self.state.run, self._clock.now_ns(), self._uid("note", str(self.state.starts), str(number))
        self._send(events.NoteAdded(run=run, t_ns=t_ns, uid=uid, text=text, author="station", unit=unit))

    def enter_note(self, note: events.NoteAdded) -> None:
        """Enter a person's note, with the station's time; entered twice, it is the same."""
        # the station's certificate proves that it had the note, not whose it is
        identity = UNAUTHENTICATED if process_security().credentials is not None else note.identity
        self._send(msgspec.structs.replace(note, t_ns=self._clock.now_ns(), identity=identity))

    def begin_step(self, step: PlannedStep) -> int:
        """Start a recorded step of all units now; the time, nanoseconds."""
        t_ns = self._clock.now_ns()
        settled_ns = t_ns + round(step.settle_s * 1e9)
        self.coverage.begin(settled_ns, settled_ns + round(step.record_s * 1e9))
        uids = {unit: self._uid("step", str(step.number), unit, str(t_ns)) for unit in self.units_left}
        self._save(open_steps=uids)  # first, so that no crash leaves a step that nobody ends
        for document in self._limits.at_record(self.state.run, t_ns, settled_ns, step.record_s):
            if document.unit not in self.state.released:
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

    def release(self, release: Release) -> None:
        """Release a unit from the step that is being recorded: its record ends."""
        open_steps = dict(self.state.open_steps)
        uid = open_steps.pop(release.unit)
        self.coverage.release(release.unit)
        self._save(
            open_steps=open_steps, released=self.state.released | {release.unit: release},
            released_steps=self.state.released_steps | {release.unit: uid},
        )  # fmt: skip
        self._send_release(release)

    def release_power(self, units: Iterable[str]) -> None:
        """The supplies of these released units are off."""
        now_ns = self._clock.now_ns()
        self._save(unpowered=self.state.unpowered | dict.fromkeys(units, now_ns))
        self._send_released_power_offs()

    @property
    def saved_s(self) -> float:
        """By how much the records of released units together are shorter than planned."""
        return sum(each.saved_s for each in self.state.released.values())

    def savings(self) -> Iterator[str]:
        """What the releases have saved, each as a sentence."""
        released = self.state.released.values()
        if released:
            hours = self.saved_s / 3600.0
            yield f"{len(released)} of {len(self.state.units)} units were decided early: {hours:,.1f} unit hours saved"
            if not self.units_left:
                spared = min(each.saved_s for each in released) / 3600.0
                yield f"the station is free {spared:,.1f} h early"
        if self.late_samples:
            yield f"{self.late_samples:,} samples came from units that were released; they are not recorded"

    def mark_paused(self, *, is_paused: bool) -> None:
        """Record that the run is paused, or goes on; killed while it is paused, it stays so."""
        if self.state.is_paused != is_paused:
            self._save(is_paused=is_paused)

    def command_answer(self, command_id: str) -> CommandAnswer | None:
        """The last answer to a command; None if it is not decided yet."""
        decided = self.state.commands.get(command_id)
        return None if decided is None else decided.answers[-1][0]

    def decide_command(self, command: RunCommand, answer: CommandAnswer) -> None:
        """Record what is done with a command and what it does to the run, as one, and send it."""
        now_ns = self._clock.now_ns()
        decided = DecidedCommand(command=command, taken_ns=now_ns, answers=((answer, now_ns),))
        kept = dict(list(self.state.commands.items())[1 - _COMMANDS_KEPT :]) | {command.id: decided}
        effect: dict[str, Any] = {}
        if answer.outcome in {events.CommandOutcome.ACCEPTED, events.CommandOutcome.DONE}:
            is_abort = command.action is events.RunAction.ABORT
            is_pause = command.action is events.RunAction.PAUSE
            effect = {"aborted_by": command.id} if is_abort else {"is_paused": is_pause}
        self._save(commands=kept, **effect)
        self._send_command(decided)

    def complete_command(self, command_id: str, answer: CommandAnswer) -> None:
        """Record and send the final answer to a command that was accepted; once."""
        decided = self.state.commands[command_id]
        if all(each.outcome is not answer.outcome for each, _ in decided.answers):
            decided = msgspec.structs.replace(decided, answers=(*decided.answers, (answer, self._clock.now_ns())))
            self._save(commands=self.state.commands | {command_id: decided})
        self._send_command(decided)

    def _send_command(self, decided: DecidedCommand) -> None:
        self._send(given_document(decided.command, decided.taken_ns))
        for answer, t_ns in decided.answers:
            self._send(answered_document(decided.command, answer, t_ns))

    def _send_release(self, release: Release) -> None:
        run, unit, t_ns = self.state.run, release.unit, release.t_ns
        step = self.state.released_steps[unit]
        uid = self._uid("step-ended", step)
        self._send(events.StepEnded(run=run, t_ns=t_ns, uid=uid, unit=unit, step_uid=step))
        self._send(
            events.UnitReleased(
                run=run, t_ns=t_ns, uid=self._uid("released", unit), unit=unit, verdict=release.verdict,
                planned_s=release.planned_s, recorded_s=release.recorded_s, slot=release.slot,
            )
        )  # fmt: skip

    def _send_released_power_offs(self) -> None:
        for unit, t_ns in self.state.unpowered.items():
            if (epoch := self.state.epochs.get(unit)) is not None and t_ns >= self.state.powered_ns:
                uid = self._uid("off", epoch)
                self._send(events.PowerOff(run=self.state.run, t_ns=t_ns, uid=uid, unit=unit, epoch=epoch))

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
            if unit not in self.state.unpowered:
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
        for release in self.state.released.values():
            self._send_release(release)
        for decided in self.state.commands.values():
            self._send_command(decided)
        if self.state.is_powered:
            self._send_power_ons()
            self._send_released_power_offs()
        self.end_steps("interrupted", self.state.seen_ns)
        again = f"step {self.state.step + 1} is begun again"
        cut = again if self.state.closed_as == "interrupted" else "no step was cut"
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
            if unit in self.state.unpowered and self.state.powered_ns > self.state.unpowered[unit]:
                continue  # it has stayed off
            uid = self._uid("on", epoch)
            self._send(events.PowerOn(run=self.state.run, t_ns=self.state.powered_ns, uid=uid, unit=unit, epoch=epoch))

    def _uid(self, *parts: str) -> str:
        return document_uid("/".join(["gyrofleet:station-run", self.state.run, str(self.state.t0_ns), *parts]))
