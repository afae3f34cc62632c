"""A run from a live source: its documents, its samples at their pace, and how it goes on after an interruption."""

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from uuid import NAMESPACE_URL, uuid5

import msgspec
from msgspec.structs import replace

from ingest.run.run_state import Outcome, RunParameters, RunState, begin_run, read_run, write_run
from ingest.simulator.demo_fleet import station_fleet
from ingest.simulator.station import PowerCycle, SimulatedStation
from stream.batch import SampleBatch
from stream.delivery.publisher import Sender
from stream.delivery.spool import Spool
from stream.events import (
    NoteAdded,
    PowerOn,
    RunEnded,
    RunResumed,
    RunStarted,
    StepEnded,
    StepStarted,
    StepWords,
    StreamTotal,
)
from stream.identity import Place, SampleKey, event_key, parse_key, sample_key
from stream.wire.acknowledgement import StreamId

Clock = Callable[[], int]


class LiveRun:
    """One run of a simulated station, taken up where it is.

    Everything that is sent goes through the spool, so that the spool knows how far each signal is. A run at a pace that
    was interrupted has lost what the station would have measured meanwhile: it goes on with a new power-on. A run
    without a pace goes on with the next sample.

    Parameters
    ----------
    run: Its id.
    parameters: What it is given; if it was started before, with the same.
    spool: Where it is kept.
    clock_ns: The station's clock.

    Raises
    ------
    BadInput: If it was started with other parameters.
    StoreError: If its state cannot be read or written.
    """

    def __init__(self, run: str, parameters: RunParameters, spool: Spool, clock_ns: Clock = time.time_ns) -> None:
        self._spool = spool
        self.folder: Path = spool.folder
        self._clock_ns = clock_ns
        found = read_run(self.folder, run, parameters)
        self.is_resumed = found is not None
        self.state = found or write_run(self.folder, begin_run(run, parameters, clock_ns()))
        self.gap_ns = 0
        self.place = Place(parameters.site, parameters.station)
        fleet = station_fleet(parameters.simulate, parameters.rate_hz, parameters.seed)
        name = _name(self.state)
        self._station = SimulatedStation(fleet, name, batch=parameters.batch)
        self._units = list(fleet.units)
        self._end_ns = self.state.t0_ns + round(parameters.hours * 3600e9)
        self._uid = partial(_uid, name)

    @property
    def units(self) -> list[str]:
        """Units that are simulated."""
        return self._units

    @property
    def is_over(self) -> bool:
        """Whether everything of it is in a recorder's hands."""
        return self.state.phase == "ended"

    @property
    def samples(self) -> int:
        """Samples measured so far, in all power-ons."""
        return sum(total.samples for total in self._totals())

    def begin(self, sender: Sender) -> None:
        """Send the documents with which the run starts, or goes on."""
        if self.state.phase not in {"starting", "running"}:
            return
        send = partial(sender.send_event, event_key(self.place))
        if self.state.phase == "starting":
            parameters = self.state.parameters
            send(
                RunStarted(
                    run=self.state.run,
                    t_ns=self.state.t0_ns,
                    uid=self._uid("started"),
                    simulated=True,
                    source=f"simulated station, seed {parameters.seed}",
                    units=tuple(self._units),
                    procedure=parameters.procedure,
                    operator=parameters.operator,
                    lot=parameters.lot,
                )
            )
        if self.is_resumed:
            self._resume(sender)
        if self.is_resumed and self.state.parameters.speed == 0 and self.state.phase == "running":
            return  # the units were never off
        if self.state.power_cycles[-1].t0_ns < self._end_ns:
            for unit in self._units:
                send(self._power_on(unit))
            for started in self._steps_started():
                send(started)
        self._save(phase="running")

    def batches(self, wait: Callable[[float], bool]) -> Iterator[SampleBatch]:
        """What is left to measure, each batch when it is due; it ends when `wait`, given seconds, returns True."""
        if self.state.phase != "running":
            return
        power_cycle = self.state.power_cycles[-1]
        speed = self.state.parameters.speed
        first = {
            (unit, signal): self._spool.position(self._stream(power_cycle, unit, signal))
            for unit in self._units
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
        """What a batch is sent under."""
        return sample_key(self.place, batch.unit, batch.signal)

    def end(self, sender: Sender, outcome: Outcome = "completed") -> None:
        """Say that nothing more is measured, and how much was."""
        if self.state.phase == "ended":
            return
        if self.state.phase != "ending":
            self._save(phase="ending", outcome=outcome)
        self._end_steps(sender, self._measured_until())
        t_ns = self._end_ns if self.state.outcome == "completed" else self._measured_until()
        ended = RunEnded(
            run=self.state.run, t_ns=t_ns, uid=self._uid("ended"), outcome=self.state.outcome, totals=self._totals()
        )
        sender.send_event(event_key(self.place), ended)

    def close(self) -> None:
        """Remember that a recorder has everything."""
        self._save(phase="ended")

    def _resume(self, sender: Sender) -> None:
        state = self.state
        starts = state.starts + 1
        measured_until = self._measured_until()
        power_cycles, now_ns = state.power_cycles, measured_until
        if state.parameters.speed:
            self._end_steps(sender, measured_until)
            on_its_clock = state.t0_ns + round((self._clock_ns() - state.began_ns) * state.parameters.speed)
            now_ns = min(max(on_its_clock, measured_until), self._end_ns)
            power_cycles = (*power_cycles, PowerCycle(len(power_cycles), now_ns))
        self.gap_ns = now_ns - measured_until
        self._save(starts=starts, power_cycles=power_cycles)
        resumed = RunResumed(
            run=state.run,
            t_ns=now_ns,
            uid=self._uid("resumed", starts),
            gap_ns=self.gap_ns,
            reason="the source was interrupted",
        )
        sender.send_event(event_key(self.place), resumed)
        for damage in self._spool.damages:
            noted = NoteAdded(
                run=state.run, t_ns=now_ns, uid=self._uid("damage", damage), text=f"spool: {damage}", author="run"
            )
            sender.send_event(event_key(self.place), noted)

    def _power_on(self, unit: str) -> PowerOn:
        power_cycle = self.state.power_cycles[-1]
        epoch = str(self._station.epoch(power_cycle, unit))
        uid = self._uid("power-on", epoch)
        return PowerOn(run=self.state.run, t_ns=power_cycle.t0_ns, uid=uid, unit=unit, epoch=epoch)

    def _steps_started(self) -> Iterator[StepStarted]:
        """The step that each unit is in from its power-on; none where nothing says what is done."""
        parameters, power_cycle = self.state.parameters, self.state.power_cycles[-1]
        if parameters.procedure is None and parameters.position is None:
            return
        words = StepWords(procedure=parameters.procedure, position=parameters.position)
        for unit in self._units:
            uid = self._uid("step", power_cycle.number, unit)
            yield StepStarted(run=self.state.run, t_ns=power_cycle.t0_ns, uid=uid, unit=unit, words=words)

    def _end_steps(self, sender: Sender, until_ns: int) -> None:
        """End the steps of the last power-on at their last sample."""
        for begun in self._steps_started():
            last_ns = max(until_ns - self._station.dt_ns, begun.t_ns)
            uid = self._uid("end of step", begun.uid)
            ended = StepEnded(run=begun.run, t_ns=last_ns, uid=uid, unit=begun.unit, step_uid=begun.uid)
            sender.send_event(event_key(self.place), ended)

    def _measured_until(self) -> int:
        """Time after the last rate sample that is kept."""
        return max(
            power_cycle.t0_ns + self._station.dt_ns * self._spool.position(self._stream(power_cycle, unit, "rate"))
            for power_cycle in self.state.power_cycles
            for unit in self._units
        )

    def _stream(self, power_cycle: PowerCycle, unit: str, signal: str) -> StreamId:
        return StreamId(sample_key(self.place, unit, signal), self._station.epoch(power_cycle, unit).hex)

    def _totals(self) -> tuple[StreamTotal, ...]:
        epochs = {self._station.epoch(p, unit).hex: p for p in self.state.power_cycles for unit in self._units}
        return tuple(
            StreamTotal(
                unit=key.unit, signal=key.signal, epoch=str(self._station.epoch(power_cycle, key.unit)), samples=n
            )
            for stream, known in self._spool.streams.items()
            if (power_cycle := epochs.get(stream.epoch)) is not None
            and isinstance(key := parse_key(stream.key), SampleKey)
            and (n := known.appended)
        )

    def _save(self, **changes: object) -> None:
        self.state = write_run(self.folder, replace(self.state, **changes))


def _name(state: RunState) -> str:
    """What tells a run from all others of its id: given the moment and all else alike, it is the same run."""
    if state.parameters.start is None:
        return f"{state.run}/{state.began_ns}"
    return f"{state.run}/{msgspec.json.encode(state.parameters).decode()}"


def _uid(name: str, *parts: object) -> str:
    """The same document has the same identity however often it is sent."""
    return uuid5(NAMESPACE_URL, "\0".join(["gyrofleet:live-run", name, *map(str, parts)])).hex
