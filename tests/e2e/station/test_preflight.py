"""What stands in the way of a run is reported at once, before it has a name and before anything is written."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Bench = Any
Gyrofleet = Callable[..., Any]


@pytest.fixture
def station(bench: Bench, tmp_path: Path) -> Callable[..., tuple[object, ...]]:
    """Words of a run at the bench's station, with some of its file changed."""
    for name in ("gyros.dbc", "gyros.toml", "units.csv"):
        (tmp_path / name).write_bytes((bench.folder / name).read_bytes())

    def changed(*changes: tuple[str, str]) -> tuple[object, ...]:
        text = (bench.folder / "station.toml").read_text()
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "station.toml").write_text(text)
        files = ("--station", tmp_path / "station.toml", "--units", tmp_path / "units.csv")
        return ("run", "static_bias", *files, "--yes", "--json", "--set", "bias_record_s=10", "--set", "warm_up_s=0")

    return changed


@pytest.mark.long
def test_all_that_stands_in_the_way_is_told_at_once_and_nothing_is_written(
    bench: Bench, station: Callable[..., tuple[object, ...]], tmp_path: Path
) -> None:
    port = bench.simulation["ports"]["chamber"]
    words = station(('interface = "udp_multicast"', 'interface = "udp_multicats"'), (f"::{port}::", "::9::"))
    message = bench.refused(words, tmp_path / "S")
    assert message.startswith("2 things stand in the way of the run; nothing was written:\n- ")
    assert "chamber" in message
    assert "buses.can of" in message
    assert "python-can knows no such interface; it knows" in message
    assert not (tmp_path / "S").exists()


def test_a_run_is_checked_without_being_begun(
    gyrofleet: Gyrofleet, bench: Bench, station: Callable[..., tuple[object, ...]], tmp_path: Path
) -> None:
    words = station(('kind = "rate_table"', 'kind = "rate_table"\ncalibration_due = 2020-03-31'))
    done = gyrofleet(*words, "--check", "--store", "S")
    assert done.code == 0, done.err
    reported = json.loads(done.out)
    assert reported["event"] == "checked"
    assert set(reported["instruments"]) == {"chamber", "table", "supply", "vibration"}
    assert reported["warnings"] == ["warning: the rate_table table was due for calibration on 2020-03-31"]
    plain = gyrofleet(*(word for word in words if word != "--json"), "--check", "--store", "S")
    assert reported["warnings"][0] in plain.err
    assert " steps, 1 warning; nothing was written" in plain.out
    room = reported["room"]
    assert (room["samples"] > 0, room["needed_bytes"] > room["samples"], room["unknown_signals"]) == (True, True, 0)
    assert f"for {room['samples']:,} samples; " in " ".join(plain.out.split())
    assert not (tmp_path / "S").exists()
