"""Names of VISA resources: those that nobody could open are refused with the station's file, others are left alone."""

from pathlib import Path

import pytest

from ingest.instruments.visa import resource_trouble
from ingest.simulator.station_files import write_station
from ingest.station.station import load_station
from stream.errors import BadInput


@pytest.mark.parametrize(
    "resource",
    [
        "TCPIP::192.168.1.20::5025::SOCKET",
        "tcpip0::chamber.local::INSTR",
        "ASRL/dev/ttyUSB0::INSTR",
        "ASRL3::INSTR",
        "GPIB0::8::INSTR",
        "USB::0x0957::0x1507::MY44000000::INSTR",
        "PXI0::CHASSIS1::SLOT4::INSTR",
        "COM3",
        "chamber",
    ],
)
def test_what_a_library_may_know_is_left_to_it(resource: str) -> None:
    assert resource_trouble(resource) is None


@pytest.mark.parametrize(
    ("resource", "said"),
    [
        ("TCPI::192.168.1.20::5025::SOCKET", "no interface 'TCPI', did you mean TCPIP?"),
        ("GPBI0::8::INSTR", "no interface 'GPBI', did you mean GPIB?"),
        ("192.168.1.20:5025", "write it as TCPIP::"),
        ("TCPIP::192.168.1.20::5025::SOKET", "too many parts"),
        ("TCPIP:192.168.1.20:5025:SOCKET", "write it as TCPIP::"),
        ("TCPIP::192.168.1.20:5025", "did you mean TCPIP::192.168.1.20::5025::SOCKET?"),
        ("TCPIP0::192.168.1.20:5025::SOCKET", "did you mean TCPIP::192.168.1.20::5025::SOCKET?"),
        (" ", "it is empty"),
    ],
)
def test_what_nobody_could_open_is_told_with_its_file_and_key(tmp_path: Path, resource: str, said: str) -> None:
    assert said in str(resource_trouble(resource))
    write_station(tmp_path, ["FOG-1"], speed=100.0, rate_hz=10.0, seed=1, now_s=1.8e9)
    path = tmp_path / "station.toml"
    lines = path.read_text().splitlines(keepends=True)
    at = next(i for i, line in enumerate(lines) if line.startswith("resource"))
    lines[at] = f'resource = "{resource}"\n'
    path.write_text("".join(lines))
    with pytest.raises(BadInput) as refused:
        load_station(path)
    assert f"{path}: instruments.chamber.resource is {resource!r}: " in str(refused.value)
    assert said in str(refused.value)
