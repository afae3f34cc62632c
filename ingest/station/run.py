"""A procedure's run at a station: instruments are set, settled and left to measure."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Protocol

from ingest.instruments.base import Instrument
from ingest.procedures.plan import PlannedStep
from ingest.procedures.run_steps import lasts_s, settings_before
from ingest.station.bench import StationBench
from ingest.station.checks.rest import by_hand
from ingest.station.releases import Releases
from ingest.station.run_log import RunLog
from ingest.station.source_watch import RunSource, SourceWatch
from ingest.station.station import Station
from ingest.station_clock import StationClock
from stream.errors import InstrumentError, RunAborted

_LOOK_S = 0.05
_SAVE_EVERY_S = 5.0
_LONG_S = 3600.0  # at the station; then what settles is reported
_ASK_SETTLED_S = 1.0  # at the station
_RETRY_S = 2.0
_ARRIVE_S = 2.0  # how long the last samples of a step may take to come


class Operator(Protocol):
    """Whoever attends the run."""

    def report(self, text: str) -> None:
        """Report what has happened."""

    def ready(self, prompt: str) -> bool:
        """Whether what a prompt asks for has been done; called repeatedly until it has."""

    def poll_request(self) -> str | None:
        """``pause``, ``stop`` (to resume later) or ``abort``; None to go on."""

    def at(self, step: PlannedStep, doing: str, left_s: float) -> None:
        """Show the step that is worked on, what is being done, and how long the rest of the run takes."""


class RunStopped(RunAborted):
    """A run that was stopped and can be resumed."""


class StationRun:
    """Carries out the remaining steps of a procedure; `unsafe` has why instruments could not be made safe.

    With `releases` units are released once their limits are decided. `on_record` is called with the time, nanoseconds,
    from which a record counts.
    """

    def __init__(
        self, log: RunLog, steps: Sequence[PlannedStep], station: Station, instruments: Mapping[str, Instrument],
        operator: Operator, clock: StationClock, *, settle_timeout_s: float = 6 * 3600.0,
        releases: Releases | None = None, on_record: Callable[[int], None] = lambda _: None,
    ) -> None:  # fmt: skip
        self._log, self._steps, self._operator, self._clock = log, steps, operator, clock
        self._bench = StationBench(station, instruments)
        self._releases, self._on_record = releases, on_record
        self._settle_timeout_s = settle_timeout_s
        self._is_set_up = False
        self._sources: list[RunSource] = []
        self._watched = SourceWatch(log, clock, self._sources, operator.report)
        self.unsafe: Mapping[str, str] = {}

    def report(self, text: str) -> None:
        """Note a report of a source or instrument in the run, and show it to the operator; from any thread."""
        self._operator.report(text)
        self._log.note(text)

    def go(self, sources: Callable[[], Sequence[RunSource]], samplers: Sequence[RunSource] = ()) -> None:
        """Carry out the steps; the station is made safe after the last one, and whatever happens.

        `sources` makes the sources of the units for their epochs as they are, again after every power-on; `samplers`
        measure all the time. Raises RunStopped if the operator stops the run, or an instrument fails: it can be
        resumed; RunAborted if the operator aborts it; InstrumentError if a source cannot be started.
        """
        active = self._sources
        outcome = "interrupted"
        try:
            for name in self._bench.left_as_they_are():
                self.report(f"warning: {name} has settings and no safe state: it is left as it is when the run ends")
            for sampler in samplers:
                sampler.start()
            self._power_up()
            if self._log.state.is_powered:
                self._restart(active, sources)
            while self._log.state.step < len(self._steps):
                self._work(self._steps[self._log.state.step], active, partial(self._restart, active, sources))
        except RunAborted as aborted:
            outcome = "interrupted" if isinstance(aborted, RunStopped) else "aborted"
            raise
        finally:
            cut_ns = self._clock.now_ns()
            troubles = self._bench.rest()  # before anything is sent, which may have to wait for a recorder
            rest_ns = self._clock.now_ns()
            self.unsafe = troubles | self._bench.not_at_rest(troubles)
            self._stop(active)
            self._stop(list(samplers))
            self._watched.end()
            self._log.end_steps(outcome, cut_ns)
            self._report_rest(rest_ns)

    def make_safe(self) -> None:
        """Make every instrument safe; failures are reported and stop no other."""
        troubles, rest_ns = self._bench.rest(), self._clock.now_ns()
        self.unsafe = troubles | self._bench.not_at_rest(troubles)
        self._report_rest(rest_ns)

    @property
    def safety(self) -> str:
        """What came of making the station safe."""
        return "; ".join(by_hand(self.unsafe)) or "the station was made safe"

    def _report_rest(self, rest_ns: int) -> None:
        supplies = self._bench.supplies()
        if supplies and not any(name in self.unsafe for name in supplies):
            self._log.power_off(rest_ns)
        for sentence in by_hand(self.unsafe):
            self.report(f"warning: {sentence}")

    def _power_up(self) -> None:
        """Power the units, unless the step that is due begins without power; units that lost it have a new epoch."""
        idle = self._idle()
        if self._log.state.is_powered and self._bench.is_dead(idle):
            self.report("the units have lost their power since the run was left")
            self._log.mark_unpowered()
        if self._log.state.is_powered:
            return
        self._log.power_off()  # where a crash came before it was sent
        rest = self._steps[self._log.state.step :]
        if rest and rest[0].power not in {"cycle", "off"}:
            self._bench.switch(1.0, idle)
            self._log.power_on()

    def _idle(self) -> Sequence[str]:
        """Supplies that power nobody any more."""
        return () if self._releases is None else self._releases.idle_supplies(self._log.state.released)

    def _restart(self, active: list[RunSource], sources: Callable[[], Sequence[RunSource]]) -> None:
        self._stop(active)
        for source in sources():
            active.append(source)
            source.start()

    def _work(self, step: PlannedStep, active: list[RunSource], restart: Callable[[], None]) -> None:
        position = step.words.position
        if step.prompt is not None and position is not None and self._bench.carries_to(position):
            self._until(step, f"carrying to {position}", partial(self._bench.carry, position), self._settle_timeout_s)
        elif step.prompt is not None:
            prompt = f"{step.prompt.en} / {step.prompt.zh}"
            self._until(step, "waiting for the operator", partial(self._operator.ready, prompt), None)
        if step.power in {"cycle", "off"}:
            self._log.mark_unpowered()  # before it is: a resumed run then switches on, or off
            self._until(step, "switching off", partial(self._bench.switch, 0.0), self._settle_timeout_s)
            off_ns = self._clock.now_ns()
            self._stop(active)
            self._log.power_off(off_ns)
            self._pause(step, "power off", step.off_s)
        due = self._due(step)
        for what, value in due.items():
            doing, is_set = f"setting {what} to {value:g}", partial(self._bench.set, what, value)
            self._until(step, doing, is_set, self._settle_timeout_s)
        # what was set before an interruption has to be reached again
        for what in dict.fromkeys([*(each for each in due if each not in step.settings), *step.wait_settled]):
            self._until(
                step, f"{what} settles", partial(self._bench.is_settled, what), self._settle_timeout_s,
                about=partial(self._bench.settling, what),
            )  # fmt: skip
        if step.power in {"cycle", "on"}:
            self._stop(
                active
            )  # sources of units that are off would number their first samples, and those made below again
            self._until(step, "switching on", partial(self._bench.switch, 1.0, self._idle()), self._settle_timeout_s)
            self._log.power_on()
            restart()
        self._pause(step, "warming up", step.warm_up_s)
        if step.is_recorded:
            began_ns = self._log.begin_step(step)
            since_ns = began_ns + round(step.settle_s * 1e9)
            self._on_record(since_ns)
            # what settles is in the data, and dropped when the step is evaluated
            end_ns = since_ns + round(step.record_s * 1e9)
            off: dict[str, float] = {}

            def is_over() -> bool:
                self._watch(step, off)
                return self._clock.now_ns() >= end_ns or self._is_released(step, since_ns)

            self._watched.begin_step()
            self._log.coverage.watch(is_recording=True)
            try:
                self._until(step, "recording", is_over, None)
            finally:
                self._log.coverage.watch(is_recording=False)
                self._watched.end_record()
            self._report_departures(step, off)
            if not self._log.units_left:
                self.report("every unit is decided: the record ends early")
                self._log.pass_step()
                return
            self._await_last(step)
            self._log.end_steps("completed", end_ns - 1)
        else:
            self._pause(step, "settling", step.settle_s)
            self._log.pass_step()

    def _watch(self, step: PlannedStep, off: dict[str, float]) -> None:
        """Report a setting that leaves its band while a step records; `off` keeps the largest departure of each."""
        for what, (departure, text) in self._bench.departures(self._idle()).items():
            if what not in off:
                self.report(f"warning: {self._named(step)}: {what} has left its band: {text}; the record goes on")
            off[what] = max(departure, off.get(what, 0.0))

    def _report_departures(self, step: PlannedStep, off: Mapping[str, float]) -> None:
        for what, departure in off.items():
            self.report(f"warning: {self._named(step)}: {what} was off by up to {departure:.4g} during the record")

    @staticmethod
    def _named(step: PlannedStep) -> str:
        return f"step {step.number} ({step.words.step or step.words.procedure})"

    def _is_released(self, step: PlannedStep, since_ns: int) -> bool:
        """Release the units that are decided; whether none is left. Raises InstrumentError if a supply fails."""
        releases = self._releases
        if releases is None:
            return False
        now_ns = self._clock.now_ns()
        for release in list(releases.due(self._log.state.released, now_ns, since_ns, step.record_s)):
            self._log.release(release)
            self.report(releases.sentence(release))
        idle = releases.idle_supplies(self._log.state.released)
        off = [unit for unit in releases.without_power(idle) if unit not in self._log.state.unpowered]
        if off:
            releases.switch_off(idle)
            self._log.release_power(off)
            self.report(releases.free_sentence(idle, off))
        return not self._log.units_left

    def _await_last(self, step: PlannedStep) -> None:
        coverage = self._log.coverage
        until_s = time.monotonic() + _ARRIVE_S + self._clock.computer_s(2.0 * coverage.longest_interval_s)
        is_enough = lambda: coverage.is_whole or time.monotonic() > until_s  # noqa: E731
        self._until(step, "the last samples come", is_enough, None, is_recorded=True)
        lacking = coverage.lacking()
        for unit, what in lacking:
            text = f"warning: {self._named(step)}, unit {unit}: {what}; {self._watched.cause(unit)}"
            self._operator.report(text)
            self._log.note(text, unit)
        if lacking:
            self._log.add_short_records(len(dict(lacking)))

    def _due(self, step: PlannedStep) -> dict[str, float]:
        """Settings to command: the new ones, and after an interruption, which made all safe, the earlier ones."""
        due = {} if self._is_set_up else settings_before(self._steps, self._log.state.step)
        self._is_set_up = True
        return due | step.settings

    def _pause(self, step: PlannedStep, doing: str, station_s: float, since_ns: int | None = None) -> None:
        """Wait so long at the station; the operator may pause or stop the run meanwhile."""
        end_ns = (self._clock.now_ns() if since_ns is None else since_ns) + round(station_s * 1e9)
        self._until(step, doing, lambda: self._clock.now_ns() >= end_ns, None)

    def _until(
        self,
        step: PlannedStep,
        doing: str,
        is_so: Callable[[], bool],
        timeout_s: float | None,
        *,
        is_recorded: bool = False,
        about: Callable[[], str] = lambda: "",
    ) -> None:
        """Wait until `is_so`; an instrument that fails meanwhile is tried again for as long.

        `about` says more of what is waited for: it is shown, and reported where that takes an hour, two, four.
        """
        began_ns = self._clock.now_ns()
        asked_ns, report_s = 0, _LONG_S
        trouble = ""
        while True:
            before_ns = self._clock.now_ns()
            self._obey()
            now_ns = self._clock.now_ns()
            began_ns += now_ns - before_ns  # a pause is nobody's delay
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
            more = about()
            if timeout_s is not None and passed_s > timeout_s:
                seen = f" ({more})" if more else ""
                raise RunStopped(
                    f"run {self._log.state.run}, {self._named(step)}: {doing} is not done after {passed_s:,.0f} s"
                    f"{seen}{trouble}"
                )
            if more and passed_s > report_s:
                self.report(f"{self._named(step)}: {doing} for {passed_s / 3600.0:.1f} h: {more}{trouble}")
                report_s *= 2.0
            # what settles takes no time of the plan
            left_s = sum(map(lasts_s, self._steps[self._log.state.step + is_recorded :]))
            left_s -= passed_s if timeout_s is None else 0.0
            self._watched.look(self._named(step))
            self._operator.at(step, f"{doing} ({more})" if more else doing, max(0.0, left_s))
            self._mark_seen()
            time.sleep(_LOOK_S)

    def _obey(self) -> None:
        """Wait while the run is paused; raise where it is to end."""
        at = f"run {self._log.state.run} {{}} at step {self._log.state.step + 1}"
        paused = False
        while (request := self._operator.poll_request()) is not None:
            if request == "stop":
                self._log.mark_paused(is_paused=False)  # whoever gives the command again means it to go on
                raise RunStopped(at.format("was stopped"))
            if request == "abort":
                raise RunAborted(at.format("was aborted"))
            if not paused:
                paused = True
                self._log.mark_paused(is_paused=True)
                self.report(at.format("is paused"))
            self._mark_seen()
            time.sleep(_LOOK_S)
        if paused:
            self._log.mark_paused(is_paused=False)
            self.report(at.format("goes on"))

    def _mark_seen(self) -> None:
        if self._clock.now_ns() - self._log.state.seen_ns > _SAVE_EVERY_S * self._clock.speed * 1e9:
            self._log.mark_seen()

    def _stop(self, sources: list[RunSource]) -> None:
        self._log.keep_waiting(False)
        for source in sources:
            source.stop()
        sources.clear()
        self._log.keep_waiting(True)
