"""Laws that every instrument keeps, each against its simulated counterpart over a real socket."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from ingest.instruments.base import Instrument, instrument_kinds
from ingest.instruments.scpi_instrument import ScpiInstrument
from ingest.simulator.scpi.chamber import SimulatedChamber
from ingest.simulator.scpi.device import DeviceFault, SimulatedDevice
from ingest.simulator.scpi.electrical import SimulatedSupply, SimulatedVoltmeter
from ingest.simulator.scpi.server import ScpiServer
from ingest.simulator.scpi.tables import SimulatedRateTable, SimulatedVibrationTable
from ingest.station_clock import StationClock
from stream.errors import BadInput, InstrumentError

SPEED = 100.0
PATIENCE_S = 10.0  # of the computer

Truth = Callable[[Any, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Bench:
    """How an instrument of a kind is tried."""

    device: Callable[[StationClock], SimulatedDevice]
    options: dict[str, Any]
    before: dict[str, float]  # set first
    good: dict[str, float]
    bad: dict[str, tuple[float, ...]]
    truth: dict[str, Truth]
    resolution: float
    safe: Callable[[Any, int], bool]  # at a time after it was made safe


BENCHES = {
    "voltmeter": Bench(
        lambda clock: SimulatedVoltmeter(clock, source_v=lambda t_ns: np.full(len(t_ns), 2.5), noise_v=0.0),
        {"range_v": 10.0, "nplc": 2.0},
        {},
        {},
        {},
        {"voltage": lambda device, t_ns: np.full(len(t_ns), 2.5)},
        1e-5,
        lambda device, t_ns: True,
    ),
    "power_supply": Bench(
        SimulatedSupply,
        {"max_voltage_v": 6.0, "max_current_a": 2.0, "stable_s": 1.0},
        {"current_limit": 1.5, "output": 1.0},
        {"voltage": 5.0},
        {"voltage": (6.1, -1.0, float("nan")), "current_limit": (2.5,)},
        {
            "supply_voltage": lambda device, t_ns: device.voltage_v(t_ns),
            "supply_current": lambda device, t_ns: device.current_a(t_ns),
        },
        1e-3,
        lambda device, t_ns: float(device.is_on(t_ns)) == 0.0 and float(device.voltage_v(t_ns)) < 1e-6,
    ),
    "temperature_chamber": Bench(
        SimulatedChamber,
        {"band_deg_c": 0.3, "stable_s": 30.0},
        {},
        {"temperature": 27.0},
        {"temperature": (85.5, -60.0, float("inf"), float("nan"))},
        {"chamber_temperature": lambda device, t_ns: device.temperature_deg_c(t_ns)},
        1e-3,
        lambda device, t_ns: abs(float(device.temperature_deg_c(t_ns)) - 25.0) < 1e-6,
    ),
    "rate_table": Bench(
        SimulatedRateTable,
        {"max_rate_deg_per_s": 200.0},
        {"rate": -20.0},
        {"rate": 50.0, "angle": 90.0},
        {"rate": (200.5, -201.0, float("nan")), "angle": (400.0,)},
        {
            "table_rate": lambda device, t_ns: device.rate_deg_per_s(t_ns),
            "table_angle": lambda device, t_ns: device.angle_deg(t_ns),
        },
        1e-6,
        lambda device, t_ns: float(device.rate_deg_per_s(t_ns)) == 0.0,
    ),
    "vibration_table": Bench(
        SimulatedVibrationTable,
        {"max_amplitude_deg_per_s": 100.0},
        {},
        {"frequency": 40.0, "amplitude": 20.0},
        {"frequency": (600.0, 0.0), "amplitude": (101.0, -1.0)},
        {"table_rate": lambda device, t_ns: device.rate_deg_per_s(t_ns)},
        1e-6,
        lambda device, t_ns: abs(float(device.amplitude_deg_per_s(t_ns))) < 1e-6,
    ),
}

KINDS = sorted(kind for kind, cls in instrument_kinds().items() if issubclass(cls, ScpiInstrument))


@dataclass
class Tried:
    bench: Bench
    device: SimulatedDevice
    server: ScpiServer
    instrument: Instrument
    clock: StationClock

    def settle(self, what: str) -> None:
        end_ns = self.clock.now_ns() + round(PATIENCE_S * SPEED * 1e9)
        while not self.instrument.is_settled(what):
            assert self.clock.now_ns() < end_ns, f"{what} does not settle"
            self.clock.sleep(0.2)


@pytest.fixture(params=KINDS)
def tried(request: pytest.FixtureRequest) -> Iterator[Tried]:
    kind = request.param
    bench = BENCHES[kind]
    clock = StationClock(speed=SPEED)
    device = bench.device(clock)
    with ScpiServer({"X": device}) as server:
        cls = instrument_kinds()[kind]
        options = cls.options_type(resource=server.resource("X"), timeout_s=0.5, **bench.options)  # type: ignore[call-arg]
        instrument = cls("X-1", options, clock)
        yield Tried(bench, device, server, instrument, clock)
        instrument.close()


def test_every_kind_has_a_counterpart_and_is_found() -> None:
    assert set(KINDS) == set(BENCHES)


def test_it_says_what_it_is_in_words_of_two_languages(tried: Tried) -> None:
    instrument = tried.instrument
    assert instrument.open() == tried.device.identity
    assert set(instrument.names) == {"en", "zh"}
    assert set(tried.bench.truth) == set(instrument.signals)
    assert set(tried.bench.bad) <= set(instrument.settings)


def test_beyond_its_limits_nothing_is_sent(tried: Tried) -> None:
    tried.instrument.open()
    tried.instrument.sample()  # the device has read what opening wrote once it answers what came after it
    tried.device.lines.clear()
    for what, values in tried.bench.bad.items():
        for value in values:
            with pytest.raises(InstrumentError, match=rf"X-1: {what} of .* is not within .*; nothing was sent"):
                tried.instrument.set(what, value)
    with pytest.raises(BadInput, match="cannot be set to a colour of 1"):
        tried.instrument.set("colour", 1.0)
    assert not tried.device.lines


@pytest.mark.long
def test_it_settles_after_the_thing_itself_has(tried: Tried) -> None:
    tried.instrument.open()
    for what, value in {**tried.bench.before, **tried.bench.good}.items():
        tried.instrument.set(what, value)
        tried.settle(what)
    readings = tried.instrument.sample()
    for what, value in tried.bench.good.items():
        if what in {
            "frequency",
            "amplitude",
            "rate",
        }:  # the frequency of a sine is not its rate; rate comes before angle
            continue
        nearest = min(abs(reading.value - value) for reading in readings)
        assert nearest < 0.5


@pytest.mark.long
def test_what_never_settles_is_never_settled(tried: Tried) -> None:
    tried.instrument.open()
    for what, value in tried.bench.before.items():
        tried.instrument.set(what, value)
    tried.device.fault = DeviceFault.UNSETTLED
    for what, value in tried.bench.good.items():
        tried.instrument.set(what, value)
        for _ in range(20):
            assert not tried.instrument.is_settled(what)
            tried.clock.sleep(2.0)


def test_nothing_is_settled_that_was_never_set(tried: Tried) -> None:
    tried.instrument.open()
    for what in tried.bench.good:
        with pytest.raises(InstrumentError, match=f"{what} was never set"):
            tried.instrument.is_settled(what)


def test_samples_are_the_truth_of_their_time(tried: Tried) -> None:
    tried.instrument.open()
    for what, value in {**tried.bench.before, **tried.bench.good}.items():
        tried.instrument.set(what, value)
    for _ in range(5):
        tried.clock.sleep(2.0)
        before = tried.clock.now_ns()
        readings = tried.instrument.sample()
        after = tried.clock.now_ns()
        assert {reading.signal for reading in readings} == set(tried.instrument.signals)
        if len(readings) > len(tried.instrument.signals):  # a trace carries its own times
            times, values = np.array([each.t_ns for each in readings]), np.array([each.value for each in readings])
            exact = tried.bench.truth[readings[0].signal](tried.device, times)
            assert np.abs(exact - values).max() <= tried.bench.resolution
            continue
        for reading in readings:
            assert before <= reading.t_ns <= after
            # asked between before and after, it answered what was true at some moment in between
            course = tried.bench.truth[reading.signal](tried.device, np.linspace(before, after, 1001).astype(np.int64))
            steps = np.abs(np.diff(course)).max() + tried.bench.resolution
            assert course.min() - steps <= reading.value <= course.max() + steps


def test_made_safe_it_comes_to_rest(tried: Tried) -> None:
    tried.instrument.open()
    for what, value in {**tried.bench.before, **tried.bench.good}.items():
        tried.instrument.set(what, value)
    tried.clock.sleep(2.0)
    tried.instrument.make_safe()
    assert tried.bench.safe(tried.device, tried.clock.now_ns() + 3600 * 10**9)


def test_refused_commands_name_instrument_command_and_answer(tried: Tried) -> None:
    tried.instrument.open()
    tried.device.fault = DeviceFault.REFUSE
    for what, value in tried.bench.good.items():
        with pytest.raises(InstrumentError, match=r"X-1 at TCPIP.*given '.*' it reports -221"):
            tried.instrument.set(what, value)


def test_garbage_is_an_error_and_it_goes_on_after_it(tried: Tried) -> None:
    tried.instrument.open()
    tried.device.fault = DeviceFault.GARBAGE
    with pytest.raises(InstrumentError, match=r"X-1 at TCPIP.*garbage"):
        tried.instrument.sample()
    tried.device.fault = DeviceFault.NONE
    assert tried.instrument.sample()


def test_unplugged_it_is_named_and_comes_back(tried: Tried) -> None:
    tried.instrument.open()
    tried.server.unplug("X")
    with pytest.raises(InstrumentError, match="X-1 at TCPIP"):
        tried.instrument.sample()
    for what, value in tried.bench.good.items():
        with pytest.raises(InstrumentError, match="X-1 at TCPIP"):
            tried.instrument.set(what, value)
    with pytest.raises(InstrumentError, match="X-1 at TCPIP"):
        tried.instrument.open()
    tried.instrument.close()
    tried.server.plug("X")
    assert tried.instrument.open() == tried.device.identity
    assert tried.instrument.sample()


def test_closing_never_raises(tried: Tried) -> None:
    tried.instrument.close()
    tried.instrument.open()
    tried.server.unplug("X")
    tried.instrument.close()
    tried.instrument.close()
    with pytest.raises(InstrumentError, match="is not open"):
        tried.instrument.sample()
