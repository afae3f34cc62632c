"""Tables of samples in CSV and Parquet, and lists of units."""

import io
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ingest.station.units_file import read_units
from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from tests.fuzz.format import Format
from tests.fuzz.mutations import FLOATS, NUMBERS, TEXTS, mutated_blocks, mutated_bytes, mutated_lines

_STAMPED = """unit;run;time;rate[deg/s];temperature[degC];step
G-1;r1;2026-02-01T00:00:00,000Z;0,5;21,5;static
G-1;r1;2026-02-01T00:00:00,010Z;0,6;21,5;static
G-2;r1;2026-02-01T00:00:00,020Z;"0,7";21,6;turn
"""
_ROWS = 50


def _csv(_folder: Path) -> list[bytes]:
    numbers = "".join(f"{i / 100:.2f},{i % 7 - 3},{20 + i / 10}\n" for i in range(_ROWS))
    counted = "".join(f"{i},{i * 3 % 11}\n" for i in range(_ROWS))
    return [
        f"# sensor: G-1\ntime[s],rate[deg/s],temperature[degC]\n{numbers}".encode(),
        f"time[us],rate[LSB]\n{counted}".encode("utf-8-sig"),
        _STAMPED.encode(),
    ]


def _read_table(path: Path) -> None:
    """Read as they are, and without what is bad; units and runs are given only where the file does not name them."""
    content = path.read_bytes()
    unit = None if b"unit" in content else "G-1"
    run = None if b"run" in content else "r1"
    for skip_bad in (True, False):
        table = TableFile(path, TableOptions(unit=unit, run=run, skip_bad=skip_bad))
        table.check()
        for _ in table.chunks():
            pass
        for _ in table.batches(lambda _unit, _run: UUID(int=1)):
            pass


def _table() -> pa.Table:
    times = pa.array(np.arange(_ROWS) * 10**7 + 1_700_000_000 * 10**9, pa.timestamp("ns", "UTC"))
    return pa.table(
        {
            "time": times, "rate[deg/s]": np.linspace(0.0, 1.0, _ROWS), "temperature[degC]": np.full(_ROWS, 21.5),
            "unit": ["G-1"] * _ROWS, "run": pa.array(["r1"] * _ROWS).dictionary_encode(),
        }
    )  # fmt: skip


def _written(table: pa.Table, **options: object) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink, **options)
    return sink.getvalue()


def _parquet(_folder: Path) -> list[bytes]:
    counted = pa.table({"time[us]": np.arange(_ROWS), "rate[LSB]": pa.array(range(_ROWS), pa.int32())})
    return [_written(_table()), _written(counted, compression="zstd", row_group_size=7)]


def _mutated_parquet(content: bytes, rng: random.Random) -> bytes:
    """Another table, soundly written; or the same with other integers and bytes."""
    if rng.random() < 0.5:
        return rng.choice((mutated_blocks, mutated_bytes, _mutated_footer))(content, rng)
    table = _table()
    for _ in range(rng.choice((1, 1, 2, 3))):
        at = rng.randrange(table.num_columns)
        name, column = table.column_names[at], table.column(at)
        match rng.randrange(5):
            case 0:
                table = table.set_column(at, rng.choice((*TEXTS, "time", "rate[deg/s]", "unit")), column)
            case 1 if table.num_columns > 1:
                table = table.remove_column(at)
            case 2:
                table = table.append_column(rng.choice((name, *TEXTS[:12])), column)
            case _:
                table = table.set_column(at, name, _column(rng))
    options = {
        "compression": rng.choice(("snappy", "zstd", "gzip", "none")),
        "row_group_size": rng.choice((1, 7, 1000)),
    }
    try:
        return _written(table, **options, use_dictionary=rng.random() < 0.5)
    except (pa.ArrowException, ValueError, UnicodeEncodeError):
        return mutated_bytes(content, rng)


def _mutated_footer(content: bytes, rng: random.Random) -> bytes:
    """Other bytes in the description at the end, whose length stays right."""
    length = int.from_bytes(content[-8:-4], "little")
    if length + 8 > len(content):
        return mutated_bytes(content, rng)
    footer = mutated_bytes(content[-8 - length : -8], rng)
    return content[: -8 - length] + footer + len(footer).to_bytes(4, "little") + content[-4:]


def _column(rng: random.Random) -> pa.Array:
    whole = [number for number in NUMBERS if -(2**63) <= number < 2**63]
    values: dict[pa.DataType, Callable[[], Any]] = {
        pa.int64(): lambda: rng.choice(whole), pa.float64(): lambda: rng.choice(FLOATS), pa.bool_(): lambda: True,
        pa.string(): lambda: rng.choice(TEXTS).encode(errors="replace").decode(), pa.null(): lambda: None,
        pa.binary(): lambda: b"\xff", pa.timestamp("us"): lambda: rng.choice(whole), pa.date32(): lambda: 2**31 - 1,
        pa.timestamp("ns", "Asia/Shanghai"): lambda: rng.choice(whole), pa.duration("s"): lambda: 1,
        pa.list_(pa.float64()): lambda: [0.5], pa.struct([("a", pa.int8())]): lambda: {"a": 1},
        pa.time64("ns"): lambda: 1, pa.decimal128(38, 10): lambda: None, pa.float16(): lambda: np.float16(1.0),
        pa.uint64(): lambda: 2**64 - 1, pa.int8(): lambda: -1, pa.large_string(): lambda: "G-1",
    }  # fmt: skip
    kind = rng.choice(list(values))
    return pa.array([values[kind]() if rng.random() < 0.9 else None for _ in range(_ROWS)], kind)


def _units(_folder: Path) -> list[bytes]:
    return [
        b"serial,slot,lot,product\nG-1,S1,L1,FOG\nG-2,S2,L1,FOG\n", b"G-1\nG-2\n",
        "serial;product;备注\nG-1;FOG;好\n".encode("gb18030"), "serial\tlot\nG-1\tL1\n".encode("utf-16"),
    ]  # fmt: skip


FORMATS = [
    Format("csv", _csv, _read_table, mutated_lines, "samples.csv", gate_inputs=80),
    Format("parquet", _parquet, _read_table, _mutated_parquet, "samples.parquet", gate_inputs=80),
    Format("units", _units, read_units, mutated_lines, "units.csv", gate_inputs=200),
]
