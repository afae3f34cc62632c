"""Instruments are asked for what they measure before a run: what answers nothing, or no number, is an obstacle."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from ingest.simulator.scpi.device import DeviceFault, SimulatedDevice
from ingest.simulator.scpi.electrical import SimulatedVoltmeter
from ingest.simulator.scpi.server import ScpiServer
from ingest.simulator.scpi.tables import SimulatedRateTable
from ingest.station.checks.preflight import Preflight, preflight
from ingest.station.sources import StationSources
from ingest.station.station import load_station
from ingest.station_clock import StationClock
from stream.errors import BadInput, InstrumentError
from tests.ingest.station.test_preflight import SmallDisk

STATION = """
[station]
site = "plant"
name = "bench"

[instruments.{name}]
kind = "{kind}"
resource = "{resource}"
identity = "none"
check_errors = false
timeout_s = 0.1
{more}
"""
TABLE = ("rate_table", "max_rate_deg_per_s = 200")
CLOCK = StationClock()
Check = Callable[..., Preflight]


@pytest.fixture
def check(tmp_path: Path) -> Check:
    """Look at a station with one instrument without an identity."""

    def look(device: SimulatedDevice, kind: str, more: str, *waited: str) -> Preflight:
        with ScpiServer({"it": device}) as server, ExitStack() as stack:
            path = tmp_path / "station.toml"
            path.write_text(STATION.format(name="it", kind=kind, resource=server.resource("it"), more=more))
            station = load_station(path)
            instruments = station.make_instruments(CLOCK)
            sources = StationSources(station, instruments, CLOCK, ())
            return preflight(
                stack, station, instruments, sources, folders=[], now_ns=CLOCK.now_ns(), duration_s=60.0,
                waited=waited, disk=SmallDisk(50 << 30),
            )  # fmt: skip

    return look


def test_what_an_instrument_measures_is_shown(check: Check) -> None:
    found = check(SimulatedRateTable(CLOCK), *TABLE, "rate")
    assert found.measured == {"it": {"table_rate": "0 deg/s", "table_angle": "0 deg"}}
    without = check(SimulatedRateTable(CLOCK), *TABLE[:1], f'{TABLE[1]}\ncommands = {{ angle = "" }}')
    assert without.measured == {"it": {"table_rate": "0 deg/s"}}, "what it does not have is not asked for"
    with pytest.raises(InstrumentError, match="the query 'angle' is empty in the station file, and it is needed"):
        check(SimulatedRateTable(CLOCK), *TABLE[:1], f'{TABLE[1]}\ncommands = {{ angle = "" }}', "angle")


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        (DeviceFault.SILENT, r"'RATE:ACT\?' was not answered within 0.1 s"),
        (DeviceFault.GARBAGE, r"asked 'RATE:ACT\?' it answered .*, which is not a number; .*asked 'ANGL:ACT\?' it"),
    ],
)
def test_one_that_answers_nothing_or_no_number_stands_in_the_way(
    check: Check, fault: DeviceFault, complaint: str
) -> None:
    device = SimulatedRateTable(CLOCK)
    device.fault = fault
    with pytest.raises(InstrumentError, match=complaint):
        check(device, *TABLE)


def test_one_that_is_overloaded_before_the_run_is_warned_of(check: Check) -> None:
    """Its unit has no power yet."""
    device = SimulatedVoltmeter(CLOCK, source_v=lambda t_ns: np.full(len(t_ns), 50.0), noise_v=0.0)
    found = check(device, "voltmeter", "")
    assert found.measured == {"it": {}}
    (warning,) = (each for each in found.warnings if "overloaded" in each)
    assert "it is overloaded or cannot measure" in warning
    assert warning.endswith("; voltage has no value now")


def test_a_pattern_without_a_group_is_refused_with_the_file(check: Check) -> None:
    more = f"{TABLE[1]}\nanswers = {{ rate = '[-+0-9.]+' }}"
    with pytest.raises(BadInput, match=r"answer rate: '\[-\+0-9\.\]\+' has no group: put parentheses round the number"):
        check(SimulatedRateTable(CLOCK), TABLE[0], more)
