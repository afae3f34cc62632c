"""CSV files by the contract, good and bad."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from ingest.tables.columns import TableOptions, read_header
from ingest.tables.file import TableFile
from ingest.tables.rows import BadRow, BadRows, CellBlock
from ingest.tables.text.csv_chunks import CsvTable
from ingest.tables.text.csv_lines import LineReader
from stream.errors import BadInput
from stream.identity import NAME_RULE
from tests.stream.examples import examples

Tool = Callable[..., Any]
G1 = TableOptions(unit="G1")
FINITE = "a finite number (leave the cell empty for no sample)"
LENIENT = TableOptions(unit="G1", skip_bad=True)


def bad_rows(path: Path) -> list[str]:
    with pytest.raises(BadRows) as caught:
        TableFile(path, G1).check()
    assert caught.value.count == len(caught.value.bad)
    return [str(row) for row in caught.value.bad]


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
@pytest.mark.parametrize("bom", [b"", b"\xef\xbb\xbf"])
def test_dialects_give_the_same(
    write: Tool, deliver: Tool, samples: Tool, delimiter: str, line_end: str, bom: bytes
) -> None:
    lines = ["time[s],rate[deg/s]", "0.0,1.5", "", '"0.01","-2e-1"', " 0.02 , +3. ", "0.03,"]
    text = line_end.join(lines).replace(",", delimiter)
    table = TableFile(write(bom + text.encode()), G1)
    assert samples(deliver(table)) == {("G1", "run1", "rate"): [(0, 1.5), (10**7, -0.2), (2 * 10**7, 3.0)]}
    assert table.check().rows == 4


def test_three_bad_rows_of_ten_thousand(write: Tool, deliver: Tool, samples: Tool) -> None:
    lines = [f"{i / 100},{i % 7}" for i in range(10_000)]
    lines[40] = "0.4,NaN"
    lines[5000] = "50.0,fast"
    lines[9998] = "99.98,1,2"
    path = write("time[s],rate[deg/s]\n" + "\n".join(lines))
    assert bad_rows(path) == [
        f"line 42, column rate[deg/s]: found 'NaN', expected {FINITE}",
        "line 5002, column rate[deg/s]: found 'fast', expected a value, as a number",
        "line 10000: found '3 cells', expected 2 as in the header (a decimal comma? write a point)",
    ]
    summary = TableFile(path, LENIENT).check()
    assert (summary.rows, summary.bad_rows) == (10_000, 3)
    assert len(samples(deliver(TableFile(path, LENIENT)))["G1", "run1", "rate"]) == 9_997


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0,5;1", "line 4, column time[s]: found '0,5', expected a time with a decimal point, not a comma"),
        ("0.5;1,25", "line 4, column rate[deg/s]: found '1,25', expected a value with a decimal point, not a comma"),
        (";1", "line 4, column time[s]: found '', expected a time, as a number"),
        ("nan;1", "line 4, column time[s]: found 'nan', expected a time, as a number"),
        ("0.5;-inf", "line 4, column rate[deg/s]: found '-inf', expected a finite number (leave the cell empty"),
        ("0.5;1e999", "expected a number below 1.8e308"),
        ("0.5;1_0", "found '1_0'"),
        ("0.5;0x10", "found '0x10'"),
        ("1e20;1", "expected a time within 146 years"),
        ("0.5", "line 4: found '1 cell', expected 2 as in the header"),
        ("0.5;1;", "line 4: found '3 cells'"),
        ('0.5;"1', "cells whose quotes match"),
        ("0.5;1\r2", "no carriage return"),
        ("0.0;1", "line 4, column time[s]: found '0 s', expected a time after 0.1 s (unit G1, run run1)"),
        ("0.1;1", "found '0.1 s', expected a time after 0.1 s"),
        ("1e8;1", "found '100000000 s', expected below 1e8 s, as the first time"),
    ],
)
def test_bad_rows_are_named(write: Tool, row: str, message: str) -> None:
    found = bad_rows(write(f"time[s];rate[deg/s]\n0.1;1\n\n{row}\n9.0;2\n"))
    assert len(found) == 1
    assert message in found[0]


def test_a_spike_in_time_makes_what_follows_bad(write: Tool) -> None:
    assert len(bad_rows(write("time[s],rate[deg/s]\n0,1\n5,1\n1,1\n2,1\n5.5,1\n"))) == 2


def test_count_is_exact_and_a_thousand_are_kept(write: Tool) -> None:
    path = write("time[s],rate[deg/s]\n0,1\n" + "1,x\n" * 2500)
    with pytest.raises(BadRows, match="and 2480 more") as caught:
        TableFile(path, G1).check()
    assert (caught.value.count, len(caught.value.bad)) == (2500, 1000)
    assert caught.value.bad[-1] == BadRow("line", 1002, "rate[deg/s]", "x", "a value, as a number")


def test_units_runs_and_mixed_rates(write: Tool, deliver: Tool, samples: Tool) -> None:
    header = "unit,run,time[s],rate[deg/s],temperature[count]\n"
    text = header + "A,r,0,1,20\nB,r,0,2,\nA,r,1,3,\nB,r,1,4,21\nA,q,0,5,\n"
    assert samples(deliver(TableFile(write(text), TableOptions()))) == {
        ("A", "r", "rate"): [(0, 1.0), (10**9, 3.0)],
        ("A", "r", "temperature"): [(0, 20.0)],
        ("B", "r", "rate"): [(0, 2.0), (10**9, 4.0)],
        ("B", "r", "temperature"): [(10**9, 21.0)],
        ("A", "q", "rate"): [(0, 5.0)],
    }


def test_bad_names_and_words_are_bad_rows(write: Tool, said: Tool) -> None:
    text = "unit,time[s],rate[deg/s],repeat,room\nA,0,1,1,yes\na b,1,1,1,\n,2,1,1,\nA,3,1,1.5,\nA,4,1,,maybe\n"
    with pytest.raises(BadRows) as caught:
        TableFile(write(text), TableOptions()).check()
    assert said(caught.value.bad) == [
        f"line 3, column unit: found 'a b', expected a name: {NAME_RULE}",
        "line 4, column unit: found '', expected the name of a unit",
        "line 5, column repeat: found '1.5', expected a whole number",
        "line 6, column room: found 'maybe', expected yes or no (also true, false, 1, 0)",
    ]


def test_nanoseconds_and_utc_stay_exact(write: Tool, deliver: Tool, samples: Tool) -> None:
    for title, cells in [("ns", ("1763683200000000001", "1763683200010000003")),
                         ("s", ("1763683200.000000001", "1763683200.010000003"))]:  # fmt: skip
        path = write(f"time[{title}],rate[deg/s]\n{cells[0]},1\n{cells[1]},2\n")
        times = [time for time, _ in samples(deliver(TableFile(path, G1)))["G1", "run1", "rate"]]
        assert times == [1763683200000000001, 1763683200010000003]
        assert TableFile(path, G1).check().date_known
        with pytest.raises(BadInput, match="leave out --start"):
            TableFile(path, TableOptions(unit="G1", start_ns=0)).check()


def test_a_start_gives_the_date(write: Tool) -> None:
    path = write("time[s],rate[deg/s]\n0.5,1\n")
    summary = TableFile(path, TableOptions(unit="G1", start_ns=1763683200 * 10**9)).check()
    assert summary.date_known
    assert summary.signals[0].sampling.t_first_ns == 1763683200_500000000
    assert not TableFile(path, G1).check().date_known


def test_a_sample_rate_in_place_of_times_keeps_the_slot_of_a_bad_row(write: Tool, deliver: Tool, samples: Tool) -> None:
    path = write("rate[deg/s]\n1\nx\n3\n4\n")
    options = TableOptions(unit="G1", sample_rate_hz=100.0, skip_bad=True)
    found = samples(deliver(TableFile(path, options)))["G1", "run1", "rate"]
    assert found == [(0, 1.0), (2 * 10**7, 3.0), (3 * 10**7, 4.0)]


NUMBERS = ["0", "1.5", "-2", "+3", "4.", ".5", "1e3", "1e-7", "", " 7 ", "0.30000000000000004", "5e-324"]
ODD = ["nan", "inf", "1,5", "x", "1e400", "1_0", '"8"', '""', '"9,5"', '"', 'a"b', "é", "\r", "A", '"A"', "B ", " "]
CELLS = st.sampled_from(NUMBERS + ODD)
GOOD_LINES = st.integers(0, 50).map(lambda i: f"{i / 10},{i},A")
WILD_LINES = st.lists(CELLS, min_size=0, max_size=4).map(",".join)
LINES = st.lists(st.one_of(GOOD_LINES, GOOD_LINES, GOOD_LINES, WILD_LINES), max_size=30)


def content(blocks: list[CellBlock]) -> dict[int, object]:
    """What a reader found on every line."""
    lines: dict[int, object] = {}
    for block in blocks:
        reasons = {reason.number: str(reason) for reason in block.sieve.reasons()}
        for row, number in enumerate(block.numbers.tolist()):
            rate, owner = block.signals["rate"], block.texts["unit"]
            has_rate = rate.valid is None or rate.valid[row]
            code = owner.codes[row]
            assert block.times_ns is not None
            lines[number] = reasons.get(number) or (
                int(block.times_ns[row]),
                float(rate.values[row]) if has_rate else None,
                owner.values[code] if code >= 0 else None,
            )
    return lines


@examples(60, 300, LINES, st.sampled_from(["\n", "\r\n"]), st.integers(1, 200))
def test_fast_and_slow_paths_agree(lines: list[str], line_end: str, block_bytes: int) -> None:
    titles = ["time[s]", "rate[deg/s]", "unit"]
    with TemporaryDirectory() as name:
        path = Path(name) / "a.csv"
        path.write_bytes(line_end.join([",".join(titles), "0,0,A", *lines]).encode())
        columns = read_header(path, titles, TableOptions())
        whole, pieces = CsvTable(path), CsvTable(path, block_bytes)
        for table in (whole, pieces):
            table.bind(columns)
        slow = whole._lines.read(path.read_bytes().partition(b"\n")[2] + b"\n", 2, 1.0)
        expected = content([slow])
        assert content(list(whole.blocks())) == expected
        assert content(list(pieces.blocks())) == expected


def test_the_fast_path_is_taken_where_nothing_is_wrong(write: Tool, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write('time[s],rate[deg/s],step\n0.01,,"a,b"\n\n0.30000000000000004,1e-7,\n')
    monkeypatch.setattr(LineReader, "read", lambda *_: pytest.fail("slow path"))
    assert TableFile(path, G1).check().rows == 2


def test_one_bad_cell_does_not_make_the_whole_block_slow(write: Tool, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = [f"{i / 100},1.25" for i in range(100_000)]
    lines[77_777] = "oops"
    seen: list[int] = []
    read = LineReader.read

    def counting(reader: LineReader, block: bytes, line: int, done: float) -> CellBlock:
        seen.append(len(block))
        return read(reader, block, line, done)

    monkeypatch.setattr(LineReader, "read", counting)
    summary = TableFile(write("time[s],rate[deg/s]\n" + "\n".join(lines)), LENIENT).check()
    assert [row.number for row in summary.bad] == [77_779]
    assert sum(seen) < 100_000


@pytest.mark.in_gate("1000", "1000000")
@pytest.mark.parametrize("block_bytes", [1, 17, 1000, 10**6])
def test_block_size_changes_nothing(
    write: Tool, deliver: Tool, by_signal: Tool, monkeypatch: pytest.MonkeyPatch, block_bytes: int
) -> None:
    generator = np.random.default_rng(5)
    rows = [f"{i * 0.01:.2f},{generator.normal():.4f},{'' if i % 3 else i},{'ab'[i // 400 % 2]}" for i in range(1500)]
    rows[700] = "7.00,bad,1,a"
    path = write("time[s],rate[deg/s],temperature[count],step\n" + "\n".join(rows))
    options = TableOptions(unit="G1", skip_bad=True, batch_samples=100)
    expected = TableFile(path, options)
    monkeypatch.setattr(CsvTable.__init__, "__defaults__", (block_bytes,))
    found = TableFile(path, options)
    assert found.check() == expected.check()
    assert by_signal(deliver(found)) == by_signal(deliver(expected))


def test_a_large_file_with_decimal_commas_is_read_the_same_each_time(write: Tool) -> None:
    # Arrow's decoder of decimals with a comma is not safe among its threads: they gave other times in a file like this
    times_ns = np.arange(150_000, dtype=np.int64) * 13_700_001
    lines = [f"{ns // 10**9},{ns % 10**9:09};{ns % 1000},5" for ns in times_ns.tolist()]
    path = write("time[s];rate[deg/s]\n" + "\n".join(lines))
    for _ in range(3):
        chunks = list(TableFile(path, G1).chunks())
        assert np.array_equal(np.concatenate([chunk.times_ns for chunk in chunks]), times_ns)
        assert np.array_equal(np.concatenate([chunk.data for chunk in chunks]), times_ns % 1000 + 0.5)
