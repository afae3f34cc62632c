"""Slips of files that would give wrong values or times in silence: they are refused, or warned of."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from stream.errors import BadInput

Write = Callable[..., Path]
G1 = TableOptions(unit="G1")


def remarks(path: Path, options: TableOptions = G1) -> str:
    return " | ".join(TableFile(path, options).check().remarks)


@pytest.mark.parametrize("first", [0, 3000, 4000])
def test_marks_of_thousands_in_counts_are_warned_of_wherever_they_begin(write: Write, first: int) -> None:
    counts = [f"{n // 1000}.{n % 1000:03}" if n > 999 else str(n) for n in range(first, first + 2500)]
    rows = "\n".join(f"{i};{each}" for i, each in enumerate(counts))
    assert "if the mark separates thousands" in remarks(write(f"time[s];raw[count]\n{rows}\n"))


@pytest.mark.parametrize("values", [("1.2345", "2.5"), ("1500.5", "1.001"), ("7", "8")])
def test_other_numbers_in_counts_are_not(write: Write, values: tuple[str, ...]) -> None:
    rows = "\n".join(f"{i};{values[i % 2]}" for i in range(50))
    assert "thousands" not in remarks(write(f"time[s];raw[count]\n{rows}\n"))


@pytest.mark.parametrize(
    ("text", "line"),
    [("rate[deg/s]\n1\n\n3\n", 3), ("rate[deg/s]\n\n\n1\n3\n", 2), ("rate[deg/s]\n1\n \r\n# noise\n3\n", 3)],
)
def test_a_blank_line_in_one_column_is_not_taken_for_nothing(write: Write, text: str, line: int) -> None:
    with pytest.raises(BadInput, match=f'line {line}: a blank line between .* write ""'):
        TableFile(write(text), TableOptions(unit="G1", sample_rate_hz=10.0)).check()


def test_blank_lines_at_the_end_and_comments_are(write: Write, deliver: Any, samples: Any) -> None:
    path = write('rate[deg/s]\n1\n# a comment\n""\n3\n\n \n')
    table = TableFile(path, TableOptions(unit="G1", sample_rate_hz=10.0))
    assert samples(deliver(table)) == {("G1", "run1", "rate"): [(0, 1.0), (2 * 10**8, 3.0)]}


def test_blank_lines_are_found_across_blocks(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ingest.tables.text.csv_chunks.CsvTable.__init__.__defaults__", (64,))
    path = write("rate[deg/s]\n" + "1.25\n" * 40 + "\n" + "1.25\n" * 40)
    with pytest.raises(BadInput, match="line 42: a blank line"):
        TableFile(path, TableOptions(unit="G1", sample_rate_hz=10.0)).check()


@pytest.mark.parametrize("title", ["Time (Ms)", "time[Ms]", "Time (Gs)"])
def test_megaseconds_are_milliseconds_with_a_slip(write: Write, title: str) -> None:
    with pytest.raises(BadInput, match="write 'ms'"):
        TableFile(write(f"{title},rate[deg/s]\n0,1\n1,2\n"), G1)


def test_a_title_and_the_line_below_it_may_not_name_two_units(write: Write) -> None:
    with pytest.raises(BadInput, match="name two units"):
        TableFile(write("Time (s),Rate (deg/s)\nms,deg/h\n0,1\n1,2\n"), G1)
    found = TableFile(write("Time (s),Rate (deg/s)\nsec,°/s\n0,1\n1,2\n"), G1).check()
    assert found.signals[0].unit_of_measure == "deg/s"


def test_a_line_of_units_and_lines_before_the_header_are_seen_in_rows_with_decimal_commas(write: Write) -> None:
    rows = "\n".join(f"{i},5;{i},25;{i},125" for i in range(30))
    found = TableFile(write(f"Logger 7\nSerial 12\nTime;Rate;Temp\ns;deg/s;degC\n{rows}\n"), G1).check()
    assert [(each.signal, each.unit_of_measure) for each in found.signals] == [("Rate", "deg/s"), ("Temp", "degC")]


def test_a_delimiter_at_the_end_of_rows_is_named(write: Write) -> None:
    with pytest.raises(BadInput, match="a delimiter at the end of the line"):
        TableFile(write("time[s],rate[deg/s]\n0,1,\n1,2,\n"), G1).check()


def test_coarse_times_with_gaps_are_not_to_be_made_even(write: Write) -> None:
    times = [round(i * 2.5 + (100_000 if i > 600 else 0)) for i in range(1200)]
    rows = "\n".join(f"{t},{i % 7}" for i, t in enumerate(times))
    said = remarks(write(f"time[ms],rate[deg/s]\n{rows}\n"))
    assert "write them with more digits" in said
    assert "--sample-rate" not in said
