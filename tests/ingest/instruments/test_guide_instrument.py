"""The instrument that the guide shows, in a file of its own, measures; and its procedure and station can be read."""

import re
import sys
import tomllib
from pathlib import Path

import msgspec
import pytest

import ingest.instruments
from ingest.instruments.base import instrument_kinds
from ingest.procedures.procedure import load_procedure
from ingest.simulator.scpi.device import SimulatedDevice
from ingest.simulator.scpi.server import ScpiServer
from ingest.station.station import load_station
from ingest.station_clock import StationClock

GUIDES = Path(__file__).parents[3] / "docs" / "how-to"


def block(guide: str, language: str, holds: str) -> str:
    blocks = re.findall(rf"```{language}\n(.*?)```", (GUIDES / guide).read_text(encoding="utf-8"), re.DOTALL)
    (found,) = (each for each in blocks if holds in each)
    return str(found)


def test_an_instrument_of_forty_lines_is_found_by_its_kind_and_measures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = block("instrument.md", "python", "class PressureGauge(")
    assert len(source.splitlines()) <= 40
    (tmp_path / "pressure_gauge.py").write_text(source)
    # the file is all that is added to the package
    monkeypatch.setattr(ingest.instruments, "__path__", [*ingest.instruments.__path__, str(tmp_path)])
    kind = instrument_kinds()["pressure_gauge"]
    monkeypatch.delitem(sys.modules, kind.__module__)
    monkeypatch.delattr(ingest.instruments, "pressure_gauge")
    clock = StationClock()
    device = SimulatedDevice("ACME,GAUGE,1,1", clock, {}, {"MEASure:PRESsure?": lambda: "1.25E-3"})
    shown = tomllib.loads(block("instrument.md", "toml", "pressure_gauge"))["instruments"]["gauge"]
    assert shown.pop("kind") == kind.kind
    with ScpiServer({"gauge": device}) as server:
        table = shown | {"resource": server.resource("gauge"), "sample_interval_s": 0.5}
        with kind("gauge", msgspec.convert(table, kind.options_type), clock) as gauge:
            (reading,) = gauge.sample()
    assert (reading.signal, reading.value) == ("pressure", 1.25e-3)
    assert "MEAS:PRES? 2" in device.lines


def test_the_procedure_and_the_station_shown_are_whole(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text(block("station.md", "toml", "bias_two_temperatures"), encoding="utf-8")
    steps = load_procedure(str(path)).steps()
    assert [step.settings["temperature"] for step in steps if step.words.step == "static"] == [-20.0, 50.0]
    assert sum(step.record_s for step in steps) == 3600.0
    path = tmp_path / "station.toml"
    path.write_text(block("station.md", "toml", "[instruments.chamber]"), encoding="utf-8")
    station = load_station(path)
    assert station.settings == {"temperature": "chamber"}
    assert station.buses["can"].bus.interface == "socketcan"
