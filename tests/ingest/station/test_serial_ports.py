"""One serial device has one user: in a station's file by whichever of its paths, and among runs."""

import os
import subprocess
import sys
import tty
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from ingest.instruments.temperature_chamber import TemperatureChamber, TemperatureChamberOptions
from ingest.serial.serial_line import open_port
from ingest.station.checks.preflight import preflight
from ingest.station.sources import StationSources
from ingest.station.station import load_station
from ingest.station_clock import StationClock
from stream.errors import BadInput, InstrumentError
from tests.ingest.instruments.serial_gyros import FIXED
from tests.ingest.station.test_preflight import SmallDisk

LAYOUT = """
sync = "AA 55"
length = 12
interval_s = 0.005
fields = [{signal = "rate", at = 3, type = "i32", unit = "deg/s"}]
"""
LINE = '\n[lines.{name}]\nport = "{port}"\nunit = "{unit}"\nlayout = "frames.toml"\n'
CHAMBER = '\n[instruments.chamber]\nkind = "temperature_chamber"\nresource = "ASRL{port}::INSTR"\n'
HOLDS = """
import fcntl, sys
file = open(sys.argv[1], "rb+", buffering=0)
fcntl.flock(file, fcntl.LOCK_EX)
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def port() -> Iterator[str]:
    """A serial port that nothing comes from."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield os.ttyname(slave)
    os.close(slave)
    os.close(master)


def sources(folder: Path, text: str, units: tuple[str, ...] = ("FOG-1", "FOG-2")) -> StationSources:
    (folder / "frames.toml").write_text(LAYOUT)
    path = folder / "station.toml"
    path.write_text('[station]\nsite = "plant"\nname = "bench"\n' + text)
    station, clock = load_station(path), StationClock()
    return StationSources(station, station.make_instruments(clock), clock, units)


def test_one_device_has_one_unit_or_instrument(tmp_path: Path, port: str) -> None:
    link = tmp_path / "by-id"
    link.symlink_to(port)
    first = LINE.format(name="L1", port=port, unit="FOG-1")
    for other, named in ((port, port), (str(link), f"{port} and {link}")):
        second = LINE.format(name="L2", port=other, unit="FOG-2")
        with pytest.raises(BadInput, match=f"lines.L1 and lines.L2 are on one serial device, {named}: each would take"):
            sources(tmp_path, first + second)
        # a unit that is not tested takes nothing
        assert sources(tmp_path, first + second, ("FOG-1",)).cannot_be_opened() == []
        with pytest.raises(BadInput, match=r"lines.L1 and instruments.chamber are on one serial device"):
            sources(tmp_path, first + CHAMBER.format(port=other), ("FOG-1",))


def test_a_port_that_another_process_reads_is_in_use(tmp_path: Path, port: str) -> None:
    found = sources(tmp_path, LINE.format(name="L1", port=port, unit="FOG-1"), ("FOG-1",))
    chamber = TemperatureChamber(
        "C1", TemperatureChamberOptions(resource=f"ASRL{port}::INSTR", backend="@py"), StationClock()
    )
    words = [sys.executable, "-c", HOLDS, port]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        (trouble,) = found.cannot_be_opened()
        assert f"unit FOG-1 at {port}: the port is in use by another process" in trouble
        with pytest.raises(InstrumentError, match="the port is in use by another process"):
            chamber.open()
        other.communicate()
    assert found.cannot_be_opened() == []
    with closing(open_port(port, 115_200, FIXED, "first")), pytest.raises(InstrumentError, match=r"second: .* in use"):
        open_port(port, 115_200, FIXED, "second")  # what this program reads nobody else does


def test_unusable_files_and_ports_are_named_at_once(tmp_path: Path, port: str) -> None:
    lines = LINE.format(name="L1", port=port, unit="FOG-1"), LINE.format(name="L2", port="/dev/nope", unit="FOG-2")
    folder = LINE.format(name="L3", port=tmp_path, unit="FOG-3").replace("frames.toml", "nolayout.toml")
    bus = '\n[buses.can]\ndbc = ["no.dbc"]\nmapping = "no.toml"\nbus = { interface = "virtual", channel = "x" }\n'
    found = sources(tmp_path, "".join(lines) + folder + bus, ("FOG-1", "FOG-2", "FOG-3", "FOG-4"))
    mapping, layout, missing, directory = found.cannot_be_opened()
    assert "no.toml" in mapping
    assert "nolayout.toml: the layout of the frames cannot be read: No such file or directory" in layout
    assert "lines.L2 of" in missing
    assert "No such file or directory" in missing
    assert "lines.L3 of" in directory
    stops = r"(?s)4 things stand in the way of the run; .*no\.toml.*nolayout\.toml.*lines\.L2.*lines\.L3"
    station, clock = load_station(tmp_path / "station.toml"), StationClock()
    with ExitStack() as stack, pytest.raises(InstrumentError, match=stops):
        preflight(
            stack, station, {}, found, folders=[], now_ns=clock.now_ns(), duration_s=60.0, store=tmp_path / "S",
            disk=SmallDisk(50 << 30),
        )  # fmt: skip
