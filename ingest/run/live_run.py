"""A run of simulated units: its documents, its samples at their pace, and how it resumes after an interruption."""

import time
from collections.abc import Callable, Iterator

import msgspec

from ingest.run.run_state import RUN_FILE, RunParameters, RunState, begin_run, read_run
from ingest.run_record import Outcome, RunRecord, document_uid
from ingest.simulator.demo_fleet import station_fleet
from ingest.simulator.station import PowerCycle, SimulatedStation
from ingest.state_file import write_state
from stream.batch import SampleBatch
from stream.delivery.publisher import Sender
from stream.delivery.spool import Spool
from stream.events import NoteAdded, PowerOn, RunEnded, RunResumed, RunStarted, StepEnded, StepStarted, StepWords
from stream.identity import Place, sample_key
from stream.wire.acknowledgement import StreamId

Clock = Callable[[], int]


class LiveRun(RunRecord[RunState]):
    """One run of a simulated station, from where it is.

    Everything that is sent goes through the spool, so that the spool knows how far each signal is. A run at a pace that
    was interrupted has lost what the station would have measured meanwhile: it resumes with a new power-on. A run
    without a pace resumes with the next sample.

    Parameters
    ----------
    run: Its id.
    parameters: What it is started with; a run that is resumed, with the same.
    spool: Keeps what is sent until it is recorded.
    clock_ns: The station's clock.

    Raises
    ------
    BadInput: If it was started with other parameters.
    StoreError: If its state cannot be read or written.
    """

    def __init__(self, run: str, parameters: RunParameters, spool: Spool, clock_ns: Clock = time.time_ns) -> None:
        found = read_run(spool.folder, run, parameters)
        file = spool.folder / RUN_FILE
        state = found or write_state(file, begin_run(run, parameters, clock_ns()))
        super().__init__(state, file, spool, Place(parameters.site, parameters.station))
        self.folder = spool.folder
        self.is_resumed = found is not None
        self.gap_ns = 0
        self._clock_ns = clock_ns
        fleet = station_fleet(parameters.simulate, parameters.rate_hz, parameters.seed)
        self._name = _name(state)
        self._station = SimulatedStation(fleet, self._name, batch=parameters.batch)
        self.units = list(fleet.units)
        self._end_ns = state.t0_ns + round(parameters.hours * 3600e9)

    @property
    def is_over(self) -> bool:
        """Whether a recorder has all of it."""
        return self.state.phase == "ended"

    def begin(self, sender: Sender) -> None:
        """Send the documents with which the run starts or resumes."""
        self._sender = sender
        if self.state.phase not in {"starting", "running"}:
            return
        if self.state.phase == "starting":
            parameters = self.state.parameters
            self._send(
                RunStarted(
                    run=self.state.run,
                    t_ns=self.state.t0_ns,
                    uid=self._uid("started"),
                    simulated=True,
                    source=f"simulated station, seed {parameters.seed}",
                    units=tuple(self.units),
                    procedure=parameters.procedure,
                    operator=parameters.operator,
                    lot=parameters.lot,
                )
            )
        if self.is_resumed:
            self._resume()
        if self.is_resumed and self.state.parameters.speed == 0 and self.state.phase == "running":
            return  # the units were never off
        if self.state.power_cycles[-1].t0_ns < self._end_ns:
            for unit in self.units:
                self._send(self._power_on(unit))
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

    def close(self) -> None:
        """Record that a recorder has everything."""
        self._save(phase="ended")

    def _resume(self) -> None:
        state = self.state
        starts = state.starts + 1
        measured_until = self._measured_until()
        power_cycles, now_ns = state.power_cycles, measured_until
        if state.parameters.speed:
            self._end_steps(measured_until)
            on_its_clock = state.t0_ns + round((self._clock_ns() - state.began_ns) * state.parameters.speed)
            now_ns = min(max(on_its_clock, measured_until), self._end_ns)
            power_cycles = (*power_cycles, PowerCycle(len(power_cycles), now_ns))
        self.gap_ns = now_ns - measured_until
        self._save(starts=starts, power_cycles=power_cycles)
        reason, uid = "the source was interrupted", self._uid("resumed", starts)
        self._send(RunResumed(run=state.run, t_ns=now_ns, uid=uid, gap_ns=self.gap_ns, reason=reason))
        for damage in self._spool.damages:
            uid = self._uid("damage", damage)
            self._send(NoteAdded(run=state.run, t_ns=now_ns, uid=uid, text=f"spool: {damage}", author="run"))

    def _power_on(self, unit: str) -> PowerOn:
        power_cycle = self.state.power_cycles[-1]
        epoch = str(self._station.epoch(power_cycle, unit))
        uid = self._uid("power-on", epoch)
        return PowerOn(run=self.state.run, t_ns=power_cycle.t0_ns, uid=uid, unit=unit, epoch=epoch)

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
        """End the steps of the last power-on at their last sample."""
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
