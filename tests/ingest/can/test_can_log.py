"""Logs written by python-can come back frame for frame, whole or cut."""

import copy
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from ingest.can.frames import EXTENDED
from ingest.can.logs.can_log import CanLog
from ingest.can.logs.structure import find_damage
from stream.errors import BadInput

START_S = 1_700_000_000.25
FORMATS = [".blf", ".asc", ".trc", ".log", ".mf4"]


def messages(count: int) -> list[can.Message]:
    """Frames of both kinds of id on two channels, every 1.25 ms."""
    return [
        can.Message(
            timestamp=START_S + i * 0.00125,
            arbitration_id=0x1ABCDEF0 if i % 3 == 0 else 0x100 + i % 3,
            is_extended_id=i % 3 == 0,
            data=i.to_bytes(4, "little")[: 4 if i % 2 else 3] + b"\x55",
            channel=i % 2,
        )
        for i in range(count)
    ]


def written(path: Path, frames: list[can.Message]) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # asammdf's own, on writing
        with can.Logger(path) as logger:
            for frame in frames:
                logger.on_message_received(frame)
    return path


def read(log: CanLog) -> list[tuple[int, int, int, bytes]]:
    return [
        (
            int(block.t_ns[i]),
            int(block.channel[i]),
            int(block.arbitration_id[i]),
            bytes(block.data[i][: block.length[i]]),
        )
        for block in log.blocks()
        for i in range(len(block))
    ]


@pytest.mark.long
@pytest.mark.parametrize("suffix", FORMATS)
def test_every_frame_of_every_format(tmp_path: Path, suffix: str) -> None:
    frames = messages(2500)
    log = CanLog(written(tmp_path / f"bench{suffix}", frames))
    found = read(log)
    assert (log.damage, log.counts.data) == ("", 2500)
    assert [(identifier, data) for _, _, identifier, data in found] == [
        (each.arbitration_id | (EXTENDED if each.is_extended_id else 0), bytes(each.data)) for each in frames
    ]
    assert [channel for _, channel, _, _ in found] == [each.channel for each in frames]
    times_ns = np.array([t_ns for t_ns, *_ in found])
    expected_ns = 1_700_000_000_250_000_000 + np.arange(2500) * 1_250_000
    # python-can's TRC has 0.1 ms and its own zero, its ASC the computer's time zone: right from frame to frame
    resolution_ns = 200_000 if suffix == ".trc" else 2_000
    if suffix in {".blf", ".log", ".mf4"}:
        assert np.abs(times_ns - expected_ns).max() <= resolution_ns
    assert np.abs(np.diff(times_ns) - 1_250_000).max() <= resolution_ns
    assert read(log) == found  # what was held is what was read


def test_fd_frames_of_64_bytes_and_frames_of_other_kinds(tmp_path: Path) -> None:
    frames = [
        can.Message(timestamp=START_S, arbitration_id=1, is_extended_id=False, data=bytes(range(64)), is_fd=True),
        can.Message(timestamp=START_S + 1, is_error_frame=True),
        can.Message(timestamp=START_S + 2, arbitration_id=2, is_extended_id=False, is_remote_frame=True, dlc=8),
        can.Message(timestamp=START_S + 3, arbitration_id=3, is_extended_id=False, data=b"\x01"),
    ]
    log = CanLog(written(tmp_path / "fd.blf", frames))
    assert [data for *_, data in read(log)] == [bytes(range(64)), b"\x01"]
    assert (log.counts.data, log.counts.errors, log.counts.remote) == (2, 1, 1)


@pytest.mark.long
def test_a_cut_blf_gives_what_is_good_and_says_so(tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    frames = messages(7_000)
    for frame in frames:
        frame.data[:] = random.bytes(len(frame.data))
    whole = written(tmp_path / "whole.blf", frames)
    expected = read(CanLog(whole))
    content = whole.read_bytes()
    containers = [i for i in range(len(content) - 16) if content[i : i + 4] == b"LOBJ" and content[i + 12] == 10]
    assert len(containers) >= 3
    for size in (len(content) - 1, containers[-1] + 500, containers[-1], containers[-1] + 7, containers[1] + 17):
        path = tmp_path / f"cut{size}.blf"
        path.write_bytes(content[:size])
        log = CanLog(path)
        found = read(log)
        assert found == expected[: len(found)]
        assert len(found) < len(expected) or size == len(content) - 1
        assert "cut short" in log.damage, size


def test_a_blf_with_a_bad_byte_gives_what_is_before(tmp_path: Path) -> None:
    path = written(tmp_path / "a.blf", messages(20_000))
    content = bytearray(path.read_bytes())
    second = content.index(b"LOBJ", 400)
    content[second + 200 : second + 240] = bytes(40)
    path.write_bytes(content)
    log = CanLog(path)
    found = read(log)
    assert 0 < len(found) < 20_000
    assert log.damage.startswith("damaged behind frame")


def test_a_blf_that_was_never_closed_is_said(tmp_path: Path) -> None:
    path = written(tmp_path / "a.blf", messages(100))
    content = bytearray(path.read_bytes())
    struct.pack_into("<QQL", content, 16, 144, 144, 0)  # as its writer begins it
    path.write_bytes(content)
    log = CanLog(path)
    assert len(read(log)) == 100
    assert "not closed" in log.damage


def test_an_unfinished_mf4_is_said_and_is_no_damage_if_its_records_are_complete(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mf4", messages(100))
    content = bytearray(path.read_bytes())
    content[:8] = b"UnFinMF "
    path.write_bytes(content)
    log = CanLog(path)
    assert len(read(log)) == 100
    assert "not finished" in log.note
    assert log.damage == ""
    begin = content.index(b"##DZ") + 32  # size and zipped size, zipped data behind them
    size, zipped_size = struct.unpack_from("<QQ", content, begin)
    cut = zlib.compress(zlib.decompress(content[begin + 16 : begin + 16 + zipped_size])[:-5], 9)
    struct.pack_into("<QQ", content, begin, size - 5, len(cut))
    content[begin + 16 : begin + 16 + len(cut)] = cut
    path.write_bytes(content)
    assert "may be missing" in find_damage(path)[0]


@pytest.mark.parametrize("suffix", [".log", ".asc"])
def test_a_text_log_that_ends_inside_a_line(tmp_path: Path, suffix: str) -> None:
    path = written(tmp_path / f"a{suffix}", messages(50))
    content = path.read_bytes().rstrip(b"\n")
    end = content.rindex(b"\n", 0, content.rindex(b"x\n") if b"x\n" in content else len(content))
    path.write_bytes(content[: end + 12])
    log = CanLog(path)
    assert 40 <= len(read(log)) <= 50
    assert log.damage


@pytest.mark.parametrize(
    ("name", "content", "reported"),
    [
        ("a.blf", b"no BLF at all, but long enough for a header" * 5, "cannot be read as a .blf"),
        ("a.mf4", b"nonsense" * 50, "cannot be read as a .mf4"),
        ("a.blf", b"", "the file is empty"),
        ("a.xyz", b"x", "unknown kind of CAN log"),
    ],
)
def test_what_is_no_log_is_refused(tmp_path: Path, name: str, content: bytes, reported: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInput, match=reported):
        CanLog(tmp_path / name)


def test_mf4_without_asammdf_says_what_to_install(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    (tmp_path / "a.mf4").write_bytes(b"MDF     ")
    with pytest.raises(BadInput, match="pip install"):
        CanLog(tmp_path / "a.mf4")


def recorder_mf4(records: bytes, flags: int = 0x65) -> bytes:
    """An MF4 as a recorder leaves it: one group of two kinds of records, the last block without its length."""

    def block(kind: bytes, links: list[int], content: bytes) -> bytes:
        head = struct.pack("<4s4xQQ", kind, 24 + 8 * len(links) + len(content), len(links))
        return head + struct.pack(f"<{len(links)}Q", *links) + content

    def channels(link: int, record: int, kind: int, octets: int) -> bytes:
        return block(b"##CG", [link, 0, 0, 0, 0, 0], struct.pack("<QQHH4xLL", record, 0, kind, 0, octets, 0))

    identification = b"UnFinMF 4.11    logger  ".ljust(60, b"\0") + struct.pack("<HH", flags, 0)
    header_size = len(block(b"##HD", [0] * 6, bytes(32)))
    group_at = 64 + header_size
    first_at = group_at + len(block(b"##DG", [0] * 4, bytes(8)))
    second_at = first_at + len(channels(0, 1, 0, 4))
    data_at = second_at + len(channels(0, 2, 1, 0))
    return b"".join(
        [
            identification,
            block(b"##HD", [group_at, 0, 0, 0, 0, 0], bytes(32)),
            block(b"##DG", [0, first_at, data_at, 0], b"\1" + bytes(7)),
            channels(second_at, 1, 0, 4),
            channels(0, 2, 1, 0),
            struct.pack("<4s4xQQ", b"##DT", 24, 0),
            records,
        ]
    )


@pytest.mark.parametrize(
    ("records", "is_complete"),
    [
        (b"", True),
        (b"\1abcd\1efgh", True),
        (b"\1abcd\2" + struct.pack("<L", 3) + b"xyz\1efgh", True),
        (b"\1abcd\1efg", False),
        (b"\1abcd\2" + struct.pack("<L", 3) + b"xy", False),
        (b"\1abcd\2" + b"\3\0", False),
        (b"\1abcd\7", False),
    ],
)
def test_records_of_an_unfinished_mf4_are_whole_or_not(tmp_path: Path, records: bytes, is_complete: bool) -> None:
    path = tmp_path / "a.mf4"
    path.write_bytes(recorder_mf4(records))
    damage, note = find_damage(path)
    assert ("complete" in note, "may be missing" in damage) == (is_complete, not is_complete)
    path.write_bytes(recorder_mf4(records, flags=0x75))  # the list of data blocks is not up to date either
    assert "may be missing" in find_damage(path)[0]


@pytest.mark.parametrize("suffix", FORMATS)
def test_frames_sent_and_received_are_read_once(tmp_path: Path, suffix: str) -> None:
    frames = [frame for each in messages(40) for frame in (each, copy.copy(each))]
    for echo in frames[1::2]:
        echo.timestamp, echo.is_rx = echo.timestamp + 0.0002, False
    frames[41].data = bytearray(len(frames[41].data))  # what was sent is not what was received
    log = CanLog(written(tmp_path / f"bench{suffix}", frames))
    found = read(log)
    assert [data for *_, data in found] == [
        bytes(each.data) for each in [*frames[:41:2], *frames[41:43], *frames[44::2]]
    ]
    assert (log.counts.data, log.counts.echoes) == (41, 39)
