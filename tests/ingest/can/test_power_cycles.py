"""A device that is powered off and on within a log or a run: its counter begins again, its samples keep their times."""

import json
import threading
import time
from pathlib import Path
from uuid import UUID

import can
import numpy as np
import pytest
from click.testing import CliRunner

from gyrofleet import main
from ingest.can.bus.bus import CanBus, CanBusOptions
from ingest.can.mapping import CanMapping
from ingest.can.stream import CanDecoder
from ingest.station_clock import StationClock
from stream.batch import SampleBatch

START_S, INTERVAL_S = 1_700_000_000.0, 0.02
DBC = """VERSION ""

NS_ :

BS_:

BU_: GYRO HOST

BO_ 256 GYRO: 6 GYRO
 SG_ RATE : 0|32@1- (1E-3,0) [0|0] "deg/s" HOST
 SG_ COUNTER : 32|16@1+ (1,0) [0|0] "" HOST
"""
MAPPING = """
[[message]]
message = "GYRO"
ids = { "FOG-1" = 0x100 }
signals = { RATE = "rate" }
counter = { signal = "COUNTER", modulus = 65536 }
interval_s = 0.02
"""


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    (tmp_path / "gyro.dbc").write_text(DBC)
    (tmp_path / "map.toml").write_text(MAPPING)
    return tmp_path


def frame(slot: int, counter: int) -> can.Message:
    """The value says when it was measured, ms."""
    body = (slot * 20).to_bytes(4, "little", signed=True) + (counter % 65536).to_bytes(2, "little")
    return can.Message(timestamp=START_S + slot * INTERVAL_S, arbitration_id=0x100, is_extended_id=False, data=body)


@pytest.mark.parametrize("off_s", [0.3, 10.0, 200.0])
@pytest.mark.parametrize("first", [0, 20_000, 60_000])
@pytest.mark.in_gate("0-0.3", "60000-200.0")
def test_a_log_with_power_cycles_has_every_sample_at_its_time(bench: Path, first: int, off_s: float) -> None:
    slots = [np.arange(3000), 3000 + round(off_s / INTERVAL_S) + np.arange(4000)]
    with can.Logger(bench / "bench.blf") as logger:
        for counter, part in zip((first, 0), slots, strict=True):
            for i, slot in enumerate(part.tolist()):
                logger.on_message_received(frame(slot, counter + i))
    words = ["import", "bench.blf", "--dbc", "gyro.dbc", "--mapping", "map.toml", "--store", "S", "--json"]
    paths = [str(bench / word) if word in {"bench.blf", "gyro.dbc", "map.toml", "S"} else word for word in words]
    done = CliRunner().invoke(main, paths)
    assert done.exit_code == 0, done.output
    (message,) = json.loads(done.stdout.splitlines()[-1])["files"][0]["frames"]["messages"]
    assert (message["decoded"], message["repeated"], message["restarts"]) == (7000, 0, 1)
    query = "select count(*) as n, max(abs(t_ns / 1e6 - 1.7e12 - value * 1000)) as off_ms from samples"
    asked = CliRunner().invoke(main, ["sql", query, "--store", str(bench / "S"), "--json"])
    (row,) = json.loads(asked.stdout)
    assert row["n"] == 7000
    assert row["off_ms"] < 1.0


def test_a_bus_reports_what_the_counters_show(bench: Path) -> None:
    plan = CanMapping([bench / "gyro.dbc"], bench / "map.toml").plan()
    decoder = CanDecoder(plan, run="r1", epoch_of=lambda _: UUID(int=1))
    batches: list[SampleBatch] = []
    reports: list[str] = []
    enough = threading.Event()

    def report(text: str) -> None:
        reports.append(text)
        enough.set()

    options = CanBusOptions(interface="virtual", channel="power-cycles")
    with (
        CanBus(options, StationClock(), decoder, batches.append, report, frame_counts=lambda: decoder.counts.messages),
        can.Bus("power-cycles", interface="virtual", ignore_config=True) as sender,
    ):
        for counter in (*range(700, 800), *range(806, 900), *range(200)):
            sender.send(frame(0, counter))
        assert enough.wait(20)
        time.sleep(0.3)
    told = " ".join(reports)
    assert "unit FOG-1, message GYRO" in told
    assert "6 frames lost" in told
    assert "1 restarts of its counter" in told
    assert sum(map(len, batches)) >= 392
