"""Disks, clocks and dates that stand in the way of a run, or are to be known of."""

import datetime as dt
from contextlib import ExitStack
from pathlib import Path

import pytest

from ingest.run.pipeline import EmbeddedPipeline
from ingest.station.checks import preflight as preflight_file
from ingest.station.checks.preflight import Preflight, preflight
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

    def __call__(
        self, due: str = "2090-01-01", now_ns: int = NOW_NS, free: int = 50 << 30, hours: float = 24.0, more: str = ""
    ) -> Preflight:
        path = self._folder / "station.toml"
        path.write_text(STATION.format(due=due) + more)
        station: Station = load_station(path)
        clock = station.make_clock()
        units = ("FOG-1", "FOG-2") if more else ()
        sources = StationSources(station, station.make_instruments(clock), clock, units)
        with ExitStack() as stack:
            return preflight(
                stack, station, {}, sources, folders=[self.store], now_ns=now_ns, duration_s=86400.0,
                store=self.store, recorded_s=3600 * hours, disk=SmallDisk(free),
            )  # fmt: skip


def test_a_disk_on_which_recording_would_pause_is_refused_where_the_store_is_not_made_yet(looked: Looked) -> None:
    looked()
    with pytest.raises(InstrumentError, match=r"300\.0 MB free of .* recording pauses below 268\.4 MB: free space"):
        looked(free=300_000_000)
    assert not looked.store.exists()


def test_a_run_that_the_disk_cannot_hold_is_warned_of(looked: Looked, tmp_path: Path) -> None:
    (tmp_path / "gyros.dbc").write_text(
        'VERSION ""\nBU_: X\nBO_ 257 IMU: 8 X\n SG_ Rate : 0|16@1- (0.01,0) [0|0] "deg/s" X\n'
        ' SG_ Counter : 16|16@1+ (1,0) [0|0] "" X\nBO_ 258 SLOW: 8 X\n SG_ Temp : 0|16@1- (0.01,0) [0|0] "degC" X\n'
    )
    message = '[[message]]\nmessage = "{}"\nids = {{"FOG-1" = {}, "FOG-2" = {}}}\nsignals = {{{}}}\n'
    (tmp_path / "gyros.toml").write_text(
        message.format("IMU", 1, 2, 'Rate = "rate"') + 'counter = {signal = "Counter", modulus = 65536}\n'
        "interval_s = 0.001\n" + message.format("SLOW", 3, 4, 'Temp = "temperature"')
    )
    bus = """
[buses.can]
dbc = ["gyros.dbc"]
mapping = "gyros.toml"
[buses.can.bus]
interface = "virtual"
channel = "room"
"""
    room = looked(free=1 << 30, more=bus, hours=24.0).room
    assert room is not None
    day_s, of_table = 86_400, 2
    # 2.4 bytes a sample, 85 a message of 50 ms; the table's are numbers, each a message
    needed = 2 * day_s * (1000 * 2.4 + 20 * 85) + of_table * day_s * (16 + 85)
    assert (room.samples, room.unknown_signals) == (2 * day_s * 1000 + of_table * day_s, 2)
    assert (abs(room.needed_bytes - needed) <= 1, room.free_bytes, room.warning) == (True, 1 << 30, None)
    (warning,) = (each for each in looked(free=1 << 30, more=bus, hours=72.0).warnings if "needs" in each)
    assert warning.startswith(
        "warning: the run needs about 2.2 GB for 518,918,400 samples, and more for 2 signals whose interval nothing "
        "states; 1.1 GB are free on the disk of "
    )


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
