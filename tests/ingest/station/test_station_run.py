"""A procedure's run that dies at each of its words and is resumed, and instruments that fail meanwhile."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import pytest

from ingest import run_record
from ingest.instruments.base import Instrument, Options, Reading
from ingest.procedures.plan import PlannedStep
from ingest.procedures.procedure import load_procedure
from ingest.procedures.run_steps import resume_index
from ingest.run_record import write_state
from ingest.station import run as station_run
from ingest.station.run import RunStopped, StationRun
from ingest.station.run_log import RunLog, StationRunState
from ingest.station.station import ClockTable, SlotTable, Station, StationTable
from ingest.station_clock import StationClock
from stream.batch import SampleBatch
from stream.delivery.spool import Spool
from stream.errors import InstrumentError
from stream.events import (
    AnyDocument,
    PowerOff,
    PowerOn,
    RunEnded,
    RunResumed,
    RunStarted,
    StepEnded,
    StepStarted,
    StepWords,
)

UNIT = "FOG-1"


class Killed(BaseException):
    """The process is gone."""


class Wire:
    """Takes documents, until the process that sends them dies at one of them."""

    def __init__(self) -> None:
        self.documents: dict[str, AnyDocument] = {}
        self.sent = 0
        self.dies_at: int | None = None
        self.is_dead = False

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        raise AssertionError("there are no samples here")

    def send_event(self, key: str, document: AnyDocument) -> None:
        if self.is_dead:
            raise Killed
        if self.sent == self.dies_at:
            self.is_dead = True
            raise Killed
        self.sent += 1
        self.documents.setdefault(document.uid, document)  # sent twice it is one

    def of(self, kind: type[AnyDocument]) -> list[Any]:
        return [each for each in self.documents.values() if isinstance(each, kind)]


class Supply(Instrument):
    """A supply and a table in one, without a line between."""

    names: ClassVar[Mapping[str, str]] = MappingProxyType({"en": "bench", "zh": "台"})
    settings: ClassVar[Mapping[str, str]] = MappingProxyType({"output": "1", "rate": "deg/s", "temperature": "degC"})
    signals: ClassVar[Mapping[str, str]] = MappingProxyType({"supply_voltage": "V"})

    def __init__(self) -> None:
        super().__init__("supply", Options(), StationClock(1e5))
        self.commands: list[tuple[str, float]] = []
        self.asked: list[str] = []
        self.voltage_v = 5.0
        self.fails = 0

    def open(self) -> str:
        return "bench"

    def close(self) -> None:
        pass

    def set(self, what: str, value: float) -> None:
        if self.fails:
            self.fails -= 1
            raise InstrumentError(f"the bench refuses {what}")
        self.commands.append((what, value))
        if what == "output":
            self.voltage_v = 5.0 * value

    def is_settled(self, what: str) -> bool:
        self.asked.append(what)
        return True

    def sample(self) -> list[Reading]:
        return [Reading("supply_voltage", self.clock.now_ns(), self.voltage_v)]

    def make_safe(self) -> None:
        self.set("rate", 0.0)
        self.set("output", 0.0)


class Operator:
    def __init__(self) -> None:
        self.said: list[str] = []
        self.request: str | None = None

    def report(self, text: str) -> None:
        self.said.append(text)

    def ready(self, prompt: str) -> bool:
        return True

    def poll_request(self) -> str | None:
        return self.request

    def at(self, step: PlannedStep, doing: str, left_s: float) -> None:
        pass


def station() -> Station:
    settings = dict.fromkeys(("output", "rate", "temperature"), "supply")
    return Station(
        path=Path("station.toml"), table=StationTable(site="plant", name="bench"), clock=ClockTable(), instruments={},
        buses={}, lines={}, slots={"S1": SlotTable(power="supply")}, settings=settings,
        standards={},
    )  # fmt: skip


def begun(folder: Path, wire: Wire, steps: tuple[PlannedStep, ...], spool: Spool) -> RunLog:
    log = RunLog("r1", "p", "plan", (UNIT,), station(), spool, StationClock(1e5))
    log.begin(wire, (), {}, operator=None, lot=None, at=resume_index(steps, log.state.step))
    return log


def carried_out(folder: Path, wire: Wire, steps: tuple[PlannedStep, ...], supply: Supply) -> None:
    """What the command does, from the state that is on disk."""
    with Spool(folder) as spool:
        log = begun(folder, wire, steps, spool)
        if log.state.phase == "running":
            StationRun(log, steps, station(), {"supply": supply}, Operator(), supply.clock).go(list)
        log.end("completed")
        log.close()


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station_run, "_LOOK_S", 0.0002)
    monkeypatch.setattr(station_run, "_ARRIVE_S", 0.0)
    monkeypatch.setattr(station_run, "_RETRY_S", 0.0)


def repeats() -> tuple[PlannedStep, ...]:
    return load_procedure("bias_repeatability").steps(
        {"repeats": "2", "cool_down_s": "1", "bias_record_s": "1", "warm_up_s": "0"}
    )


def test_killed_at_any_word_or_any_state_it_says_everything_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = repeats()
    whole = Wire()
    saves = 0
    dies_at_save: int | None = None

    def save(file: Path, state: StationRunState) -> StationRunState:
        nonlocal saves
        if wire.is_dead:
            raise Killed
        if saves == dies_at_save:
            wire.is_dead = True
            raise Killed
        saves += 1
        return write_state(file, state)

    monkeypatch.setattr(run_record, "write_state", save)
    wire = whole
    carried_out(tmp_path / "whole", whole, steps, Supply())
    words, states = whole.sent, saves
    assert words >= 12
    assert states >= 12
    for kind, last in (("word", words), ("state", states)):
        for n in range(last):
            folder = tmp_path / f"{kind}{n}"
            wire, saves, dies_at_save = Wire(), 0, None
            if kind == "word":
                wire.dies_at = n
            else:
                dies_at_save = n
            supply = Supply()
            with pytest.raises(Killed):
                carried_out(folder, wire, steps, supply)
            wire.dies_at, dies_at_save, wire.is_dead = None, None, False
            carried_out(folder, wire, steps, supply)
            where = f"killed at {kind} {n}"
            assert len(wire.of(RunStarted)) == len(wire.of(RunEnded)) == 1, where
            ends = {each.step_uid: each.outcome for each in wire.of(StepEnded)}
            begun_steps = {each.uid: each.words.repeat for each in wire.of(StepStarted)}
            assert set(begun_steps) <= set(ends), where
            done = Counter(repeat for uid, repeat in begun_steps.items() if ends[uid] == "completed")
            assert done == {1: 1, 2: 1}, where
            ons, offs = ({each.epoch for each in wire.of(kind_)} for kind_ in (PowerOn, PowerOff))
            assert offs == ons, where
            assert supply.voltage_v == 0.0, where
            assert all(each.gap_ns >= 0 for each in wire.of(RunResumed)), where


def test_units_that_lost_their_power_meanwhile_have_a_new_epoch(tmp_path: Path) -> None:
    steps = load_procedure("static_bias").steps({"warm_up_s": "0", "bias_record_s": "1"})
    wire, supply = Wire(), Supply()
    with Spool(tmp_path) as spool:
        log = begun(tmp_path, wire, steps, spool)
        log.power_on()  # and killed; somebody switches the supply off
        supply.voltage_v = 0.0
    carried_out(tmp_path, wire, steps, supply)
    assert len(wire.of(PowerOn)) == 2
    assert ("output", 1.0) in supply.commands


def test_what_held_before_an_interruption_is_set_and_settled_again(tmp_path: Path) -> None:
    words = StepWords(procedure="p", step="static")
    steps = (
        PlannedStep(number=1, words=words, settings={"temperature": 40.0}, wait_settled=("temperature",), record_s=1.0),
        PlannedStep(number=2, words=words, record_s=1.0),
    )
    wire, supply = Wire(), Supply()
    with Spool(tmp_path) as spool:
        begun(tmp_path, wire, steps, spool).pass_step()
    carried_out(tmp_path, wire, steps, supply)
    assert ("temperature", 40.0) in supply.commands
    assert "temperature" in supply.asked
    assert len(wire.of(StepStarted)) == 1


def test_a_station_is_safe_before_anything_is_said(tmp_path: Path) -> None:
    """No recorder may keep a table turning."""
    steps = load_procedure("static_bias").steps({"warm_up_s": "0", "bias_record_s": "1"})
    wire, supply = Wire(), Supply()
    with Spool(tmp_path) as spool:
        log = begun(tmp_path, wire, steps, spool)
        operator = Operator()
        operator.request = "stop"
        run = StationRun(log, steps, station(), {"supply": supply}, operator, supply.clock)
        wire.dies_at = wire.sent + 1  # PowerOn is said, then nothing more is taken
        with pytest.raises(Killed):
            run.go(list)
    assert supply.commands[-2:] == [("rate", 0.0), ("output", 0.0)]


def test_an_instrument_that_refuses_for_a_while_is_tried_again_and_told_once(tmp_path: Path) -> None:
    steps = repeats()
    wire, supply = Wire(), Supply()
    with Spool(tmp_path) as spool:
        log = begun(tmp_path, wire, steps, spool)
        operator = Operator()
        run = StationRun(log, steps, station(), {"supply": supply}, operator, supply.clock)
        log.power_on()
        supply.fails = 3
        run.go(list)
    assert [text for text in operator.said if "refuses" in text] == [
        "switching off: the bench refuses output; trying again"
    ]


def test_one_that_never_answers_is_given_up_and_what_could_not_be_made_safe_is_said(tmp_path: Path) -> None:
    steps = repeats()
    wire, supply = Wire(), Supply()
    with Spool(tmp_path) as spool:
        log = begun(tmp_path, wire, steps, spool)
        log.power_on()
        operator = Operator()
        run = StationRun(log, steps, station(), {"supply": supply}, operator, supply.clock, settle_timeout_s=100.0)
        supply.fails = 10**9
        with pytest.raises(RunStopped, match=r"switching off is not done after [\d,]+ s: the bench refuses output"):
            run.go(list)
        assert any("supply could not be made safe" in text for text in operator.said)
        assert run.safety == "supply could not be made safe: the bench refuses rate; make it safe by hand"
        assert log.state.open_steps == {}
