"""A run of simulated units: its documents, its samples at their pace, and how it resumes after an interruption."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from ingest.moment import moment_ns
from ingest.run_record import Outcome, Phase, RunRecord, document_uid, read_state, write_state
from ingest.simulator.demo_fleet import station_fleet
from ingest.simulator.station import PowerCycle, SimulatedStation
from stream.batch import SampleBatch
from stream.delivery.publisher import Sender
from stream.delivery.spool import Spool
from stream.errors import BadInput
from stream.events import NoteAdded, PowerOn, RunEnded, RunResumed, RunStarted, StepEnded, StepStarted, StepWords
from stream.identity import Place, sample_key
from stream.wire.acknowledgement import StreamId

RUN_FILE = "run.json"


class RunParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a run was started with; `speed` 0 is as fast as possible, `start` the moment of its first samples."""

    simulate: int
    rate_hz: float
    batch: int
    hours: float
    speed: float
    seed: int
    site: str
    station: str
    procedure: str | None = None
    position: str | None = None
    operator: str | None = None
    lot: str | None = None
    start: str | None = None


class RunState(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A run as it stands."""

    format: int = 1
    run: str  # its id
    parameters: RunParameters  # what it was started with
    began_ns: int  # the station's clock when it was started
    t0_ns: int  # time of its first sample
    starts: int = 1  # how many processes have worked on it
    power_cycles: tuple[PowerCycle, ...] = msgspec.field(name="power_ups")  # as written by earlier versions
    phase: Phase = "starting"
    outcome: Outcome = "completed"


def begin_run(run: str, parameters: RunParameters, now_ns: int) -> RunState:
    """A run that starts now, or at `start`, so that no sample lies in the future; raises BadInput if it is none."""
    duration_ns = round(parameters.hours * 3600e9)
    lasts_ns = round(duration_ns / parameters.speed) if parameters.speed else 0
    t0_ns = now_ns - max(0, duration_ns - lasts_ns) if parameters.start is None else moment_ns(parameters.start)
    return RunState(run=run, parameters=parameters, began_ns=now_ns, t0_ns=t0_ns, power_cycles=(PowerCycle(0, t0_ns),))


def read_run(folder: Path, run: str, parameters: RunParameters) -> RunState | None:
    """The run kept in a folder, None without one; raises BadInput if it is another, StoreError if unreadable."""
    state = read_state(folder / RUN_FILE, RunState)
    if state is None:
        return None
    if state.run != run:
        raise BadInput(f"{folder} is the spool of run {state.run}, not of {run}: give --spool another folder")
    others = [
        f"--{name.replace('_', '-')} was {was!r}, now {getattr(parameters, name)!r}"
        for name, was in msgspec.structs.asdict(state.parameters).items()
        if was != getattr(parameters, name)
    ]
    if others:
        raise BadInput(
            f"run {state.run} was started with other options: {'; '.join(others)}; give the same command again, or "
            "another --run"
        )
    return state


class LiveRun(RunRecord[RunState]):
    """One run of a simulated station, from where it is.

    Everything that is sent goes through the spool, so that the spool knows how far each signal is. A run at a pace that
    was interrupted has lost what the station would have measured meanwhile: it resumes with a new power-on. A run
    without a pace resumes with the next sample. Raises BadInput if it was started with other parameters; StoreError if
    its state cannot be read or written.
    """

    def __init__(
        self, run: str, parameters: RunParameters, spool: Spool, clock_ns: Callable[[], int] = time.time_ns
    ) -> None:
        found, file = read_run(spool.folder, run, parameters), spool.folder / RUN_FILE
        state = found or write_state(file, begin_run(run, parameters, clock_ns()))
        super().__init__(state, file, spool, Place(parameters.site, parameters.station))
        self.folder, self.is_resumed, self.gap_ns = spool.folder, found is not None, 0
        self._clock_ns = clock_ns
        self._name = _name(state)
        fleet = station_fleet(parameters.simulate, parameters.rate_hz, parameters.seed)
        self._station = SimulatedStation(fleet, self._name, batch=parameters.batch)
        self.units = list(fleet.units)
        self._end_ns = state.t0_ns + round(parameters.hours * 3600e9)

    def begin(self, sender: Sender) -> None:
        """Send the documents with which the run starts or resumes."""
        self._sender = sender
        if self.state.phase not in {"starting", "running"}:
            return
        if self.state.phase == "starting":
            parameters = self.state.parameters
            self._send(
                RunStarted(
                    run=self.state.run, t_ns=self.state.t0_ns, uid=self._uid("started"), simulated=True,
                    source=f"simulated station, seed {parameters.seed}", units=tuple(self.units),
                    procedure=parameters.procedure, operator=parameters.operator, lot=parameters.lot,
                )
            )  # fmt: skip
        if self.is_resumed:
            self._resume()
        if self.is_resumed and self.state.parameters.speed == 0 and self.state.phase == "running":
            return  # the units were never off
        if self.state.power_cycles[-1].t0_ns < self._end_ns:
            power_cycle = self.state.power_cycles[-1]
            for unit in self.units:
                epoch = str(self._station.epoch(power_cycle, unit))
                run, t_ns, uid = self.state.run, power_cycle.t0_ns, self._uid("power-on", epoch)
                self._send(PowerOn(run=run, t_ns=t_ns, uid=uid, unit=unit, epoch=epoch))
            for started in self._steps_started():
                self._send(started)
        self._save(phase="running")

    def batches(self, wait: Callable[[float], bool]) -> Iterator[SampleBatch]:
        """Remaining batches, each when it is due; ends when `wait`, given seconds, returns True."""
        if self.state.phase != "running":
            return
        power_cycle = self.state.power_cycles[-1]
        speed = self.state.parameters.speed
        first = {
            (unit, signal): self._spool.position(self._stream(power_cycle, unit, signal))
            for unit in self.units
            for signal in ("rate", "temperature")
        }
        began = time.monotonic()
        for batch in self._station.batches(self.state.run, power_cycle, self._end_ns, first):
            if speed:
                due = began + (batch.last_ns - power_cycle.t0_ns) / 1e9 / speed
                if (left_s := due - time.monotonic()) > 0 and wait(left_s):
                    return
            yield batch

    @property
    def left_s(self) -> float | None:
        """How long the rest of the run takes at its pace; None without a pace."""
        speed = self.state.parameters.speed
        return max(0.0, (self._end_ns - self._measured_until()) / 1e9 / speed) if speed else None

    def key(self, batch: SampleBatch) -> str:
        """Key expression of a batch."""
        return sample_key(self.place, batch.unit, batch.signal)

    def end(self, sender: Sender, outcome: Outcome = "completed") -> None:
        """Send the end of the run with the totals."""
        self._sender = sender
        if self.state.phase == "ended":
            return
        if self.state.phase != "ending":
            self._save(phase="ending", outcome=outcome)
        self._end_steps(self._measured_until())
        t_ns = self._end_ns if self.state.outcome == "completed" else self._measured_until()
        run, outcome, uid = self.state.run, self.state.outcome, self._uid("ended")
        self._send(RunEnded(run=run, t_ns=t_ns, uid=uid, outcome=outcome, totals=self._totals()))

    def _resume(self) -> None:
        state, measured_until = self.state, self._measured_until()
        power_cycles, now_ns = state.power_cycles, measured_until
        if state.parameters.speed:
            self._end_steps(measured_until)
            on_its_clock = state.t0_ns + round((self._clock_ns() - state.began_ns) * state.parameters.speed)
            now_ns = min(max(on_its_clock, measured_until), self._end_ns)
            power_cycles = (*power_cycles, PowerCycle(len(power_cycles), now_ns))
        self.gap_ns = now_ns - measured_until
        self._save(starts=state.starts + 1, power_cycles=power_cycles)
        reason, uid = "the source was interrupted", self._uid("resumed", state.starts + 1)
        self._send(RunResumed(run=state.run, t_ns=now_ns, uid=uid, gap_ns=self.gap_ns, reason=reason))
        for damage in self._spool.damages:
            uid = self._uid("damage", damage)
            self._send(NoteAdded(run=state.run, t_ns=now_ns, uid=uid, text=f"spool: {damage}", author="run"))

    def _steps_started(self) -> Iterator[StepStarted]:
        """The step of each unit from its power-on; none without procedure and position."""
        parameters, power_cycle = self.state.parameters, self.state.power_cycles[-1]
        if parameters.procedure is None and parameters.position is None:
            return
        words = StepWords(procedure=parameters.procedure, position=parameters.position)
        for unit in self.units:
            uid = self._uid("step", power_cycle.number, unit)
            yield StepStarted(run=self.state.run, t_ns=power_cycle.t0_ns, uid=uid, unit=unit, words=words)

    def _end_steps(self, until_ns: int) -> None:
        for begun in self._steps_started():
            last_ns = max(until_ns - self._station.dt_ns, begun.t_ns)
            uid = self._uid("end of step", begun.uid)
            self._send(StepEnded(run=begun.run, t_ns=last_ns, uid=uid, unit=begun.unit, step_uid=begun.uid))

    def _measured_until(self) -> int:
        """Time after the last rate sample that is kept."""
        return max(
            power_cycle.t0_ns + self._station.dt_ns * self._spool.position(self._stream(power_cycle, unit, "rate"))
            for power_cycle in self.state.power_cycles
            for unit in self.units
        )

    def _stream(self, power_cycle: PowerCycle, unit: str, signal: str) -> StreamId:
        return StreamId(sample_key(self.place, unit, signal), self._station.epoch(power_cycle, unit).hex)

    def _uid(self, *parts: object) -> str:
        return document_uid("\0".join(["gyrofleet:live-run", self._name, *map(str, parts)]))


def _name(state: RunState) -> str:
    """Name that distinguishes a run from others of its id: with the same `start` and parameters it is the same run."""
    if state.parameters.start is None:
        return f"{state.run}/{state.began_ns}"
    return f"{state.run}/{msgspec.json.encode(state.parameters).decode()}"
