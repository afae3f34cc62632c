"""A serial port as a real (pseudo) terminal: read, lost and found again."""

import os
import time
import tty
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ingest.serial.serial_line import SerialLine
from ingest.station_clock import StationClock
from stream.batch import SampleBatch
from stream.errors import InstrumentError
from tests.ingest.instruments.serial_gyros import EPOCH, FIXED, fixed, rates


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def test_a_port_is_read_lost_and_found_again(tmp_path: Path) -> None:
    path = tmp_path / "tty"
    batches: list[SampleBatch] = []
    said: list[str] = []

    def plug() -> int:
        master, slave = os.openpty()
        tty.setraw(slave)
        path.unlink(missing_ok=True)
        path.symlink_to(os.ttyname(slave))
        os.close(slave)
        return master

    master = plug()
    line = SerialLine(
        str(path), 460_800, FIXED, "FOG-1", "r1", EPOCH, StationClock(), batches.append, said.append, batch_s=0.05
    )
    line.start()
    until(lambda: line._port is not None)
    for i in range(100):
        os.write(master, fixed(i, i) + (b"\x00noise" if i == 50 else b""))
        time.sleep(0.002)
    until(lambda: line.frames.counts.frames == 100)
    os.close(master)
    until(lambda: len(said) >= 1)
    master = plug()
    until(lambda: any("is there again" in text for text in said))
    for i in range(100, 150):
        os.write(master, fixed(i, i))
    until(lambda: line.frames.counts.frames == 150)
    line.stop()
    line.stop()
    os.close(master)
    assert [round(rate * 1e6) for rate in rates(batches)] == list(range(150))
    assert f"unit FOG-1 at {path}" in said[0]
    assert sum("tried again" in text for text in said) == 1
    assert any("6 bytes that belong to no frame" in text for text in said)
    times = np.concatenate([batch.time_array for batch in batches if batch.signal == "rate"])
    assert np.diff(times).min() > 0


def test_a_port_that_is_not_there_is_said(tmp_path: Path) -> None:
    said: list[str] = []
    line = SerialLine(
        str(tmp_path / "none"), 9600, FIXED, "FOG-1", "r1", EPOCH, StationClock(), lambda batch: None, said.append
    )
    with pytest.raises(InstrumentError, match=r"unit FOG-1 at .*none: the port cannot be opened"):
        line.open()
    line.start()
    until(lambda: len(said) == 1)
    line.stop()
