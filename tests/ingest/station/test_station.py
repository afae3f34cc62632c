"""Station files beyond what the command line is tested with: what a good one says, and who may use it."""

import datetime as dt
import json
import re
from pathlib import Path

import pytest

from ingest.simulator.station_files import write_station
from ingest.station.station import SlotTable, Station, load_station
from ingest.station.units_file import in_fixtures, parse_units
from stream.errors import BadInput


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_station(tmp_path, ["FOG-1", "FOG-2"], speed=100.0, rate_hz=10.0, seed=1, now_s=1.8e9)
    return tmp_path


def changed(folder: Path, old: str, new: str) -> Station:
    path = folder / "station.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return load_station(path)


def test_a_simulated_station_is_read_as_it_was_written(folder: Path) -> None:
    station = load_station(folder / "station.toml")
    assert station.settings == {
        "temperature": "chamber", "rate": "table", "angle": "table", "voltage": "supply", "current_limit": "supply",
        "output": "supply", "frequency": "vibration", "amplitude": "vibration",
    }  # fmt: skip
    assert list(station.slots) == ["S1", "S2"]
    clock = station.make_clock()
    assert clock.at_ns(1.8e9 + 2.0) == round(1.8e9 * 1e9) - 30 * 86_400 * 10**9 + 200 * 10**9
    assert station.beside("gyros.dbc") == folder / "gyros.dbc"


def test_files_that_are_there_stay_as_they_are(folder: Path) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    write_station(folder, ["OTHER"], speed=7.0, rate_hz=1.0, seed=9, now_s=1.9e9)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_day_may_stand_without_quotes(folder: Path) -> None:
    station = changed(folder, 'kind = "rate_table"', 'kind = "rate_table"\ncalibration_due = 2026-11-20')
    day = station.instruments["table"][1].calibration_due
    assert day == "2026-11-20"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('time_zone = "UTC"', 'time_zone = ""', "station.time_zone is ''"),
        ('time_zone = "UTC"', 'time_zone = "../../etc/passwd"', "time_zone"),
        ("speed = 100.0", "speed = nan", "clock.speed is nan"),
        ("latitude_deg = 39.9", "latitude_deg = 139.9", "between -90 and 90"),
        ("latitude_deg = 39.9", "latitude_deg = nan", "between -90 and 90"),
        ("sample_interval_s = 5.0", "sample_interval_s = nan", "instruments.table.sample_interval_s is nan"),
        ("sample_interval_s = 5.0", 'calibration_due = "soon"', "instruments.table"),
        (
            "sample_interval_s = 5.0",
            'calibration_due = "2027-13-31"',
            "instruments.table (a rate_table): calibration_due is '2027-13-31': month must be in 1..12; write it as",
        ),
        (
            "[station]",
            '[lines.L1]\nport = "x"\nunit = "F"\nlayout = "l.toml"\nbaud = 0\n[station]',
            "lines.L1.baud is 0; it is more than 0 bit/s",
        ),
        ('kind = "rate_table"', 'name = "rate_table"', "instruments.table.kind is None"),
        ('name = "bench"', 'name = "a/b"', "station 'a/b' cannot be used as a name"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(folder: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(BadInput) as refused:
        changed(folder, old, new)
    assert said in str(refused.value)


def test_a_station_is_held_by_one_run_and_free_after_it(folder: Path) -> None:
    station, again = load_station(folder / "station.toml"), load_station(folder / "station.toml")
    busy = pytest.raises(BadInput, match=r"another gyrofleet run is at work at station bench")
    with station.held(), busy, again.held():
        pass
    with again.held():
        pass


STATED = (
    'kind = "rate_table"\nserial = "RT-17"\ncertificate = "LL-1"\nuncertainty.rate = { U = 0.01, unit = "percent" }'
)


def test_uncertainties_are_kept_in_the_unit_of_their_quantity(folder: Path) -> None:
    station = changed(folder, 'kind = "rate_table"', STATED)
    (table,) = [each for each in json.loads(station.standards_details["standards"]) if each["name"] == "table"]
    assert (table["serial"], table["certificate"], table["kind"]) == ("RT-17", "LL-1", "rate_table")
    (rate,) = table["quantities"]
    assert (rate["u"], rate["unit"], rate["distribution"]) == (50.0, "ppm", "normal")


def test_a_standard_that_is_not_connected_can_be_out_of_date(folder: Path) -> None:
    path = folder / "station.toml"
    path.write_text(path.read_text() + "\n[standards.level]\ncalibration_due = 2026-01-31\n")
    late = load_station(path).overdue(dt.date(2026, 2, 1), dt.date(2026, 2, 2))
    assert late == ["the standard level was due for calibration on 2026-01-31"]


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ('rate = { U = 1, unit = "ppm", half_width = 2 }', "either U with k, or half_width"),
        ('rate = { U = 5, k = 2, distribution = "uniform", unit = "ppm" }', "either U with k, or half_width"),
        ('rate = { half_width = 20, k = 3, unit = "ppm" }', "either U with k, or half_width"),
        ('rate = { unit = "ppm" }', "either U with k, or half_width"),
        ('rate = { U = 1, unit = "degC" }', "it is kept in ppm"),
        ('rat = { U = 1, unit = "ppm" }', "did you mean rate"),
        ('rate = { U = -1, unit = "ppm" }', "from 0"),
        ('rate = { U = 1, k = 0, unit = "ppm" }', "above 0"),
        ('rate = { U = nan, unit = "ppm" }', "from 0"),
        ('rate = { half_width = 1, distribution = "even", unit = "ppm" }', "instruments.table"),
    ],
)
def test_uncertainties_that_cannot_be_meant_are_refused(folder: Path, stated: str, said: str) -> None:
    with pytest.raises(BadInput, match=re.escape(said)):
        changed(folder, 'kind = "rate_table"', f'kind = "rate_table"\nuncertainty.{stated}')


def test_two_instruments_at_one_address_are_refused(folder: Path) -> None:
    text = (folder / "station.toml").read_text()
    chamber, table = re.findall(r'resource = "(TCPIP[^"]*)"', text)[:2]
    (folder / "station.toml").write_text(text.replace(chamber, table))
    with pytest.raises(BadInput, match="have the same resource"):
        load_station(folder / "station.toml")


def test_a_unit_is_in_the_fixture_of_its_slot() -> None:
    slots = {"A1": SlotTable(fixture="plate-7"), "A2": SlotTable()}
    units = parse_units(b"serial,slot,fixture\nF1,A1,\nF3,A2,\nF4,B1,own\n", "u").entries
    assert [each.fixture for each in in_fixtures(units, slots)] == ["plate-7", None, "own"]
