"""The sampler, on instruments that come and go."""

import threading
import time
from collections.abc import Callable, Mapping
from itertools import pairwise
from types import MappingProxyType
from typing import ClassVar
from uuid import UUID

import numpy as np
import pytest

from ingest.instruments.base import Instrument, Options, Reading
from ingest.instruments.temperature_chamber import TemperatureChamber, TemperatureChamberOptions
from ingest.instruments.vibration_table import VibrationTable, VibrationTableOptions
from ingest.simulator.scpi.chamber import SimulatedChamber
from ingest.simulator.scpi.server import ScpiServer
from ingest.simulator.scpi.tables import SimulatedVibrationTable
from ingest.station.sampling import Sampler
from ingest.station_clock import StationClock
from stream.batch import SampleBatch
from stream.errors import DeliveryError

EPOCH = UUID(int=5)


class Thermometer(Instrument):
    """Gives what a function of the time says."""

    kind: ClassVar[str] = "thermometer"
    names: ClassVar[Mapping[str, str]] = MappingProxyType({"en": "thermometer", "zh": "温度计"})
    signals: ClassVar[Mapping[str, str]] = MappingProxyType({"temperature": "degC", "humidity": "1"})
    busy = 0
    together = 0
    calls = 0
    readings: Callable[[int], list[Reading]]

    def open(self) -> str:
        return "thermometer"

    def close(self) -> None:
        pass

    def sample(self) -> list[Reading]:
        self.calls += 1
        self.busy += 1
        self.together = max(self.together, self.busy)
        time.sleep(0.002)
        self.busy -= 1
        return self.readings(self.clock.now_ns())

    def set(self, what: str, value: float) -> None:
        self.sample()


def thermometer(speed: float, interval_s: float, readings: Callable[[int], list[Reading]]) -> Thermometer:
    made = Thermometer("T", Options(sample_interval_s=interval_s), StationClock(speed=speed, start_ns=0))
    made.readings = readings
    return made


def both(t_ns: int) -> list[Reading]:
    return [Reading("temperature", t_ns, t_ns / 1e9), Reading("humidity", t_ns + 1, 0.5)]


def until(condition: Callable[[], bool], timeout_s: float = 10.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def joined(batches: list[SampleBatch], signal: str) -> tuple[np.ndarray, np.ndarray]:
    mine = [batch for batch in batches if batch.signal == signal]
    for before, after in pairwise(mine):
        assert after.seq == before.next_seq
    return np.concatenate([b.time_array for b in mine]), np.concatenate([b.value_array for b in mine])


def test_it_reads_on_the_grid_and_loses_nothing_at_the_end() -> None:
    batches: list[SampleBatch] = []
    said: list[str] = []
    sampler = Sampler(thermometer(1.0, 0.05, both), "r1", EPOCH, batches.append, said.append, batch_s=0.3)
    sampler.start()
    time.sleep(1.2)
    sampler.stop()
    sampler.stop()
    for signal in ("temperature", "humidity"):
        times, values = joined(batches, signal)
        assert len(times) + sampler.missed >= 22
        assert len(times) <= 26
        assert np.all(np.diff(times) > 0)
        if signal == "temperature":
            assert np.array_equal(values, times / 1e9)
    assert sampler.samples == sum(len(batch) for batch in batches)
    assert {(batch.unit, batch.run, batch.epoch, batch.dt_ns) for batch in batches} == {("T", "r1", EPOCH, 50_000_000)}
    assert all(batch.last_ns - batch.t0_ns <= 600_000_000 for batch in batches)
    assert len(batches) >= 4
    assert not said


def test_a_fast_clock_is_a_fast_grid() -> None:
    batches: list[SampleBatch] = []
    sampler = Sampler(thermometer(100.0, 1.0, both), "r1", EPOCH, batches.append, print, batch_s=0.5)
    sampler.start()
    time.sleep(1.0)
    sampler.stop()
    times, _ = joined(batches, "temperature")
    assert len(times) + sampler.missed > 80
    assert times[-1] - times[0] > 80e9


def test_late_turns_are_left_out_and_counted() -> None:
    def slow(t_ns: int) -> list[Reading]:
        time.sleep(0.12)
        return both(t_ns)

    batches: list[SampleBatch] = []
    sampler = Sampler(thermometer(1.0, 0.05, slow), "r1", EPOCH, batches.append, print)
    sampler.start()
    time.sleep(1.0)
    sampler.stop()
    assert sampler.missed >= 6
    times, _ = joined(batches, "temperature")
    assert np.diff(times).min() > 0.1e9, "no burst to catch up"


@pytest.mark.long
def test_an_instrument_that_goes_is_reported_once_and_so_is_its_return() -> None:
    clock = StationClock(speed=10.0)
    with ScpiServer({"C": SimulatedChamber(clock)}) as server:
        options = TemperatureChamberOptions(resource=server.resource("C"), timeout_s=0.5, sample_interval_s=0.5)
        chamber = TemperatureChamber("C1", options, clock)
        chamber.open()
        batches: list[SampleBatch] = []
        said: list[str] = []
        sampler = Sampler(chamber, "r1", EPOCH, batches.append, said.append, batch_s=0.1)
        sampler.start()
        until(lambda: sampler.samples >= 3)
        server.unplug("C")
        until(lambda: bool(said))
        at_loss = sampler.samples
        time.sleep(0.7)
        server.plug("C")
        until(lambda: sampler.samples >= at_loss + 3)
        sampler.stop()
        chamber.close()
    assert len(said) == 2
    assert "temperature chamber C1 at TCPIP" in said[0]
    assert "tried again until it answers" in said[0]
    assert "temperature chamber C1 answers again after" in said[1]
    times, _ = joined(batches, "chamber_temperature")
    assert np.diff(times).max() > 0.5e9 * 10, "the gap is in the times"


def test_stopping_does_not_wait_for_an_instrument_that_is_gone() -> None:
    clock = StationClock()
    with ScpiServer({"C": SimulatedChamber(clock)}) as server:
        options = TemperatureChamberOptions(resource=server.resource("C"), timeout_s=0.5, sample_interval_s=0.05)
        chamber = TemperatureChamber("C1", options, clock)
        chamber.open()
        said: list[str] = []
        sampler = Sampler(chamber, "r1", EPOCH, lambda batch: None, said.append)
        sampler.start()
        server.unplug("C")
        until(lambda: bool(said))
        time.sleep(1.0)
        began = time.monotonic()
        sampler.stop()
        assert time.monotonic() - began < 2.0
        chamber.close()
    assert len(said) == 1


def test_commands_do_not_come_between_question_and_answer() -> None:
    instrument = thermometer(1.0, 0.001, both)
    sampler = Sampler(instrument, "r1", EPOCH, lambda batch: None, print)
    commands = 0

    def command() -> bool:
        nonlocal commands
        with instrument.lock:
            instrument.set("temperature", 1.0)
        commands += 1
        return commands >= 100 and instrument.calls - commands > 20

    sampler.start()
    until(command)
    sampler.stop()
    assert sampler.samples > 20
    assert instrument.together == 1


def test_a_lock_of_the_callers_is_held_while_it_reads() -> None:
    lock = threading.Lock()
    batches: list[SampleBatch] = []
    sampler = Sampler(thermometer(1.0, 0.01, both), "r1", EPOCH, batches.append, print, lock=lock, batch_s=0.05)
    with lock:
        sampler.start()
        time.sleep(0.2)
        assert not batches
    until(lambda: bool(batches))
    sampler.stop()


def test_a_trace_is_kept_with_its_own_interval() -> None:
    clock = StationClock()
    with ScpiServer({"V": SimulatedVibrationTable(clock)}) as server:
        options = VibrationTableOptions(
            resource=server.resource("V"), max_amplitude_deg_per_s=50.0, sample_interval_s=0.05
        )
        table = VibrationTable("V", options, clock)
        table.open()
        table.set("amplitude", 10.0)
        table.sample()  # what it recorded before
        batches: list[SampleBatch] = []
        said: list[str] = []
        sampler = Sampler(table, "r1", EPOCH, batches.append, said.append, batch_s=0.2)
        sampler.start()
        time.sleep(0.8)
        sampler.stop()
        table.close()
    times, _ = joined(batches, "table_rate")
    assert len(times) > 500
    assert set(np.diff(times).tolist()) == {500_000}
    assert {batch.dt_ns for batch in batches if len(batch) > 1} == {500_000}
    assert not any(batch.irregular for batch in batches)
    assert all(len(batch) <= 1000 for batch in batches)
    assert not said


def test_what_is_no_number_or_comes_twice_is_left_out_and_said() -> None:
    batches: list[SampleBatch] = []
    said: list[str] = []
    instrument = thermometer(
        1.0, 0.02, lambda t_ns: [Reading("temperature", 7, 1.0), Reading("humidity", t_ns, float("nan"))]
    )
    sampler = Sampler(instrument, "r1", EPOCH, batches.append, said.append, batch_s=0.05)
    sampler.start()
    until(lambda: len(said) >= 1)
    sampler.stop()
    assert sum(len(batch) for batch in batches) == 1
    assert all("readings are left out" in each for each in said)


@pytest.mark.parametrize("error", [DeliveryError("the spool is full"), RuntimeError("a bug")])
def test_a_delivery_that_fails_ends_it_loudly(error: Exception) -> None:
    said: list[str] = []

    def refuse(batch: SampleBatch) -> None:
        raise error

    sampler = Sampler(thermometer(1.0, 0.01, both), "r1", EPOCH, refuse, said.append, batch_s=0.02)
    sampler.start()
    until(lambda: sampler.error is not None)
    sampler.stop()
    assert sampler.error is error
    assert said == [f"the thermometer T is not read any more: {error}"]
