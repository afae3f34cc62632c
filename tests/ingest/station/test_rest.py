"""Whether what was made safe is at rest: measured of tables and supplies, for as long as they come nearer to it."""

from collections.abc import Callable, Iterator
from itertools import chain, repeat
from types import MappingProxyType

import pytest

from ingest.instruments.base import Instrument, Moving, Options
from ingest.instruments.power_supply import PowerSupply, PowerSupplyOptions
from ingest.instruments.rate_table import RateTable, RateTableOptions
from ingest.instruments.vibration_table import VibrationTable, VibrationTableOptions
from ingest.simulator.scpi.device import DeviceFault, SimulatedDevice
from ingest.simulator.scpi.electrical import SimulatedSupply
from ingest.simulator.scpi.server import ScpiServer
from ingest.simulator.scpi.tables import SimulatedRateTable, SimulatedVibrationTable
from ingest.station.checks import rest
from ingest.station.checks.rest import still_moving
from ingest.station_clock import StationClock
from stream.errors import InstrumentError

CLOCK = StationClock(10.0)
SET = {"table": {"rate": 50.0}, "supply": {"voltage": 5.0, "output": 1.0}, "shaker": {"amplitude": 20.0}}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rest, "_PATIENCE_S", 0.1)
    monkeypatch.setattr(rest, "_LOOK_S", 0.005)


@pytest.fixture(params=sorted(SET))
def at_work(request: pytest.FixtureRequest) -> Iterator[tuple[Instrument, SimulatedDevice]]:
    """An instrument that turns or powers something, and its counterpart."""
    name: str = request.param
    devices = {"table": SimulatedRateTable, "supply": SimulatedSupply, "shaker": SimulatedVibrationTable}
    device = devices[name](CLOCK)
    with ScpiServer({name: device}) as server:
        resource, timeout_s = server.resource(name), 0.1
        makers: dict[str, Callable[[], Instrument]] = {
            "table": lambda: RateTable(
                name, RateTableOptions(resource=resource, timeout_s=timeout_s, max_rate_deg_per_s=200.0), CLOCK
            ),
            "supply": lambda: PowerSupply(
                name,
                PowerSupplyOptions(resource=resource, timeout_s=timeout_s, max_voltage_v=6.0, max_current_a=2.0),
                CLOCK,
            ),
            "shaker": lambda: VibrationTable(
                name,
                VibrationTableOptions(resource=resource, timeout_s=timeout_s, max_amplitude_deg_per_s=100.0),
                CLOCK,
            ),
        }
        with makers[name]() as instrument:
            for what, value in SET[name].items():
                instrument.set(what, value)
            CLOCK.sleep(3.0)
            yield instrument, device


def test_what_obeys_is_waited_for(at_work: tuple[Instrument, SimulatedDevice]) -> None:
    instrument, _ = at_work
    instrument.make_safe()
    assert still_moving(instrument) == ""
    assert instrument.moving() is None


def test_what_acknowledges_and_goes_on_is_named_with_what_is_measured(
    at_work: tuple[Instrument, SimulatedDevice],
) -> None:
    instrument, device = at_work
    device.fault = DeviceFault.UNSETTLED
    instrument.make_safe()
    trouble = still_moving(instrument)
    says = {
        "table": "rate is commanded to 0 deg/s, 50",
        "supply": "output is commanded off, 5 V measured",
        "shaker": "amplitude is commanded to 0 deg/s, 20 deg/s measured",
    }
    assert trouble.startswith(says[instrument.name])
    device.fault = DeviceFault.GARBAGE
    assert "what it does cannot be measured: " in still_moving(instrument)


class Heavy(Instrument):
    """A table that brakes slowly, and may not come to rest."""

    names = MappingProxyType({"en": "table", "zh": "台"})

    def __init__(self, rates: Iterator[float]) -> None:
        super().__init__("heavy", Options(), CLOCK)
        self._rates = rates

    def open(self) -> str:
        return "heavy"

    def close(self) -> None:
        pass

    def moving(self) -> Moving | None:
        rate = next(self._rates)
        if rate < 0.0:
            raise InstrumentError("garbled")
        return Moving(rate, f"{rate:g} deg/s measured") if rate else None


def test_one_that_comes_nearer_is_waited_for_within_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    slowly = [200.0 * 0.9**i for i in range(60)]  # at a look each 5 ms, three times as long as the patience
    slowly[10] = -1.0  # one answer is garbled
    assert still_moving(Heavy(chain(slowly, repeat(0.0)))) == ""
    assert still_moving(Heavy(chain(slowly, repeat(3.0)))) == "3 deg/s measured"
    monkeypatch.setattr(rest, "_MOST_S", 0.02)
    assert still_moving(Heavy(chain(slowly, repeat(0.0)))).endswith("deg/s measured")
