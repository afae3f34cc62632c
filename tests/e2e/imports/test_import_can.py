"""CAN logs of vehicles and machines: message variants, J1939, unfinished MF4; imported and asked in SQL."""

import struct
import warnings
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import can
import pytest

Run = Callable[..., Any]
START_S = 1_700_000_000.0
HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: Gyro\n'
SIGNAL = ' SG_ {} : {}|16@1- ({},0) [0|0] "{}" Gyro\n'
VARIANTS = (
    HEAD
    + "BO_ 257 IMU: 8 Gyro\n"
    + SIGNAL.format("YawRate", 0, 0.01, "deg/s")
    + "\nBO_ 258 IMU: 8 Gyro\n"
    + SIGNAL.format("YawRate", 16, 0.5, "deg/s")
)
J1939 = (
    HEAD
    + f"BO_ {0x98F00AFE} GYRO: 8 Gyro\n"
    + SIGNAL.format("YawRate", 0, 0.01, "deg/s")
    + f"\nBO_ {0x98EAFFFE} POLL: 8 Gyro\n"
    + SIGNAL.format("Temp", 0, 0.1, "degC")
    + 'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    + 'BA_DEF_DEF_ "VFrameFormat" "J1939PG";\n'
)


def log(path: Path, frames: Iterable[tuple[int, bytes]]) -> Path:
    """Frames of an id and data, 10 ms apart."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with can.Logger(path) as logger:
            for i, (identifier, data) in enumerate(frames):
                is_extended = identifier > 0x7FF
                message = can.Message(START_S + i * 0.01, identifier, is_extended_id=is_extended, data=data)
                logger.on_message_received(message)
    return path


def shorts(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}h", *values).ljust(8, b"\0")


def sums(gyrofleet: Run) -> dict[tuple[str, str], tuple[int, float]]:
    """Number and sum of the samples of each unit and signal."""
    query = "select unit, signal, count(*) n, round(sum(value), 6) total from samples group by all order by all"
    rows = gyrofleet("sql", query, "--json").json
    return {(row["unit"], row["signal"]): (row["n"], row["total"]) for row in rows}


@pytest.fixture
def imported(gyrofleet: Run, tmp_path: Path) -> Callable[..., Any]:
    """Import a log by the text of its database."""

    def do(path: Path, dbc: str, *more: object, code: int = 0) -> Any:
        (tmp_path / "a.dbc").write_text(dbc)
        done = gyrofleet("import", path, "--dbc", "a.dbc", "--run", "r", *more, "--json")
        assert done.code == code, done.err + done.out
        return done.json["files"][0] if code == 0 else done.json["error"]["message"]

    return do


@pytest.mark.long
@pytest.mark.parametrize(("identifier", "total"), [(0x101, 0.45), (0x102, 112.5)])
def test_the_variant_of_a_message_that_occurs_is_taken(
    gyrofleet: Run, tmp_path: Path, imported: Run, identifier: int, total: float
) -> None:
    path = log(tmp_path / "a.blf", [(identifier, shorts(i, 5 * i)) for i in range(10)])
    found = imported(path, VARIANTS, "--unit", "U1")
    assert sums(gyrofleet) == {("U1", "yawrate"): (10, total)}
    assert f"0x{identifier:03X} occurs in the log and is taken" in found["remarks"][0]


def test_message_chooses_a_variant(gyrofleet: Run, tmp_path: Path, imported: Run) -> None:
    path = log(tmp_path / "a.blf", [(0x101 + i % 2, shorts(i, 5 * i)) for i in range(10)])
    refused = imported(path, VARIANTS, "--unit", "U1", code=1)
    assert "2 variants of message IMU occur in the log: 0x101, 0x102; choose one with --message IMU=0x101" in refused
    for wrong, text in (
        ("IMU=0x103", "no variant has id 0x103"),
        ("IMV=1", "no message of that name"),
        ("IMU=a", "id"),
    ):
        assert text in imported(path, VARIANTS, "--unit", "U1", "--message", wrong, code=1)
    found = imported(path, VARIANTS, "--unit", "U1", "--message", "IMU=0x102")
    assert sums(gyrofleet) == {("U1", "yawrate"): (5, 62.5)}
    assert found["frames"]["unknown"] == {str(0x101): 5}


@pytest.mark.long
def test_a_mapping_chooses_a_variant_by_its_id(gyrofleet: Run, tmp_path: Path, imported: Run) -> None:
    path = log(tmp_path / "a.blf", [(0x101 + i % 2, shorts(i, 5 * i)) for i in range(10)])
    entry = '[[message]]\nmessage = "IMU"\nunit = "{}"\nid = {}\nsignals = {{ YawRate = "rate" }}\n'
    (tmp_path / "map.toml").write_text(entry.format("A", "0x101") + entry.format("B", "0x102"))
    imported(path, VARIANTS, "--mapping", "map.toml")
    assert sums(gyrofleet) == {("A", "rate"): (5, 0.2), ("B", "rate"): (5, 62.5)}


@pytest.mark.long
def test_j1939_messages_are_known_by_their_pgn(gyrofleet: Run, tmp_path: Path, imported: Run) -> None:
    """Priorities 3 and 6, destination addresses 0x21 and 0xFF: the same messages, of one source."""
    frames = [(0x0CF00A33 if i % 2 else 0x18F00A33, shorts(i)) for i in range(10)]
    frames += [(0x18EA2133 if i % 2 else 0x18EAFF33, shorts(i)) for i in range(10)]
    found = imported(log(tmp_path / "a.blf", [*frames, (0x18FEF133, shorts(1))]), J1939, "--unit", "U1")
    assert sums(gyrofleet) == {("U1", "temp"): (10, 4.5), ("U1", "yawrate"): (10, 0.45)}
    assert found["frames"]["unknown"] == {str(0x18FEF133 | 1 << 31): 1}
    assert sum(count["decoded"] for count in found["frames"]["messages"]) == 20


@pytest.mark.long
def test_j1939_sources_are_told_apart(gyrofleet: Run, tmp_path: Path, imported: Run) -> None:
    path = log(tmp_path / "a.blf", [(0x18F00A30 + i % 3, shorts(100 * (i % 3) + 1)) for i in range(30)])
    found = imported(path, J1939, "--unit", "U1")
    assert sums(gyrofleet) == {
        ("U1", "yawrate"): (10, 0.1),
        ("U1", "yawrate.sa31"): (10, 10.1),
        ("U1", "yawrate.sa32"): (10, 20.1),
    }
    assert "message GYRO comes from sources 0x30, 0x31, 0x32" in found["remarks"][0]


@pytest.mark.long
def test_a_mapping_gives_each_j1939_source_its_unit(gyrofleet: Run, tmp_path: Path, imported: Run) -> None:
    path = log(tmp_path / "a.blf", [(0x18F00A30 + i % 3, shorts(100 * (i % 3) + 1)) for i in range(30)])
    entry = '[[message]]\nmessage = "GYRO"\nsources = { A = 0x30, B = 0x32 }\n'
    (tmp_path / "map.toml").write_text(entry)
    found = imported(path, J1939, "--mapping", "map.toml")
    assert sums(gyrofleet) == {("A", "yawrate"): (10, 0.1), ("B", "yawrate"): (10, 20.1)}
    assert sum(found["frames"]["unrouted"].values()) == 10
    (tmp_path / "map.toml").write_text('[[message]]\nmessage = "GYRO"\nunit = "C"\n')
    found = imported(path, J1939, "--mapping", "map.toml")
    assert sums(gyrofleet)["C", "yawrate"] == (10, 0.1)
    assert [count["other_source"] for count in found["frames"]["messages"]] == [20]
    assert any("20 from another source address left out" in remark for remark in found["remarks"])


@pytest.mark.long
def test_scan_finds_j1939_messages_and_proposes_a_source(gyrofleet: Run, tmp_path: Path, imported: Run) -> None:
    path = log(tmp_path / "a.blf", [(0x0CF00A30 + i % 2, shorts(i)) for i in range(30)])
    (tmp_path / "a.dbc").write_text(J1939)
    scan = gyrofleet("can", "scan", path, "--dbc", "a.dbc", "--write", "map.toml", "--unit", "A", "--json").json
    assert [(each["message"], each["source"]) for each in scan["scan"]["ids"]] == [("GYRO", 0x30), ("GYRO", 0x31)]
    assert "source = 0x30  # it comes from 0x31 as well" in (tmp_path / "map.toml").read_text()
    imported(path, J1939, "--mapping", "map.toml")
    assert sums(gyrofleet) == {("A", "yawrate"): (15, 2.1)}


@pytest.mark.long
def test_an_unfinished_mf4_with_complete_data_is_no_error(gyrofleet: Run, tmp_path: Path) -> None:
    path = log(tmp_path / "a.mf4", [(0x101, shorts(i, 5 * i)) for i in range(50)])
    content = bytearray(path.read_bytes())
    content[:8] = b"UnFinMF "
    path.write_bytes(content)
    (tmp_path / "a.dbc").write_text(VARIANTS)
    done = gyrofleet("import", path, "--dbc", "a.dbc", "--unit", "U1", "--run", "r")
    assert done.code == 0, done.err
    assert "was not finished by its recorder; all records in it are complete" in done.err
    assert sums(gyrofleet) == {("U1", "yawrate"): (50, 12.25)}


@pytest.mark.long
def test_an_unfinished_mf4_that_ends_inside_a_record_is_damaged(gyrofleet: Run, tmp_path: Path) -> None:
    path = log(tmp_path / "a.mf4", [(0x101, shorts(i, 5 * i)) for i in range(50)])
    content = bytearray(path.read_bytes())
    content[:8] = b"UnFinMF "
    begin = content.index(b"##DZ") + 32
    size, zipped_size = struct.unpack_from("<QQ", content, begin)
    cut = zlib.compress(zlib.decompress(content[begin + 16 : begin + 16 + zipped_size])[:-7], 9)
    struct.pack_into("<QQ", content, begin, size - 7, len(cut))
    content[begin + 16 : begin + 16 + len(cut)] = cut
    path.write_bytes(content)
    (tmp_path / "a.dbc").write_text(VARIANTS)
    done = gyrofleet("import", path, "--dbc", "a.dbc", "--unit", "U1", "--run", "r")
    assert done.code == 1
    assert "was not finished by its recorder; its last frames may be missing" in done.err
