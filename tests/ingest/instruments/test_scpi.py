"""The SCPI connection, over real sockets and over pyvisa-sim."""

import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from ingest.instruments.scpi import ScpiConnection, ScpiOptions
from ingest.simulator.scpi.chamber import SimulatedChamber
from ingest.simulator.scpi.device import DeviceFault, SimulatedDevice
from ingest.simulator.scpi.server import ScpiServer
from ingest.station_clock import StationClock
from stream.errors import BadInput, InstrumentError

CLOCK = StationClock()


@pytest.fixture
def device() -> SimulatedDevice:
    return SimulatedChamber(CLOCK)


@pytest.fixture
def server(device: SimulatedDevice) -> Iterator[ScpiServer]:
    with ScpiServer({"C1": device}) as served:
        yield served


def connect(server: ScpiServer, timeout_s: float = 0.5, **more: object) -> ScpiConnection:
    options = ScpiOptions(resource=server.resource("C1"), timeout_s=timeout_s, **more)  # type: ignore[arg-type]
    return ScpiConnection("chamber C1", options, CLOCK)


def test_asks_over_raw_tcp_and_dates_the_answer_between_question_and_answer(server: ScpiServer) -> None:
    line = connect(server)
    assert line.open() == "GYROFLEET,SIMULATED CHAMBER,0,1"
    before = CLOCK.now_ns()
    value, answer = line.number("TEMP:ACT?")
    after = CLOCK.now_ns()
    line.close()
    assert value == 25.0
    assert before <= answer.t_ns - answer.round_trip_ns // 2 - 1
    assert answer.t_ns + answer.round_trip_ns // 2 - 1 <= after
    assert 0 < answer.round_trip_ns <= after - before


def test_a_command_with_its_question_for_errors_does_not_wait_for_a_delayed_acknowledgement(server: ScpiServer) -> None:
    line = connect(server)
    line.open()
    began = time.monotonic()
    for _ in range(20):
        line.command("TEMP:SETP 30")
    took = time.monotonic() - began
    line.close()
    assert took < 20 * 0.03, "Nagle's algorithm and delayed acknowledgements make it 40 ms each"


@pytest.mark.parametrize(("expected", "fits"), [("SIMULATED CHAMBER", True), ("^KEYSIGHT", False)])
def test_another_instrument_is_refused(server: ScpiServer, expected: str, fits: bool) -> None:
    line = connect(server, identity=expected)
    if fits:
        line.open()
        line.close()
        return
    with pytest.raises(InstrumentError, match=r"chamber C1 at TCPIP.*answered 'GYROFLEET.*expected was '\^KEYSIGHT'"):
        line.open()
    assert line._line is None


def test_an_error_in_the_queue_is_a_refusal_and_is_not_tried_twice(server: ScpiServer, device: SimulatedDevice) -> None:
    line = connect(server)
    line.open()
    device.lines.clear()
    with pytest.raises(InstrumentError, match=r"given 'TEMP:SETP 999' it reports -222,\"Data out of range\""):
        line.command("TEMP:SETP 999")
    with pytest.raises(InstrumentError, match="-113"):
        line.command("NONSENSE 1")
    assert list(device.lines).count("TEMP:SETP 999") == 1
    line.command("TEMP:SETP 30")
    line.close()


def test_an_old_error_is_not_blamed_on_a_new_command(server: ScpiServer, device: SimulatedDevice) -> None:
    device.handle("NONSENSE")
    line = connect(server)
    line.open()
    line.command("TEMP:SETP 30")
    line.close()


def test_a_dropped_connection_is_made_anew_once(server: ScpiServer, device: SimulatedDevice) -> None:
    line = connect(server, timeout_s=5.0)
    line.open()
    device.fault = DeviceFault.DROP
    began = time.monotonic()
    assert line.number("TEMP:ACT?")[0] == 25.0
    assert time.monotonic() - began < 3.0, "a closed connection is seen before the time-out"
    assert line.reconnects == 1
    line.close()


def test_an_unplugged_instrument_is_named_and_can_be_used_again(server: ScpiServer) -> None:
    line = connect(server)
    line.open()
    server.unplug("C1")
    for _ in range(2):
        with pytest.raises(InstrumentError, match=r"chamber C1 at TCPIP.*cannot be reached"):
            line.ask("TEMP:ACT?")
    server.plug("C1")
    assert line.number("TEMP:ACT?")[0] == 25.0
    line.close()
    with pytest.raises(InstrumentError, match=r"is not open: 'TEMP:ACT\?' was not sent"):
        line.ask("TEMP:ACT?")
    assert line.open()
    line.close()
    line.close()


def test_silence_is_an_error_after_the_time_out(server: ScpiServer, device: SimulatedDevice) -> None:
    line = connect(server)
    line.open()
    device.fault = DeviceFault.SILENT
    began = time.monotonic()
    with pytest.raises(InstrumentError, match=r"not answered within 0\.5 s"):
        line.ask("TEMP:ACT?")
    assert 0.9 < time.monotonic() - began < 3.0
    device.fault = DeviceFault.NONE
    assert line.number("TEMP:ACT?")[0] == 25.0
    line.close()


def test_garbage_is_no_number(server: ScpiServer, device: SimulatedDevice) -> None:
    line = connect(server)
    line.open()
    device.fault = DeviceFault.GARBAGE
    with pytest.raises(InstrumentError, match=r"asked 'TEMP:ACT\?' it answered .*garbage.*not a number"):
        line.number("TEMP:ACT?")
    line.close()


def test_a_late_or_second_answer_is_never_taken_for_the_next() -> None:
    """The instrument answers the first question twice, the second copy a little later."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        number = 0
        with suppress(OSError):  # the listener is closed while it waits for a second connection
            for _ in range(2):
                line, _ = listener.accept()
                with line, line.makefile("rb") as incoming:
                    while text := incoming.readline():
                        if text.strip() == b"*IDN?":
                            line.sendall(b"maker,model,0,1\n")
                            continue
                        number += 1
                        line.sendall(b"%d\n" % number * (2 if number == 1 else 1))

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    resource = f"TCPIP::127.0.0.1::{listener.getsockname()[1]}::SOCKET"
    line = ScpiConnection("meter M", ScpiOptions(resource=resource, check_errors=False, timeout_s=1.0), CLOCK)
    line.open()
    assert line.number("A?")[0] == 1.0
    time.sleep(0.05)
    assert line.number("B?")[0] == 2.0
    line.close()
    listener.close()


@pytest.mark.parametrize(
    ("answer", "complaint"),
    [
        ("9.9E37", "overloaded"),
        ("-9.9E+37", "overloaded"),
        ("9.91E37", "overloaded"),
        ("", "not a number"),
        ("1.2.3", "not"),
    ],
)
def test_what_says_that_it_cannot_measure_is_no_measurement(answer: str, complaint: str) -> None:
    device = SimulatedDevice("M", CLOCK, {}, {"READ?": lambda: answer})
    with ScpiServer({"C1": device}) as server:
        line = connect(server)
        line.open()
        with pytest.raises(InstrumentError, match=complaint):
            line.number("READ?")
        line.close()


def test_a_controller_that_acknowledges_its_commands(server: ScpiServer, device: SimulatedDevice) -> None:
    device._queries.insert(0, (re.compile("GO"), lambda: "OK: going"))
    line = connect(server, acknowledgement="^OK", check_errors=False)
    line.open()
    line.command("GO")
    line.close()
    other = connect(server, acknowledgement="^DONE", check_errors=False)
    other.open()
    with pytest.raises(InstrumentError, match="answered 'OK: going' instead of"):
        other.command("GO")
    other.close()


def test_what_to_do_after_a_connection_is_done_after_each() -> None:
    device = SimulatedChamber(CLOCK)
    with ScpiServer({"C1": device}) as server:
        options = ScpiOptions(resource=server.resource("C1"), timeout_s=0.5)
        line = ScpiConnection("chamber C1", options, CLOCK, lambda: line.command("TEMP:SETP 33"))
        line.open()
        device.fault = DeviceFault.DROP
        line.ask("TEMP:ACT?")
        line.close()
    assert list(device.lines).count("TEMP:SETP 33") == 2


def test_a_name_that_nobody_knows_and_a_resource_that_is_none() -> None:
    for resource in ("no resource", "TCPIP::127.0.0.1::1::SOCKET"):
        line = ScpiConnection("chamber C1", ScpiOptions(resource=resource, timeout_s=0.3), CLOCK)
        with pytest.raises(InstrumentError, match=f"chamber C1 at {resource}"):
            line.open()
        line.close()


def test_options_that_make_no_sense() -> None:
    with pytest.raises(BadInput, match="identity"):
        ScpiConnection("chamber C1", ScpiOptions(resource="x", identity="("), CLOCK)
    with pytest.raises(BadInput, match="timeout_s is 0"):
        ScpiConnection("chamber C1", ScpiOptions(resource="x", timeout_s=0.0), CLOCK)


def test_the_backend_is_chosen_in_the_options(tmp_path: Path) -> None:
    bench = tmp_path / "bench.yaml"
    bench.write_text(
        """
spec: "1.1"
devices:
  meter:
    eom:
      GPIB INSTR: {q: "\\n", r: "\\n"}
    error: ERROR
    dialogues:
      - {q: "*IDN?", r: "MAKER,METER,0,1"}
      - {q: "*CLS"}
      - {q: "SYST:ERR?", r: '0,"No error"'}
      - {q: "CONF", r: ""}
      - {q: "READ?", r: "+1.5E-3"}
resources:
  GPIB0::8::INSTR: {device: meter}
"""
    )
    line = ScpiConnection("meter M", ScpiOptions(resource="GPIB0::8::INSTR", backend=f"{bench}@sim"), CLOCK)
    assert line.open() == "MAKER,METER,0,1"
    assert line.number("READ?")[0] == 1.5e-3
    line.close()
