"""A serial port as a real (pseudo) terminal: read, lost and found again."""

import os
import time
import tty
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ingest.serial.serial_line import SerialLine
from ingest.source_fault import Fault
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


def test_bytes_that_make_no_frame_are_no_silence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another checksum, as of text lines, in a tenth of the time."""
    monkeypatch.setattr("ingest.serial.serial_line._NO_FRAME_S", 1.0)
    master, slave = os.openpty()
    tty.setraw(slave)
    line = SerialLine(
        os.ttyname(slave), 9600, FIXED, "FOG-1", "r1", EPOCH, StationClock(), lambda batch: None, lambda text: None,
        batch_s=0.02, layout_name="fixed.toml",
    )  # fmt: skip
    line.start()
    assert line.faults() == {}
    sent = 0

    def is_named() -> bool:
        nonlocal sent
        sent += os.write(master, b"$G,+00000001,000\r\n")
        time.sleep(0.02)
        return bool(line.faults())

    until(is_named)
    [(key, text)] = line.faults().items()
    assert key == ("FOG-1", Fault.NO_FRAME)
    begun = text.index(" bytes have come in 1 s and none made a frame of fixed.toml: check sync, length and checksum")
    assert 0 < int(text[:begun].rpartition(" ")[2].replace(",", "")) <= sent
    assert "baud = 9600" in text
    os.write(master, fixed(0, 0))
    until(lambda: not line.faults())
    line.stop()
    os.close(master)
    os.close(slave)
