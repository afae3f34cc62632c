"""What single instruments do beyond the laws, and the physics of their simulated counterparts."""

import math

import numpy as np
import pytest

from ingest.instruments.power_supply import PowerSupply, PowerSupplyOptions
from ingest.instruments.rate_table import RateTable, RateTableOptions
from ingest.instruments.scpi_instrument import ScpiInstrument
from ingest.instruments.temperature_chamber import TemperatureChamber, TemperatureChamberOptions
from ingest.instruments.vibration_table import VibrationTable, VibrationTableOptions
from ingest.instruments.voltmeter import Voltmeter, VoltmeterOptions
from ingest.simulator.scpi.chamber import SimulatedChamber
from ingest.simulator.scpi.device import SimulatedDevice
from ingest.simulator.scpi.electrical import SimulatedVoltmeter
from ingest.simulator.scpi.server import ScpiServer
from ingest.simulator.scpi.tables import SimulatedRateTable, SimulatedVibrationTable
from ingest.station_clock import StationClock
from stream.batch import FloatArray, IntArray
from stream.errors import BadInput, InstrumentError

SECOND = 10**9


class Stepped(StationClock):
    """A clock that a test sets."""

    t_ns = 0

    def now_ns(self) -> int:
        return self.t_ns


def test_a_chamber_of_another_maker_is_a_matter_of_the_station_file() -> None:
    heard: list[float] = []
    device = SimulatedDevice("", StationClock(), {"SET:TEMPerature": heard.append}, {"MON?": lambda: "23.4,OK,RUN"})
    with ScpiServer({"C": device}) as server:
        options = TemperatureChamberOptions(
            resource=server.resource("C"),
            identity="none",
            check_errors=False,
            commands={"set": "SET:TEMP {value:.1f}", "measure": "MON?"},
            answers={"measure": "([^,]+),OK,.*"},
        )
        with TemperatureChamber("C1", options, StationClock()) as chamber:
            chamber.set("temperature", -40.0)
            assert chamber.sample()[0].value == 23.4
    assert heard == [-40.0]


@pytest.mark.parametrize(
    ("commands", "complaint"),
    [
        ({"sett": "X {value}"}, "commands has 'sett', which it does not use: it uses set, measure"),
        ({"set": "X"}, r"command set = 'X' needs \{value\}"),
        ({"measure": "X {value}"}, "sets nothing"),
        ({"set": "X {valu}"}, "cannot be filled in"),
        ({"set": "X {value:d}"}, "cannot be filled in"),
        ({"set": "X {value"}, "cannot be filled in"),
    ],
)
def test_commands_that_cannot_be_are_refused_at_once(commands: dict[str, str], complaint: str) -> None:
    with pytest.raises(BadInput, match=complaint):
        TemperatureChamber("C1", TemperatureChamberOptions(resource="x", commands=commands), StationClock())


def test_options_that_contradict_each_other_are_refused_at_once() -> None:
    clock = StationClock()
    cases: list[tuple[type[ScpiInstrument], object, str]] = [
        (Voltmeter, VoltmeterOptions(resource="x", nplc=100.0, timeout_s=2.0), "100 cycles of 50 Hz take 2 s"),
        (Voltmeter, VoltmeterOptions(resource="x", range_v=0.0), "range_v is 0"),
        (TemperatureChamber, TemperatureChamberOptions(resource="x", highest_deg_c=20.0), "room_deg_c of 25"),
        (TemperatureChamber, TemperatureChamberOptions(resource="x", lowest_deg_c=90.0), "is an empty range"),
        (TemperatureChamber, TemperatureChamberOptions(resource="x", band_deg_c=-1.0), "neither can be negative"),
        (RateTable, RateTableOptions(resource="x", max_rate_deg_per_s=-5.0), "is an empty range"),
        (TemperatureChamber, TemperatureChamberOptions(resource="x", answers={"measure": "("}), "answer measure"),
        (TemperatureChamber, TemperatureChamberOptions(resource="x", baud_rate=0), "baud_rate is 0"),
    ]
    for cls, options, complaint in cases:
        with pytest.raises(BadInput, match=complaint):
            cls("X", options, clock)


def test_a_voltmeter_is_configured_again_after_it_was_off() -> None:
    device = SimulatedVoltmeter(StationClock(speed=100.0), noise_v=0.0)
    with ScpiServer({"V": device}) as server:
        options = VoltmeterOptions(resource=server.resource("V"), range_v=1.0, nplc=5.0)
        with Voltmeter("V", options, StationClock(speed=100.0)) as voltmeter:
            assert (device.range_v, device.nplc) == (1.0, 5.0)
            device.range_v, device.nplc = 10.0, 1.0
            server.unplug("V")
            server.plug("V")
            assert voltmeter.sample()[0].value == pytest.approx(1.0, abs=1e-6)
            assert (device.range_v, device.nplc) == (1.0, 5.0)


def test_a_voltmeter_dates_a_reading_at_the_middle_of_its_averaging() -> None:
    clock = StationClock()

    def ramp(t_ns: IntArray) -> FloatArray:
        return (t_ns - clock.start_ns) / SECOND  # a volt a second

    device = SimulatedVoltmeter(clock, source_v=ramp, noise_v=0.0)
    with ScpiServer({"V": device}) as server:
        options = VoltmeterOptions(resource=server.resource("V"), range_v=100.0, nplc=10.0)
        with Voltmeter("V", options, clock) as voltmeter:
            readings = [voltmeter.sample()[0] for _ in range(5)]
    # the best of five: a busy machine delays an answer; dated at its end each would be 0.1 s late
    late_s = [(reading.t_ns - clock.start_ns) / SECOND - reading.value for reading in readings]
    assert min(map(abs, late_s)) < 0.03


def test_an_overload_is_an_error() -> None:
    device = SimulatedVoltmeter(StationClock(speed=100.0), source_v=lambda t_ns: np.full(len(t_ns), 15.0))
    with ScpiServer({"V": device}) as server:
        voltmeter = Voltmeter("V", VoltmeterOptions(resource=server.resource("V")), StationClock())
        with voltmeter, pytest.raises(InstrumentError, match=r"voltmeter V at .*overloaded"):
            voltmeter.sample()


class BrokenSensor(SimulatedChamber):
    """A chamber whose sensor is open: its controller gives the least number that it has."""

    def handle(self, line: str) -> str | None:
        """Answer a line."""
        return "-9999.0" if "ACT?" in line else super().handle(line)


def test_a_temperature_below_absolute_zero_is_none() -> None:
    with ScpiServer({"C": BrokenSensor(StationClock(speed=100.0))}) as server:
        chamber = TemperatureChamber("C", TemperatureChamberOptions(resource=server.resource("C")), StationClock())
        with (
            chamber,
            pytest.raises(InstrumentError, match=r"-9999 degC, which is below absolute zero; check its sensor"),
        ):
            chamber.sample()


def test_an_output_is_on_or_off() -> None:
    supply = PowerSupply("P", PowerSupplyOptions(resource="x", max_voltage_v=5.0, max_current_a=1.0), StationClock())
    with pytest.raises(BadInput, match=r"1 for on or 0 for off, not 0\.5"):
        supply.set("output", 0.5)


def test_a_rate_takes_the_place_of_a_position() -> None:
    clock = StationClock(speed=100.0)
    with ScpiServer({"T": SimulatedRateTable(clock)}) as server:
        options = RateTableOptions(resource=server.resource("T"), max_rate_deg_per_s=100.0)
        with RateTable("T", options, clock) as table:
            table.set("angle", 45.0)
            table.set("rate", 10.0)
            with pytest.raises(InstrumentError, match="angle was never set"):
                table.is_settled("angle")


def test_a_vibration_table_without_a_trace_is_read_a_value_at_a_time() -> None:
    clock = StationClock()
    device = SimulatedVibrationTable(clock)
    with ScpiServer({"V": device}) as server:
        options = VibrationTableOptions(
            resource=server.resource("V"), max_amplitude_deg_per_s=50.0, commands={"trace": ""}
        )
        with VibrationTable("V", options, clock) as table:
            assert [reading.signal for reading in table.sample()] == ["table_rate"]


def test_a_trace_has_no_hole_and_nothing_twice() -> None:
    clock = StationClock()
    with ScpiServer({"V": SimulatedVibrationTable(clock)}) as server:
        options = VibrationTableOptions(resource=server.resource("V"), max_amplitude_deg_per_s=50.0)
        with VibrationTable("V", options, clock) as table:
            table.set("frequency", 30.0)
            table.set("amplitude", 50.0)
            times: list[int] = []
            for _ in range(10):
                clock.sleep(0.02)
                times += [reading.t_ns for reading in table.sample()]
    assert len(times) > 300
    assert set(np.diff(times).tolist()) == {500_000}


def test_the_chamber_approaches_as_its_equation_says() -> None:
    clock = Stepped()
    chamber = SimulatedChamber(clock, start_deg_c=25.0, ramp_deg_c_per_min=6.0, lag_s=60.0)
    chamber.handle("TEMP:SETP 85")
    grid = np.arange(0, 1500, 0.05)
    air, course = 25.0, []
    for t_s in grid:  # T' = (s - T) / lag, the ramp 0.1 degC/s
        course.append(air)
        middle = min(25.0 + 0.1 * (t_s + 0.025), 85.0)
        air += (middle - air) * -math.expm1(-0.05 / 60.0)
    exact = chamber.temperature_deg_c((grid * 1e9).astype(np.int64))
    assert np.abs(exact - course).max() < 1e-3


def test_the_past_of_a_table_is_not_changed_by_commands_that_come_later() -> None:
    clock = Stepped()
    table = SimulatedRateTable(clock)
    rng = np.random.default_rng(5)
    seen: list[tuple[IntArray, FloatArray, FloatArray]] = []
    for k in range(60):
        start = clock.t_ns
        clock.t_ns += int(rng.integers(1, 3 * SECOND))
        times = np.sort(rng.integers(start, clock.t_ns + 1, 20))
        seen.append((times, table.rate_deg_per_s(times), table.angle_deg(times)))
        table.handle(f"RATE:SETP {rng.uniform(-200, 200):.3f}" if k % 3 else f"ANGL:SETP {rng.uniform(-300, 300):.3f}")
    for times, rate, angle in seen:
        assert np.array_equal(table.rate_deg_per_s(times), rate)
        assert np.array_equal(table.angle_deg(times), angle)


@pytest.mark.parametrize("ripple", [0.0, 0.01])
def test_the_angle_is_the_integral_of_the_rate_and_the_rate_has_no_jumps(ripple: float) -> None:
    clock = Stepped()
    table = SimulatedRateTable(clock, ripple_deg_per_s=ripple)
    rng = np.random.default_rng(6)
    for k in range(40):
        clock.t_ns += int(rng.integers(SECOND // 10, 3 * SECOND))
        table.handle(f"RATE:SETP {rng.uniform(-200, 200):.3f}" if k % 3 else f"ANGL:SETP {rng.uniform(-300, 300):.3f}")
    times = np.arange(0, clock.t_ns, 10**6, dtype=np.int64)
    rate, angle = table.rate_deg_per_s(times), table.angle_deg(times)
    # at 1 ms: acceleration changes cost at most 200 deg/s2 (1 ms)^2 / 4 each, and there are under 5 a command
    assert abs(np.trapezoid(rate, dx=1e-3) - (angle[-1] - angle[0])) < 200 * 200e-6 / 4 * 1e-3 * 1e3 + 1e-6
    assert np.abs(np.diff(rate)).max() <= 100.0 * 1e-3 + 2.0 * ripple + 1e-9
    assert np.abs(rate).max() <= 200.0 + ripple


@pytest.mark.parametrize(("before", "target"), [(0.0, 90.0), (50.0, -30.0), (-20.0, 0.001), (200.0, 0.0)])
def test_the_table_stops_at_the_angle_that_is_set(before: float, target: float) -> None:
    clock = Stepped()
    table = SimulatedRateTable(clock)
    table.handle(f"RATE:SETP {before}")
    clock.t_ns = 5 * SECOND
    table.handle(f"ANGL:SETP {target}")
    times = clock.t_ns + np.arange(0, 120 * SECOND, SECOND // 1000)
    angle, rate = table.angle_deg(times), table.rate_deg_per_s(times)
    assert angle[-1] == target
    assert rate[-1] == 0.0
    assert np.abs(np.diff(angle)).max() <= 200.0 * 1e-3 + 1e-9, "no jump on the way"
    assert np.abs(np.diff(rate)).max() <= 100.0 * 1e-3 + 1e-9


def test_the_vibration_tables_angle_is_the_integral_of_its_rate() -> None:
    clock = Stepped()
    table = SimulatedVibrationTable(clock)
    for t_s, line in [(1, "AMPL:SETP 40"), (3, "FREQ:SETP 10"), (4, "AMPL:SETP 5"), (5, "FREQ:SETP 25")]:
        clock.t_ns = t_s * SECOND
        table.handle(line)
    times = np.arange(0, 8 * SECOND, 10**5, dtype=np.int64)
    rate, angle = table.rate_deg_per_s(times), table.angle_deg(times)
    # trapezium rule: h^2/12 times the span times the largest second derivative, 40 (2 pi 25)^2 + swell
    bound = 1e-8 / 12 * 8 * 40 * (2 * np.pi * 25 + 1 / 0.3) ** 2
    assert abs(np.trapezoid(rate, dx=1e-4) - (angle[-1] - angle[0])) < bound
    assert np.abs(np.diff(rate)).max() < 40 * (2 * np.pi * 25 + 1 / 0.3) * 1e-4, "the phase goes on"
    assert np.abs(rate[times < SECOND]).max() == 0.0


def test_faults_are_to_be_had_over_the_wire() -> None:
    chamber = SimulatedChamber(StationClock())
    assert chamber.handle("SIM:FAULT?") == "NONE"
    chamber.handle("SIM:FAULT REFUSE")
    chamber.handle("TEMP:SETP 60")
    assert chamber.setpoint_deg_c == 25.0
    assert (chamber.handle("SYST:ERR?") or "").startswith("-221")
    chamber.handle("SIM:FAULT ODD")
    assert (chamber.handle("SYST:ERR?") or "").startswith("-224")
    assert chamber.handle("SIM:FAULT?") == "REFUSE"
    chamber.handle("SIM:FAULT NONE")
    chamber.handle("TEMPERATURE:SETPOINT 60")
    assert chamber.setpoint_deg_c == 60.0


def test_a_port_that_is_taken_is_said() -> None:
    taken = pytest.raises(BadInput, match=r"simulated instrument D cannot listen at 127.0.0.1:\d+")
    with ScpiServer({"C": SimulatedChamber(StationClock())}) as server, taken:
        ScpiServer({"D": SimulatedChamber(StationClock())}, ports={"D": server.port("C")})
