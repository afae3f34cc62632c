"""Station files beyond what the command line is tested with: what a good one says, and who may use it."""

from pathlib import Path

import pytest

from ingest.simulator.station_files import write_station
from ingest.station.station import Station, load_station
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
