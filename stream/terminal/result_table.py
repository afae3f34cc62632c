"""Table of results that stays readable on a narrow terminal."""

from collections.abc import Iterable, Sequence
from typing import Any

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

_INDENT = 2


class ResultTable(Table):
    """Table that fits the width it is printed in.

    It is framed where it fits; in less room the frame goes, then text wraps between words. Where a column would have
    to break a word, each row becomes a block of lines, one a column, as psql's expanded display does.

    Its columns are titled by `headers`; `title` and `caption` stand above and below it.

    >>> table = ResultTable("unit", "reason")
    >>> table.add_row("FOG-1", "2 rates needed, 1 seen")
    >>> Console(width=12).print(table)
    unit
      FOG-1
    reason
      2 rates
      needed, 1
      seen
    """

    def __init__(self, *headers: str, title: str | None = None, caption: str | None = None) -> None:
        super().__init__(title=title, caption=caption, title_justify="left", caption_justify="left")
        self.header_style = "bold"
        for header in headers:
            self.add_column(header, overflow="fold")

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Print in the widest form that fits."""
        bounds = [self._bounds(column, console, options) for column in range(len(self.columns))]
        framed = options.max_width - 3 * len(bounds) - 1
        room = options.max_width - 2 * len(bounds) + 2
        if sum(each.maximum for each in bounds) <= framed:
            yield from super().__rich_console__(console, options)
        elif sum(each.minimum for each in bounds) <= room:
            self.box, self.show_edge, self.pad_edge, self.padding = box.SIMPLE_HEAD, False, False, (0, 1, 0, 0)
            for column, width in zip(self.columns, _shared(bounds, room), strict=True):
                column.width = width
            yield from super().__rich_console__(console, options)
        else:
            yield from self._blocks(console, options)

    def _bounds(self, column: int, console: Console, options: ConsoleOptions) -> Measurement:
        """Width of the longest word, and of the longest line, of a column."""
        cells: Iterable[RenderableType] = (self.columns[column].header, *self.columns[column].cells)
        measured = [Measurement.get(console, options, each) for each in cells]
        return Measurement(max(each.minimum for each in measured), max(each.maximum for each in measured))

    def _blocks(self, console: Console, options: ConsoleOptions) -> RenderResult:
        headers = [_text(column.header, console) for column in self.columns]
        indent = max(header.cell_len for header in headers) + 2
        beside = options.max_width - indent >= options.max_width // 2
        if self.title is not None:
            yield _text(self.title, console)
        for row, cells in enumerate(zip(*(column.cells for column in self.columns), strict=True)):
            if row:
                yield Segment.line()
            texts = [_text(cell, console) for cell in cells]
            if len(headers) > 1 and not any(text.plain for text in texts[1:]):  # the heading of a section
                yield texts[0]
                continue
            for header, text in zip(headers, texts, strict=True):
                if text.plain:
                    yield from _entry(header, text, indent if beside else None, console, options)
        if self.caption is not None:
            yield _text(self.caption, console)


def _entry(header: Text, text: Text, indent: int | None, console: Console, options: ConsoleOptions) -> RenderResult:
    """Lines of one cell: beside its header, or, without an indent, below it."""
    title = Text(header.plain, "bold")
    lines = text.wrap(console, options.max_width - (_INDENT if indent is None else indent), overflow="fold")
    for line in lines:
        line.rstrip()
    if indent is None:
        yield title
        yield from (Text(" " * _INDENT) + line for line in lines)
    else:
        title.pad_right(indent - title.cell_len)
        yield from ((Text(" " * indent) if at else title) + line for at, line in enumerate(lines))


def _text(cell: Any, console: Console) -> Text:
    return cell.copy() if isinstance(cell, Text) else console.render_str(str(cell))


def _shared(bounds: Sequence[Measurement], room: int) -> list[int]:
    """Widths between the bounds that fill the room, in proportion to what each column lacks."""
    least = sum(each.minimum for each in bounds)
    lacking = sum(each.maximum for each in bounds) - least
    extra = min(room - least, lacking)
    return [each.minimum + (each.maximum - each.minimum) * extra // max(lacking, 1) for each in bounds]
