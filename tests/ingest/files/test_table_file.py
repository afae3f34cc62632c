"""Files as a whole: what is refused, and that nothing else is ever raised."""

import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ingest.tables.checks import RowFilter
from ingest.tables.columns import TableOptions, read_header
from ingest.tables.file import TableFile
from ingest.tables.rows import CellBlock, NumberCells, Sieve, TextCells
from stream.batch import IntArray, SampleBatch
from stream.errors import BadInput

Tool = Callable[..., Any]
G1 = TableOptions(unit="G1")
LENIENT = TableOptions(unit="G1", skip_bad=True)
GOOD_CSV = b"time[s],rate[deg/s],step\n" + b"".join(b"%d,%d.5,a\n" % (i, i) for i in range(20))


def parquet_bytes() -> bytes:
    buffer = io.BytesIO()
    pl.DataFrame({"time[s]": [0.0, 1.0, 2.0], "rate[deg/s]": [1.0, None, 3.0], "step": ["a", "b", None]}).write_parquet(
        buffer
    )
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("r.csv", b"", "the file is empty"),
        ("r.csv", b"\n\r\n", "the file is empty"),
        ("r.csv", b"time[s],rate[deg/s]\n", "a header and no rows"),
        ("r.csv", b"time[s],rate[deg/s]\n\n\n", "a header and no rows"),
        ("r.csv", b"time[s],rate[deg/s]\n0,\n", "not one sample"),
        ("r.csv", "time[s],rate[deg/s]\n0,1\n1,2é\n".encode("latin-1"), "line 3: not UTF-8"),
        ("r.csv", "time[s],rate[deg/s]\n0,1\n".encode("utf-16"), "UTF-16"),
        ("r.csv", "Zeit [s];Rate [°/s]\n0;1\n".encode("utf-16-le"), "iconv -f UTF-16LE -t UTF-8"),
        ("r.csv", "时间(s),角速率(°/s)\n0,1\n".encode("utf-16-be"), "iconv -f UTF-16BE -t UTF-8"),
        ("r.csv", b"time[s],rate[deg/s]\r0,1\r", "carriage return alone"),
        ("r.csv", b'time[s],"rate[deg/s]\n0,1\n', "line 1: found"),
        ("r.csv", b"0.0,1.5\n0.1,1.6\n", "the first line must be the header"),
        ("r.csv", b"time[s],rate[deg/s]\n" + b"1" * (9 << 20), "line 2: longer than 8 MiB"),
        ("r.csv.gz", b"\x1f", "tables are .csv .parquet .pq .tsv .txt; decompress it first"),
        ("r.xlsx", b"PK", "unknown kind of file '.xlsx'; tables are .csv .parquet .pq .tsv .txt"),
        ("r.parquet", b"PAR1", "not a Parquet file, or a damaged one"),
        ("r.parquet", parquet_bytes()[:-20], "not a Parquet file, or a damaged one"),
        ("r.pq", GOOD_CSV, "not a Parquet file, or a damaged one"),
        ("r.csv", parquet_bytes(), "not UTF-8"),
        ("my run.csv", GOOD_CSV, "give --run R"),
    ],
)
def test_files_that_are_refused(write: Tool, name: str, content: bytes, message: str) -> None:
    with pytest.raises(BadInput) as caught:
        TableFile(write(content, name), G1).check()
    assert message in str(caught.value)
    assert name in str(caught.value)


def test_what_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no such file"):
        TableFile(tmp_path / "none.csv", G1)
    with pytest.raises(BadInput, match="a directory"):
        TableFile(tmp_path, G1)


def test_names_from_options_are_checked_first(write: Tool) -> None:
    for options in (TableOptions(unit="a b"), TableOptions(unit="G1", run="r/1")):
        with pytest.raises(BadInput, match="cannot be used as a name"):
            TableFile(write(GOOD_CSV), options)


def test_a_sample_rate_that_lasts_for_years_is_refused(write: Tool) -> None:
    path = write("rate[deg/s]\n" + "1\n" * 20)
    with pytest.raises(BadInput, match="is --sample-rate right"):
        TableFile(path, TableOptions(unit="G1", sample_rate_hz=1e-7)).check()


@pytest.mark.long
def test_a_column_unit_that_holds_no_names_is_refused(write: Tool) -> None:
    path = write("unit,time[s],rate[deg/s]\n" + "".join(f"U{i},{i},1\n" for i in range(10_001)))
    with pytest.raises(BadInput, match="does column 'unit' hold names"):
        TableFile(path, TableOptions()).check()


def test_a_file_that_changes_between_the_passes_is_noticed(write: Tool, deliver: Tool) -> None:
    path = write(GOOD_CSV)
    table = TableFile(path, G1)
    table.check()
    os.utime(path, ns=(0, 0))
    with pytest.raises(BadInput, match="changed while it was read"):
        deliver(table)


def test_progress_and_chunks(write: Tool) -> None:
    table = TableFile(write(GOOD_CSV), G1)
    seen: list[float] = []
    table.check(seen.append)
    chunks = list(table.chunks(seen.append))
    assert seen == [1.0, 1.0]
    assert [(chunk.unit, chunk.run, chunk.signal) for chunk in chunks] == [("G1", "run1", "rate")]
    assert chunks[0].times_ns.tolist() == [i * 10**9 for i in range(20)]
    assert chunks[0].data.tolist() == [i + 0.5 for i in range(20)]


def test_samples_that_are_there_already_are_left_out(write: Tool) -> None:
    table = TableFile(write(GOOD_CSV), G1)
    asked: list[tuple[str, str, str]] = []

    def keep(unit: str, run: str, signal: str, times_ns: IntArray) -> np.ndarray[Any, np.dtype[np.bool_]]:
        asked.append((unit, run, signal))
        return times_ns >= 15 * 10**9

    batches = [b for b in table.batches(lambda unit, run: UUID(int=1), keep) if isinstance(b, SampleBatch)]
    assert [(b.seq, b.t0_ns, len(b)) for b in batches] == [(0, 15 * 10**9, 5)]
    assert asked == [("G1", "run1", "rate")]


def read_all(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    try:
        for _ in TableFile(path, LENIENT).batches(lambda unit, run: UUID(int=1)):
            pass
    except BadInput:
        return


FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@FUZZ
@given(st.sampled_from(["r.csv", "r.parquet"]), st.binary(max_size=300))
def test_random_bytes(tmp_path: Path, name: str, content: bytes) -> None:
    read_all(tmp_path / name, content)


@pytest.mark.long
@FUZZ
@given(st.binary(max_size=300))
def test_random_bytes_behind_a_good_header(tmp_path: Path, content: bytes) -> None:
    read_all(tmp_path / "r.csv", GOOD_CSV + content)


@pytest.mark.long
@FUZZ
@given(st.text('0123456789.,;-+eE\t\r\n" naif[]/degstimrunp', max_size=200))
def test_random_text(tmp_path: Path, content: str) -> None:
    read_all(tmp_path / "r.csv", b"time[s],rate[deg/s],repeat\n0,1,1\n" + content.encode())
    read_all(tmp_path / "r.csv", content.encode())


@pytest.mark.long
@FUZZ
@given(st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=8), st.integers(0, 10**6))
def test_damaged_parquet(tmp_path: Path, flips: list[tuple[int, int]], cut: int) -> None:
    content = bytearray(PARQUET)
    for at, value in flips:
        content[at % len(content)] = value
    read_all(tmp_path / "r.parquet", bytes(content))
    read_all(tmp_path / "r.parquet", bytes(content[: cut % len(content)]))


PARQUET = parquet_bytes()


def test_a_block_without_rows_has_no_units() -> None:
    columns = read_header(Path("a.csv"), ["unit", "time[s]", "rate[deg/s]"], TableOptions())
    nothing = TextCells(np.empty(0, np.int32), [])
    cells = {"rate": NumberCells(np.empty(0), None)}
    block = CellBlock("line", np.empty(0, np.int64), np.empty(0, np.int64), cells, {"unit": nothing}, Sieve(0), 1.0)
    rows = RowFilter(Path("a.csv"), columns, TableOptions())
    assert rows.good(block) == []
    assert rows.rows == 0


@pytest.mark.parametrize("before", [0, 3, 2000])
def test_a_line_longer_than_all_others_is_one_bad_row(write: Callable[..., Path], before: int) -> None:
    """It cannot be cut into parts: read on, cut by cut, it went round for ever."""
    rows = "".join(f"{at},1\n" for at in range(before))
    content = f"time[s],rate[deg/s]\n{rows}{before},{'[' * 120_000}\n{before + 1},2\n"
    with pytest.raises(BadInput) as caught:
        TableFile(write(content, "long.csv"), G1).check()
    assert f"line {before + 2}, " in str(caught.value)
    assert "1 row" in str(caught.value)
