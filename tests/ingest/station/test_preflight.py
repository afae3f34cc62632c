"""Disks, clocks and dates that stand in the way of a run, or are to be known of."""

import datetime as dt
from contextlib import ExitStack
from pathlib import Path

import pytest

from ingest.run.pipeline import EmbeddedPipeline
from ingest.station import preflight as preflight_file
from ingest.station.preflight import Preflight, preflight
from ingest.station.sources import StationSources
from ingest.station.station import Station, load_station
from storage.segments.disk import Disk, Space
from stream.errors import InstrumentError
from stream.events import RunEnded, RunStarted
from stream.identity import Place, event_key

NOW_NS = 1_790_000_000 * 10**9
STATION = """
[station]
site = "plant"
name = "bench"

[instruments.table]
kind = "rate_table"
resource = "TCPIP::127.0.0.1::9::SOCKET"
max_rate_deg_per_s = 400
calibration_due = {due}
"""


class SmallDisk(Disk):
    """A disk with some room."""

    def __init__(self, free: int) -> None:
        self._free = free

    def space(self, folder: Path) -> Space:
        assert folder.is_dir()
        return Space(self._free, 100 << 30)


@pytest.fixture
def looked(tmp_path: Path) -> "Looked":
    """Look at a station without instruments that answer."""
    return Looked(tmp_path)


class Looked:
    """Looks at a station whose instruments are taken for opened."""

    def __init__(self, folder: Path) -> None:
        self.store = folder / "S"
        self._folder = folder

    def __call__(self, due: str = "2090-01-01", now_ns: int = NOW_NS, free: int = 50 << 30) -> Preflight:
        path = self._folder / "station.toml"
        path.write_text(STATION.format(due=due))
        station: Station = load_station(path)
        clock = station.make_clock()
        sources = StationSources(station, {}, clock, ())
        with ExitStack() as stack:
            return preflight(
                stack, station, {}, sources, folders=[self.store], now_ns=now_ns, duration_s=86400.0,
                disk=SmallDisk(free),
            )  # fmt: skip


def test_a_disk_on_which_recording_would_pause_is_refused_where_the_store_is_not_made_yet(looked: Looked) -> None:
    looked()
    with pytest.raises(InstrumentError, match=r"300\.0 MB free of .* recording pauses below 268\.4 MB: free space"):
        looked(free=300_000_000)
    assert not looked.store.exists()


def test_a_clock_that_was_never_set_or_lies_before_the_newest_run_is_refused(looked: Looked) -> None:
    with pytest.raises(InstrumentError, match="clock shows 1970-01-01 00:01 UTC: set it"):
        looked(now_ns=60 * 10**9)
    with EmbeddedPipeline(looked.store, "test") as pipeline:
        for run, simulated, ended_ns in (("real", False, NOW_NS), ("tried", True, 2 * NOW_NS)):
            started = RunStarted(run=run, t_ns=ended_ns - 10**12, source="station bench", simulated=simulated)
            pipeline.send_event(event_key(Place("plant", "bench")), started)
            pipeline.send_event(event_key(Place("plant", "bench")), RunEnded(run=run, t_ns=ended_ns))
        pipeline.finish()
    looked()
    looked(now_ns=NOW_NS - 200 * 10**9)
    with pytest.raises(InstrumentError, match=f"a run of a station that ended {_minute(NOW_NS)} UTC: set the clock"):
        looked(now_ns=NOW_NS - 86400 * 10**9)


def test_a_calibration_that_ends_before_the_run_does_is_warned_of(
    looked: Looked, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(preflight_file, "_clock_state", lambda: 0)
    assert looked().warnings == ()
    (warning,) = looked(due="2026-09-21").warnings
    assert warning == "warning: the rate_table table is due for calibration on 2026-09-21, before the run ends"
    (warning,) = looked(due="2026-09-20").warnings
    assert warning == "warning: the rate_table table was due for calibration on 2026-09-20"


def test_a_clock_that_nothing_keeps_right_is_warned_of(looked: Looked, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(preflight_file, "_clock_state", lambda: 5)
    (warning,) = looked().warnings
    assert "nothing keeps the computer's clock right" in warning
    monkeypatch.setattr(preflight_file, "_clock_state", lambda: None)
    assert looked().warnings == ()


def _minute(t_ns: int) -> str:
    return f"{dt.datetime.fromtimestamp(t_ns / 1e9, dt.UTC):%Y-%m-%d %H:%M}"
