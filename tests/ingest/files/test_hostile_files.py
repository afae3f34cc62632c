"""Files that no recorder and no person has written: said in a sentence, and what is good beside them is kept."""

import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ingest.can.database import load_database
from ingest.can.decode import MessageLayout
from ingest.can.logs.can_log import CanLog
from ingest.procedures.file import parse_procedure
from ingest.serial.frame_layout import decode_layout
from ingest.station.station import load_station
from storage.specifications.specification import parse_specification
from stream.errors import BadInput

DEEP = ["a = " + "[" * 50_000, "a = " + "{b = " * 5000, "a." * 100_000 + "b = 1", "a = " + "9" * 5000, "a = \udcff"]
GOOD_FRAMES = "(1700000000.000000) can0 100#0102\n(1700000000.010000) can0 100#0304\n"
DBC = """VERSION ""
NS_ :
BS_:
BU_: X
BO_ 256 M: 8 X
 SG_ Rate : 0|16@1- (0.01,0) [0|0] "deg/s" X
 SG_ Bad : {} [0|0] "V" X
"""


@pytest.mark.parametrize("text", DEEP)
def test_toml_that_no_person_has_written_is_bad_input(text: str, tmp_path: Path) -> None:
    path = tmp_path / "station.toml"
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(BadInput, match=r"station\.toml: "):
        load_station(path)
    for parse in (parse_specification, parse_procedure, decode_layout):
        with pytest.raises(BadInput, match=r"x\.toml"):
            parse(path.read_bytes(), "x.toml")


@pytest.mark.parametrize(
    "line",
    [
        "(nan) can0 100#01",
        "(1e300) can0 100#01",
        "(99999999999.0) can0 100#01",
        "(1700000000.005000) can99999999 100#01",
    ],
)
def test_frames_that_no_bus_has_are_counted_and_left_out(line: str, tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text(line + "\n" + GOOD_FRAMES)
    log = CanLog(path)
    assert sum(len(block) for block in log.blocks()) == 2
    assert (log.counts.data, log.counts.unusable, log.damage) == (2, 1, "")


def test_a_channel_whose_name_ends_in_many_digits_is_numbered(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text(GOOD_FRAMES.replace("can0", "can" + "9" * 5000))
    (block,) = CanLog(path).blocks()
    assert block.channel.tolist() == [0, 0]


@pytest.mark.long
@pytest.mark.parametrize(
    ("field", "why"),
    [
        (f"16|16@1- ({'9' * 400},0)", "too large for a number"),
        (f"16|16@1- (1,{'9' * 400})", "too large for a number"),
        ("16|16@1- (1e400,0)", "too large for a number"),
        ("16|65@1- (1,0)", "it has 65 bits"),
        ("600|16@1- (1,0)", "it ends beyond the 64 bytes of a frame"),
    ],
)
def test_a_signal_that_cannot_be_decoded_spoils_no_other(
    field: str, why: str, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    path = tmp_path / "x.dbc"
    path.write_text(DBC.format(field))
    layout = MessageLayout.of(load_database(path)[0])
    assert list(layout.signals) == ["Rate"]
    assert why in layout.unusable["Bad"]
    if "9" * 400 + ",0" in field:  # from the outside, once
        (tmp_path / "x.log").write_text(GOOD_FRAMES)
        done = gyrofleet("import", "x.log", "--dbc", "x.dbc", "--unit", "G-1", "--run", "r1", "--store", "S")
        assert done.code == 0, done.err
        assert "signal Bad: left out" in done.err
        scanned = gyrofleet("can", "scan", "x.log", "--dbc", "x.dbc", "--json")
        assert scanned.code == 0, scanned.err


@pytest.mark.parametrize("name", ["x.csv", "x.parquet", "x.mcap", "x.log"])
def test_a_folder_with_the_name_of_a_file_is_said_to_be_one(
    name: str, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    (tmp_path / name).mkdir()
    done = gyrofleet("import", name, "--unit", "G-1", "--run", "r1", "--store", "S")
    assert done.code == 1
    assert name in done.err


@pytest.mark.long
@pytest.mark.parametrize("name", ["x.csv", "x.parquet", "x.blf", "x.log"])
def test_a_pipe_is_no_file_to_wait_for(name: str, tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    os.mkfifo(tmp_path / name)
    options = ("--dbc", "x.dbc") if name.endswith(("blf", "log")) else ()
    (tmp_path / "x.dbc").write_text(DBC.format("16|16@1- (1,0)"))
    done = gyrofleet("import", name, *options, "--unit", "G-1", "--run", "r1", "--store", "S", timeout_s=30)
    assert done.code == 1
    assert f"{name}: a pipe or a device" in done.err


def packed_zeros(mebibytes: int) -> bytes:
    packer = zlib.compressobj(9)
    return b"".join([*(packer.compress(bytes(1 << 20)) for _ in range(mebibytes)), packer.flush()])


@pytest.mark.long
def test_a_log_that_unpacks_to_more_than_any_recorder_writes_is_refused(tmp_path: Path) -> None:
    """300 MiB of zeros in 300 KB."""
    packed = packed_zeros(300)
    assert len(packed) < 1 << 19
    container = struct.pack("<4sHHLLHHLL4x", b"LOBJ", 16, 1, 32 + len(packed), 10, 2, 0, 0, 300 << 20) + packed
    head = struct.pack("<4sL", b"LOGG", 144).ljust(144, b"\0")
    (tmp_path / "x.blf").write_bytes(head + container)
    zipped = struct.pack("<4s4xQQ2sBxLQQ", b"##DZ", 48 + len(packed), 0, b"DT", 0, 0, 300 << 20, len(packed)) + packed
    (tmp_path / "x.mf4").write_bytes(b"MDF     4.10    ".ljust(64, b"\0") + zipped)
    for name in ("x.blf", "x.mf4"):
        with pytest.raises(BadInput, match=rf"{name}: the part at byte .* unpacks to more than 256 MiB"):
            CanLog(tmp_path / name)


def test_frames_that_a_reader_leaves_out_are_reported_as_damage(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """python-can only logs them, which Python prints."""
    path = tmp_path / "x.trc"
    lines = [
        ";$FILEVERSION=1.1",
        "     1)      1841.0  Rx     0100  3  00 01 02",
        "     2)",
        "     3)      1851.0  Rx     0100  1  00",
    ]
    path.write_text("\n".join(lines) + "\n")
    log = CanLog(path)
    assert sum(len(block) for block in log.blocks()) == 2
    assert "1 of 4 lines cannot be read and are left out, the first is line 3, '2)': cells are missing" in log.damage
    assert capfd.readouterr() == ("", "")
