"""Logs of CAN frames in five formats, and databases of CAN messages."""

import random
import struct
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from uuid import UUID

import can

from ingest.can.database import MessageIndex, load_database, own_names
from ingest.can.decode import MessageLayout
from ingest.can.logs.log_file import CanLogFile
from ingest.can.mapping import CanMapping
from tests.fuzz.format import Format
from tests.fuzz.mutations import mutated_blocks, mutated_bytes, mutated_lines

_DBC = """VERSION ""
NS_ :
BS_:
BU_: GYRO STATION
BO_ 256 RATE: 8 GYRO
 SG_ Rate : 0|24@1- (0.0001,0) [-800|800] "deg/s" STATION
 SG_ Temperature : 24|16@1- (0.01,0) [-40|85] "degC" STATION
 SG_ Counter : 40|8@1+ (1,0) [0|255] "" STATION
 SG_ Mode M : 48|8@1+ (1,0) [0|3] "" STATION
 SG_ Angle m1 : 56|8@1- (0.1,0) [-12|12] "deg" STATION
BO_ 2566844414 J1939: 8 GYRO
 SG_ YawRate : 7|16@0- (0.01,-320) [0|0] "deg/s" STATION
CM_ SG_ 256 Rate "角速度";
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
VAL_ 256 Mode 0 "off" 1 "on" ;
"""
_DATABASE = "gyros.dbc"
_FRAMES = 40
_START_S = 1_700_000_000.25
_CONTAINER = struct.Struct("<4sHHLLHHLL4x")  # object header and that of a log container
_DEFLATED = 2


def _log(suffix: str) -> Callable[[Path], list[bytes]]:
    def made(folder: Path) -> list[bytes]:
        path = folder / f"log{suffix}"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # asammdf's own, on writing
            with can.Logger(path) as logger:
                for i in range(_FRAMES):
                    identifier = 256 if i % 3 else 0x18FF01FE
                    data = bytes((i, 0, 0, 10, 8, i % 256, 1, i))
                    logger.on_message_received(
                        can.Message(_START_S + i * 0.01, identifier, is_extended_id=identifier > 2047, data=data)
                    )
        return [path.read_bytes()]

    return made


def _database(folder: Path) -> None:
    (folder / _DATABASE).write_text(_DBC, encoding="utf-8")


def _read_log(path: Path) -> None:
    log = CanLogFile(path, CanMapping([path.parent / _DATABASE], unit="G-1"), run="r1")
    log.check()
    for _ in log.batches(lambda _unit, _run: UUID(int=1)):
        pass


def _read_database(path: Path) -> None:
    messages = load_database(path)
    own_names(messages)
    MessageIndex(messages).find(256)
    for message in messages:
        MessageLayout.of(message)
    CanMapping([path], unit="G-1").plan()


def _mutated_blf(content: bytes, rng: random.Random) -> bytes:
    """The frames in a container changed, and the container made valid again; or any bytes."""
    at = content.find(b"LOBJ")
    if rng.random() < 0.4 or at < 0 or len(content) < at + _CONTAINER.size:
        return mutated_blocks(content, rng)
    signature, header_size, version, size, kind, method, reserved, _, reserved_2 = _CONTAINER.unpack_from(content, at)
    try:
        packed = content[at + _CONTAINER.size : at + size]
        inner = zlib.decompress(packed) if method == _DEFLATED else packed
    except zlib.error:
        return mutated_blocks(content, rng)
    inner = rng.choice((mutated_blocks, mutated_bytes))(inner, rng)
    body = zlib.compress(inner) if method == _DEFLATED else inner
    length = rng.choice((len(inner), len(inner), len(inner), 2**32 - 1, 0))
    head = _CONTAINER.pack(
        signature, header_size, version, _CONTAINER.size + len(body), kind, method, reserved, length, reserved_2
    )
    return content[:at] + head + body + content[at + size :]


FORMATS = [
    Format("blf", _log(".blf"), _read_log, _mutated_blf, "log.blf", _database, gate_inputs=100),
    Format("asc", _log(".asc"), _read_log, mutated_lines, "log.asc", _database, gate_inputs=100),
    Format("trc", _log(".trc"), _read_log, mutated_lines, "log.trc", _database, gate_inputs=100),
    Format("candump", _log(".log"), _read_log, mutated_lines, "log.log", _database, gate_inputs=100),
    Format("mf4", _log(".mf4"), _read_log, mutated_blocks, "log.mf4", _database, gate_inputs=20),
    Format("dbc", lambda _: [_DBC.encode()], _read_database, mutated_lines, "gyros.dbc", gate_inputs=60),
]
