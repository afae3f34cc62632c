"""Answers that are no values: lines more than asked for, garbled ones, and connections that end after each."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from uuid import UUID

import pytest

from ingest.instruments.power_supply import PowerSupply, PowerSupplyOptions
from ingest.station.sampling import Sampler
from ingest.station_clock import StationClock
from stream.batch import SampleBatch
from stream.errors import InstrumentError


class RepeatingSupply:
    """A supply of 12 V and 1.5 A behind a terminal server that sends some answers twice, the second 20 ms later."""

    def __init__(self, repeats: set[int]) -> None:
        self.repeats = repeats  # which of the voltages
        self.at_once: set[int] = set()  # of the voltages, those that are sent twice in one packet
        self.greets = self.closes = False
        self.garbled: set[int] = set()  # which of the currents
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.resource = f"TCPIP::127.0.0.1::{self._listening.getsockname()[1]}::SOCKET"
        self._voltages = self._currents = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                connection = self._listening.accept()[0]
            except OSError:
                return
            threading.Thread(target=self._answer, args=(connection,), daemon=True).start()

    def _answer(self, connection: socket.socket) -> None:
        def send(text: str) -> None:
            with suppress(OSError):
                connection.sendall(text.encode())

        if self.greets:
            threading.Timer(0.04, send, ("Welcome\n",)).start()
        with suppress(OSError), connection, connection.makefile("rb") as lines:
            for line in lines:
                if line == b"*IDN?\n":
                    send("X,Y,1,1\n")
                elif line == b"SYST:ERR?\n":
                    send('0,"No error"\n')
                elif line == b"MEAS:VOLT?\n":
                    self._voltages += 1
                    send("12.0\n" * (2 if self._voltages in self.at_once else 1))
                    if self._voltages in self.repeats:
                        threading.Timer(0.02, send, ("12.0\n",)).start()
                elif line == b"MEAS:CURR?\n":
                    time.sleep(0.05)
                    self._currents += 1
                    send("1.\x005#\n" if self._currents in self.garbled else "1.5\n")
                if self.closes and line != b"*CLS\n":
                    return

    def close(self) -> None:
        self._listening.close()


@pytest.fixture
def supply() -> Iterator[RepeatingSupply]:
    served = RepeatingSupply({3, 7})
    yield served
    served.close()


def of(supply: RepeatingSupply, interval_s: float) -> PowerSupply:
    options = PowerSupplyOptions(
        resource=supply.resource, max_voltage_v=20.0, max_current_a=3.0, sample_interval_s=interval_s
    )
    return PowerSupply("psu", options, StationClock())


def test_no_answer_of_a_turn_with_a_surplus_line_becomes_a_value(supply: RepeatingSupply) -> None:
    delivered: list[SampleBatch] = []
    reports: list[str] = []
    instrument = of(supply, 0.5)
    instrument.open()
    sampler = Sampler(instrument, "r1", UUID(int=1), delivered.append, reports.append)
    sampler.start()
    until = time.monotonic() + 20.0
    while time.monotonic() < until and sum("answers again" in each for each in reports) < 2:
        time.sleep(0.05)
    sampler.stop()
    values = {name: [v for each in delivered if each.signal == name for v in each.value_array] for name in
              ("supply_voltage", "supply_current")}  # fmt: skip
    assert set(values["supply_voltage"]) == {12.0}
    assert set(values["supply_current"]) == {1.5}
    assert sum("one line more than it was asked for" in each for each in reports) == 2
    assert any("answers again" in each for each in reports)


def test_a_surplus_line_that_comes_after_the_turn_is_reported_with_the_next(supply: RepeatingSupply) -> None:
    supply.repeats = {1}
    instrument = of(supply, 0.08)  # 20 ms are waited, the answer takes 30 ms more
    instrument.open()
    instrument.sample()
    time.sleep(0.2)
    with pytest.raises(InstrumentError, match="a value of that turn may be the answer to another query"):
        instrument.sample()
    assert [each.value for each in instrument.sample()] == [12.0, 1.5]
    instrument.close()


def test_a_surplus_line_in_the_packet_of_the_answer_is_seen(supply: RepeatingSupply) -> None:
    supply.repeats, supply.at_once = set(), {2}
    instrument = of(supply, 0.5)
    instrument.open()
    assert [each.value for each in instrument.sample()] == [12.0, 1.5]
    with pytest.raises(InstrumentError, match="a line without a query"):
        instrument.sample()
    assert [each.value for each in instrument.sample()] == [12.0, 1.5]
    instrument.close()


def test_a_greeting_after_the_connection_is_no_answer(supply: RepeatingSupply) -> None:
    supply.repeats, supply.greets = set(), True
    instrument = of(supply, 0.5)
    assert instrument.open() == "X,Y,1,1"
    for _ in range(2):
        assert [each.value for each in instrument.sample()] == [12.0, 1.5]
    assert instrument.connection.reconnects == 0
    instrument.close()


def test_a_garbled_answer_costs_no_other_signal_of_its_turn_a_value(supply: RepeatingSupply) -> None:
    supply.repeats, supply.garbled = set(), {2}
    delivered: list[SampleBatch] = []
    reports: list[str] = []
    instrument = of(supply, 0.1)
    instrument.open()
    sampler = Sampler(instrument, "r1", UUID(int=1), delivered.append, reports.append)
    sampler.start()
    until = time.monotonic() + 20.0
    while time.monotonic() < until and not any("has a value again" in each for each in reports):
        time.sleep(0.05)
    sampler.stop()
    count = {name: sum(len(each) for each in delivered if each.signal == name) for name in instrument.signals}
    assert count["supply_voltage"] == count["supply_current"] + 1
    assert len(reports) == 2
    assert "is not a number" in reports[0]
    assert "supply_current is left out until it has a value, other signals are kept" in reports[0]
    assert "supply_current has a value again, 1 of it is missing" in reports[1]
    instrument.close()


def test_an_instrument_that_closes_its_connection_after_each_answer_is_read_and_reported(
    supply: RepeatingSupply,
) -> None:
    """It could not be opened: what follows the identity met a closed connection."""
    supply.repeats, supply.closes = set(), True
    instrument = of(supply, 0.5)
    assert instrument.open() == "X,Y,1,1"
    for _ in range(3):
        assert not instrument.notes
        assert [each.value for each in instrument.sample()] == [12.0, 1.5]
    (note,) = instrument.notes
    assert "had to be connected again in 3 turns in a row" in note
    instrument.close()
