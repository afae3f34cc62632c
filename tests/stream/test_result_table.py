"""Tables at the widths of real terminals: no word is broken, no cell is lost."""

import io
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from rich.text import Text

from stream.terminal.result_table import ResultTable

ROWS = [
    ("Bias stability, 100 s averages", "rate", "0.01234 deg/h", "0.0117 .. 0.0131", "GJB2426A 5.12.2; JJF2014 7.2.14"),
    ("Scale factor", "rate", "3 rates needed, 1 seen", "", "GJB2426A 5.10.1"),
]
HEADERS = ("characteristic", "signal", "value", "95 % interval", "clause")


def printed(width: int, rows: Sequence[tuple[str, ...]] = ROWS, headers: tuple[str, ...] = HEADERS) -> str:
    table = ResultTable(*headers, title="FOG-1", caption="2 rows")
    for row in rows:
        table.add_row(*row)
    console = Console(width=width, file=io.StringIO(), color_system=None)
    console.print(table)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


@pytest.mark.parametrize("width", [30, 40, 60, 80, 100, 120, 200])
def test_every_word_stands_whole_within_the_width(width: int) -> None:
    text = printed(width)
    assert max(map(len, text.splitlines())) <= width
    words = text.split()
    for cell in (*HEADERS, *ROWS[0], *ROWS[1], "FOG-1", "2 rows"):
        assert set(cell.split()) <= set(words)


def test_the_frame_goes_before_text_wraps_and_wrapping_before_blocks() -> None:
    wide, wrapped, blocks = printed(140), printed(80), printed(40)
    assert "┃" in wide
    assert "┃" not in wrapped
    assert "GJB2426A 5.12.2;" in wrapped
    assert "─" in wrapped
    assert "─" not in blocks
    assert "signal          rate" in blocks


def test_an_empty_cell_takes_no_line_in_a_block() -> None:
    assert printed(40).count("95 % interval") == 1


def test_values_beside_chinese_headers_stand_in_one_column() -> None:
    row = tuple(each + " " + 18 * "y" for each in "一二三")
    lines = printed(40, [row], ("批次", "规范版本", "reason")).splitlines()
    columns = {Text(line[: line.index(value)]).cell_len for line in lines for value in "一二三" if value in line}
    assert columns == {len("规范版本") * 2 + 2}


def test_a_table_without_rows_has_its_headers() -> None:
    assert set(HEADERS[0].split()) <= set(printed(200, []).split())


def test_a_styled_cell_keeps_its_style_in_a_block() -> None:
    table = ResultTable("unit", "reason")
    table.add_row("FOG-1", Text("not_enough_data_in_this_run", "yellow"))
    console = Console(width=30, file=io.StringIO(), force_terminal=True, color_system="standard")
    console.print(table)
    assert isinstance(console.file, io.StringIO)
    assert "\x1b[33m" in console.file.getvalue()


@settings(deadline=None, max_examples=60)
@given(
    rows=st.lists(st.lists(st.text("abc 漢", min_size=0, max_size=40), min_size=3, max_size=3), min_size=1, max_size=4),
    width=st.integers(20, 120),
)
def test_no_letter_is_lost(rows: list[list[str]], width: int) -> None:
    text = printed(width, [tuple(row) for row in rows], ("x1", "x2", "x3"))
    for letter in "abc漢":
        assert text.count(letter) == sum(cell.count(letter) for row in rows for cell in row)
