"""Which units are tested, and in which slots: a table, or serials from a barcode reader, one a line."""

import csv
import io
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import NAMESPACE_URL, uuid5

import msgspec

from stream.errors import BadInput
from stream.events import UnitMounted
from stream.identity import check_name
from stream.security.pem_text import fault_of_pem

if TYPE_CHECKING:
    from ingest.station.station import SlotTable

STDIN = "-"
COLUMNS = ("serial", "slot", "lot", "operator", "fixture", "firmware", "product")
# other titles of the columns; the first of several is taken, the others are details
_TITLES = {
    "serial": ("serial", "serial number", "serial_number", "unit", "编号", "产品编号", "序列号"),
    "slot": ("slot", "工位"),
    "lot": ("lot", "batch", "批次", "批号"),
    "operator": ("operator", "操作员"),
    "fixture": ("fixture", "夹具"),
    "firmware": ("firmware", "固件"),
    "product": ("product", "model", "产品型号", "型号"),
}

_MOST_BYTES = 16_000_000
_MOST_CHARACTERS = 1000
_DELIMITERS = (",", ";", "\t")
_ENCODINGS = ("utf-8-sig", "gb18030")
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_COLUMN = re.compile(r"[^\x00-\x1f\"']{1,64}")
_LISTED = 20
_Problem = tuple[int, str]  # line and what is wrong with it
_NAMESPACE = uuid5(NAMESPACE_URL, "gyrofleet/unit-mounted")


class UnitEntry(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One unit that is tested."""

    serial: str  # its serial number, which is its name in the data
    slot: str | None = None
    lot: str | None = None
    operator: str | None = None
    fixture: str | None = None
    firmware: str | None = None
    product: str | None = None
    details: dict[str, str] = {}  # the file's other columns, by their titles
    line: int = 0  # its line in the file, from 1


class UnitsFile(msgspec.Struct, frozen=True, kw_only=True):
    """The entries of a file of units, in its order, and how many lines of it are empty."""

    entries: tuple[UnitEntry, ...]
    empty_lines: int = 0


def read_units(path: str | Path, slots: Iterable[str] | None = None) -> UnitsFile:
    """Read which units are tested from a file, or from standard input where the path is ``-``.

    It is a table with a first line of titles, one of them ``serial`` or ``unit`` (comma, semicolon or tab between
    columns), or plain text with one serial a line; UTF-8, GB 18030, or UTF-16 with its mark. Only the station's `slots`
    are taken. Raises BadInput if it cannot be read, or units are missing, named twice, put into one slot or a slot that
    is not there; all problems are listed with their lines.
    """
    if str(path) == STDIN:
        content, source = sys.stdin.buffer.read(_MOST_BYTES + 1), "standard input"
    else:
        source = str(path)
        try:
            with Path(path).open("rb") as file:
                content = file.read(_MOST_BYTES + 1)
        except OSError as error:
            raise BadInput(f"units {source} cannot be read: {error.strerror or error}") from error
    if len(content) > _MOST_BYTES:
        raise BadInput(f"units {source}: more than {_MOST_BYTES:,} bytes; this is no list of units")
    return parse_units(content, source, slots)


def parse_units(content: bytes, source: str, slots: Iterable[str] | None = None) -> UnitsFile:
    r"""Read which units are tested; see `read_units`.

    >>> found = parse_units("serial,slot,colour\nFOG-1,A1,red\n\nFOG-2,A2,\n".encode(), "units.csv")
    >>> [(each.serial, each.slot, each.details) for each in found.entries], found.empty_lines
    ([('FOG-1', 'A1', {'colour': 'red'}), ('FOG-2', 'A2', {})], 1)
    >>> [each.serial for each in parse_units(b"FOG-1\r\nFOG-2\r\n", "scan").entries]
    ['FOG-1', 'FOG-2']
    """
    if fault := fault_of_pem(content):
        raise BadInput(f"units {source}: {fault}")
    rows, empty = _rows(_decoded(content, source), source)
    if not rows:
        raise BadInput(f"units {source}: it is empty; one serial a line is expected, or a table with a column serial")
    problems: list[_Problem] = []
    titles = rows[0][1]
    if "serial" in _named(titles):
        entries = list(_table(rows, source, problems))
    elif len(titles) > 1:
        raise BadInput(
            f"units {source}, line {rows[0][0]}: no title 'serial' among {', '.join(repr(each) for each in titles)}; "
            f"the first line names the columns: {', '.join(COLUMNS)}, and others freely"
        )
    else:
        entries = list(_plain(rows, problems))
    problems += _conflicts(entries, None if slots is None else tuple(slots))
    if problems:
        listed = "; ".join(f"line {line}: {what}" for line, what in sorted(problems)[:_LISTED])
        more = f"; and {len(problems) - _LISTED} more" if len(problems) > _LISTED else ""
        raise BadInput(f"units {source}: {listed}{more}. Nothing of it is taken; correct these lines")
    if not entries:
        raise BadInput(f"units {source}: titles, but no unit below them")
    return UnitsFile(entries=tuple(entries), empty_lines=empty)


def assigned(entries: Sequence[UnitEntry], slots: Sequence[str]) -> tuple[UnitEntry, ...]:
    """Give free slots to entries without one, in the order in which they are scanned; raises BadInput if too few."""
    taken = {entry.slot for entry in entries}
    free = [slot for slot in slots if slot not in taken]
    wanting = sum(entry.slot is None for entry in entries)
    if wanting > len(free):
        raise BadInput(f"{wanting} units have no slot, and {len(free)} of the station's {len(slots)} slots are free")
    left = iter(free)
    return tuple(entry if entry.slot else msgspec.structs.replace(entry, slot=next(left)) for entry in entries)


def in_fixtures(entries: Iterable[UnitEntry], slots: "Mapping[str, SlotTable]") -> tuple[UnitEntry, ...]:
    """Entries with the fixtures of their slots, where the file of units names none."""

    def with_fixture(entry: UnitEntry) -> UnitEntry:
        slot = slots.get(entry.slot or "")
        if entry.fixture or slot is None or not slot.fixture:
            return entry
        return msgspec.structs.replace(entry, fixture=slot.fixture)

    return tuple(map(with_fixture, entries))


def mounted_documents(entries: Iterable[UnitEntry], run: str, t_ns: int) -> tuple[UnitMounted, ...]:
    """Documents of the units; for the same run and `t_ns` on the station's clock they have the same identities."""

    def uid(entry: UnitEntry) -> str:
        content = msgspec.json.encode([run, t_ns, msgspec.structs.replace(entry, line=0)])
        return uuid5(_NAMESPACE, content.decode()).hex

    return tuple(
        UnitMounted(
            run=run, t_ns=t_ns, uid=uid(entry), unit=entry.serial, details=entry.details,
            **{name: getattr(entry, name) for name in COLUMNS[1:]},
        )
        for entry in entries
    )  # fmt: skip


def _decoded(content: bytes, source: str) -> str:
    for encoding in ("utf-16",) if content.startswith(_UTF16_MARKS) else _ENCODINGS:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\x00" in text:
            break
        return text
    raise BadInput(f"units {source}: neither UTF-8 nor GB 18030 text; save it as CSV in UTF-8")


def _rows(text: str, source: str) -> tuple[list[tuple[int, list[str]]], int]:
    """Cells of the lines that hold any, each with the number of its line, and how many hold none."""
    first = next((line for line in text.splitlines() if line.strip()), "")
    delimiter = max(_DELIMITERS, key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    rows: list[tuple[int, list[str]]] = []
    empty, line = 0, 1
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                rows.append((line, [cell.strip() for cell in cells]))
            else:
                empty += 1
            line = reader.line_num + 1
    except csv.Error as error:
        raise BadInput(f"units {source}, line {line}: {error}") from error
    return rows, empty


def _plain(rows: list[tuple[int, list[str]]], problems: list[_Problem]) -> Iterator[UnitEntry]:
    for line, cells in rows:
        if len(cells) > 1:
            problems.append((line, f"{len(cells)} columns without titles; one serial a line is expected"))
        elif _is_good("unit", cells[0], line, problems):
            yield UnitEntry(serial=cells[0], line=line)


def _named(titles: Sequence[str]) -> list[str]:
    """Titles, those of the columns by their names.

    >>> _named(["Unit", "产品型号", "colour"]), _named(["unit", "Serial"])
    (['serial', 'product', 'colour'], ['unit', 'serial'])
    """
    lower = [title.strip().lower() for title in titles]
    names = {next((each for each in known if each in lower), known[0]): name for name, known in _TITLES.items()}
    return [names.get(low, title) for low, title in zip(lower, titles, strict=True)]


def _table(rows: list[tuple[int, list[str]]], source: str, problems: list[_Problem]) -> Iterator[UnitEntry]:
    head_line, titles = rows[0]
    named = _named(titles)
    for i, title in enumerate(named):
        if _COLUMN.fullmatch(title) is None:
            raise BadInput(f"units {source}, line {head_line}: column {i + 1} has the title {title!r}; give it a name")
        if title in named[:i]:
            raise BadInput(f"units {source}, line {head_line}: two columns are named {title!r}")
    for line, cells in rows[1:]:
        if len(cells) > len(named):
            problems.append((line, f"{len(cells)} columns, the titles name {len(named)}"))
            continue
        given = {title: cell for title, cell in zip(named, cells, strict=False) if cell}
        if long := [title for title, cell in given.items() if len(cell) > _MOST_CHARACTERS]:
            problems.append((line, f"more than {_MOST_CHARACTERS} characters in column {long[0]!r}"))
        elif "serial" not in given:
            problems.append((line, "no serial"))
        elif _is_good("unit", given["serial"], line, problems):
            known = {name: given.pop(name, None) for name in COLUMNS[1:]}
            yield UnitEntry(serial=given.pop("serial"), **known, details=given, line=line)


def _is_good(kind: str, name: str, line: int, problems: list[_Problem]) -> bool:
    try:
        check_name(kind, name)
    except BadInput as error:
        problems.append((line, str(error)))
        return False
    return True


def _conflicts(entries: Sequence[UnitEntry], slots: tuple[str, ...] | None) -> Iterator[_Problem]:
    serials: dict[str, int] = {}
    taken: dict[str, UnitEntry] = {}
    for entry in entries:
        if (before := serials.setdefault(entry.serial, entry.line)) != entry.line:
            yield entry.line, f"unit {entry.serial} is on line {before} already"
        if entry.slot is None:
            continue
        if slots is not None and entry.slot not in slots:
            listed = ", ".join(slots) or "it has none"
            yield entry.line, f"slot {entry.slot!r} is none of the station's: {listed}"
        if (other := taken.setdefault(entry.slot, entry)) is not entry:
            yield entry.line, f"slot {entry.slot} is taken by {other.serial} on line {other.line}"
