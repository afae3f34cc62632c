"""A procedure's run at a station: instruments are set, settled and left to measure."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Protocol

from ingest.instruments.base import Instrument
from ingest.procedure import PlannedStep
from ingest.station import Station
from ingest.station_clock import StationClock
from ingest.station_log import RunLog
from stream.errors import InstrumentError, RunAborted

_LOOK_S = 0.05
_SAVE_EVERY_S = 5.0
_ASK_SETTLED_S = 1.0  # at the station
_RETRY_S = 2.0


class Source(Protocol):
    """Where samples come from: a bus, a serial line, the sampler of an instrument."""

    def start(self) -> None:
        """Begin to deliver."""

    def stop(self) -> None:
        """Deliver what has come, and end; never raises."""


class Operator(Protocol):
    """Whoever attends the run."""

    def told(self, text: str) -> None:
        """Something has happened that people should know."""

    def ready(self, prompt: str) -> bool:
        """Whether what a prompt asks for has been done; asked again and again until it has."""

    def wishes(self) -> str | None:
        """``pause``, ``stop`` (to go on later) or ``abort``; None to go on."""

    def at(self, step: PlannedStep, doing: str, left_s: float) -> None:
        """The step that is worked on, what is being done, and how long the rest of the run will take."""


class RunStopped(RunAborted):
    """A run that was stopped and can be gone on with."""


class StationRun:
    """Works off the steps of a procedure that are left.

    Parameters
    ----------
    log : RunLog
        What is said of the run, and how far it is.
    steps : sequence of PlannedStep
        All its steps.
    station : Station
        Where.
    instruments : mapping of Instrument
        The station's instruments, by name.
    operator : Operator
        Who attends.
    clock : StationClock
        The station's clock.
    settle_timeout_s : float
        Seconds at the station after which an instrument that has not settled is given up.
    """

    def __init__(
        self,
        log: RunLog,
        steps: Sequence[PlannedStep],
        station: Station,
        instruments: Mapping[str, Instrument],
        operator: Operator,
        clock: StationClock,
        *,
        settle_timeout_s: float = 6 * 3600.0,
    ) -> None:
        self._log = log
        self._steps = steps
        self._station = station
        self._instruments = instruments
        self._operator = operator
        self._clock = clock
        self._settle_timeout_s = settle_timeout_s
        self._is_set_up = False

    def report(self, text: str) -> None:
        """Remember what a source or instrument says, and tell the operator; from any thread."""
        self._log.note(text)
        self._operator.told(text)

    def go(self, sources: Callable[[], Sequence[Source]], samplers: Sequence[Source] = ()) -> None:
        """Work off the steps; the station is made safe behind the last one, and whatever happens.

        Parameters
        ----------
        sources : callable
            Makes the sources of the units for their epochs as they are; called again after every power-on.
        samplers : sequence of Source
            Those of the instruments, which measure all the time.

        Raises
        ------
        RunStopped
            If the operator stops it, or an instrument fails; it can be gone on with.
        RunAborted
            If the operator aborts it.
        InstrumentError
            If a source cannot be started.
        """
        active: list[Source] = []

        def restart() -> None:
            _stop(active)
            active.extend(sources())
            for source in active:
                source.start()

        try:
            for sampler in samplers:
                sampler.start()
            if not self._log.state.is_powered:
                self._switch(1.0)
                self._log.power_on()
            restart()
            while self._log.state.step < len(self._steps):
                self._work(self._steps[self._log.state.step], active, restart)
        except RunStopped:
            self._log.end_steps("interrupted")
            raise
        except RunAborted:
            self._log.end_steps("aborted")
            raise
        finally:
            self.make_safe()
            _stop(active)
            _stop(list(samplers))

    def make_safe(self) -> None:
        """Bring every instrument to where it can be left alone; what fails is said, and hinders no other."""
        is_off = False
        for name, instrument in self._instruments.items():
            try:
                with instrument.lock:
                    instrument.make_safe()
                is_off |= name in self._supplies()
            except InstrumentError as error:
                self.report(f"warning: {name} could not be made safe: {error}; see to it by hand")
        if is_off and self._log.state.is_powered:
            self._log.power_off()

    def _work(self, step: PlannedStep, active: list[Source], restart: Callable[[], None]) -> None:
        """One step, from its commands to its last sample."""
        if step.prompt is not None:
            prompt = f"{step.prompt.en} / {step.prompt.zh}"
            self._until(step, "waiting for the operator", partial(self._operator.ready, prompt), None)
        if step.power in {"cycle", "off"}:
            self._until(step, "switching off", partial(self._switch, 0.0), self._settle_timeout_s)
            self._log.power_off()
            _stop(active)
            self._pause(step, "power off", step.off_s)
        for what, value in self._due(step):
            self._until(step, f"setting {what} to {value:g}", partial(self._set, what, value), self._settle_timeout_s)
        for what in step.wait_settled:
            self._until(step, f"{what} settles", partial(self._is_settled, what), self._settle_timeout_s)
        if step.power in {"cycle", "on"}:
            self._until(step, "switching on", partial(self._switch, 1.0), self._settle_timeout_s)
            self._log.power_on()
            restart()
        self._pause(step, "warming up", step.warm_up_s)
        if step.is_recorded:
            began_ns = self._log.begin_step(step)
            # what settles is in the data, and dropped when the step is evaluated
            lasts_s = step.settle_s + step.record_s
            self._pause(step, "recording", lasts_s, began_ns)
            self._log.end_steps("completed", began_ns + round(lasts_s * 1e9) - 1)
        else:
            self._pause(step, "settling", step.settle_s)
        state = self._log.state
        self._log.save(step=state.step + 1, steps_done=state.steps_done + 1)

    def _due(self, step: PlannedStep) -> list[tuple[str, float]]:
        """What is to be commanded: what is new, and after an interruption, since all was made safe, what held then."""
        due: dict[str, float] = {}
        if not self._is_set_up:
            for earlier in self._steps[: self._log.state.step]:
                due = {what: value for what, value in due.items() if not _replaces(earlier.settings, what)}
                due |= earlier.settings
            due = {what: value for what, value in due.items() if not _replaces(step.settings, what)}
            self._is_set_up = True
        return list((due | step.settings).items())

    def _switch(self, on: float) -> bool:
        for name in self._supplies():
            with self._instruments[name].lock:
                self._instruments[name].set("output", on)
        return True

    def _supplies(self) -> list[str]:
        """What powers the slots, else every supply that the station has."""
        named = {slot.power for slot in self._station.slots.values() if slot.power is not None}
        able = [name for name, instrument in self._instruments.items() if "output" in instrument.settings]
        return sorted(named) or able

    def _set(self, what: str, value: float) -> bool:
        instrument = self._instruments[self._station.settings[what]]
        with instrument.lock:
            instrument.set(what, value)
        return True

    def _is_settled(self, what: str) -> bool:
        instrument = self._instruments[self._station.settings[what]]
        with instrument.lock:
            return instrument.is_settled(what)

    def _pause(self, step: PlannedStep, doing: str, station_s: float, since_ns: int | None = None) -> None:
        """Wait so long at the station, while the operator may pause or stop the run."""
        end_ns = (self._clock.now_ns() if since_ns is None else since_ns) + round(station_s * 1e9)
        self._until(step, doing, lambda: self._clock.now_ns() >= end_ns, None)

    def _until(self, step: PlannedStep, doing: str, is_so: Callable[[], bool], timeout_s: float | None) -> None:
        """Wait until it is so; an instrument that fails meanwhile is opened and tried again for as long."""
        began_ns = self._clock.now_ns()
        asked_ns = 0
        trouble = ""
        while True:
            self._obey()
            now_ns = self._clock.now_ns()
            passed_s = (now_ns - began_ns) / 1e9
            if timeout_s is None or now_ns - asked_ns >= _ASK_SETTLED_S * 1e9:
                asked_ns = now_ns
                try:
                    if is_so():
                        return
                except InstrumentError as error:
                    if not trouble:
                        self.report(f"{doing}: {error}; trying again")
                    trouble = f": {error}"
                    time.sleep(_RETRY_S)
            if timeout_s is not None and passed_s > timeout_s:
                named = step.words.step or step.words.procedure
                raise RunStopped(
                    f"run {self._log.state.run}, step {step.number} ({named}): {doing} is not done after "
                    f"{passed_s:,.0f} s{trouble}; the station was made safe"
                )
            self._operator.at(step, doing, self._left_s(step, passed_s))
            if now_ns - self._log.state.seen_ns > _SAVE_EVERY_S * self._clock.speed * 1e9:
                self._log.save()
            time.sleep(_LOOK_S)

    def _obey(self) -> None:
        """Wait while the run is paused; raise where it is to end."""
        at = f"run {self._log.state.run} {{}} at step {self._log.state.step + 1}"
        paused = False
        while (wish := self._operator.wishes()) is not None:
            if wish == "stop":
                raise RunStopped(at.format("was stopped"))
            if wish == "abort":
                raise RunAborted(at.format("was aborted"))
            if not paused:
                paused = True
                self.report(at.format("is paused"))
            time.sleep(_LOOK_S)
        if paused:
            self.report(at.format("goes on"))

    def _left_s(self, step: PlannedStep, passed_s: float) -> float:
        rest = self._steps[self._log.state.step + 1 :]
        return max(0.0, sum(map(_lasts_s, (step, *rest))) - passed_s)


def _lasts_s(step: PlannedStep) -> float:
    return step.off_s + step.warm_up_s + step.settle_s + step.record_s


def _replaces(settings: Mapping[str, float], what: str) -> bool:
    """A table turns or stands somewhere: one takes the place of the other."""
    return (what == "angle" and "rate" in settings) or (what == "rate" and "angle" in settings)


def _stop(sources: list[Source]) -> None:
    for source in sources:
        source.stop()
    sources.clear()
