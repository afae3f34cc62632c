"""The page of the keys of a station's files, from the classes that read them.

``python -m docs.file_keys > docs/reference/station-files.md`` writes it again.
"""

import inspect
import re
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, get_args, get_origin

import msgspec

_FIELD = re.compile(r"^ {4}(\w+): (.+?)(?: = (.+?))?(?:  # (.*))?$")
_COMMENT = re.compile(r"^ {4}# (.+)$")
_DEFAULTS = {"msgspec.field(default_factory=dict)": "{}", "None": "", "True": "true", "False": "false", "()": "[]"}
_WORDS = (
    (r"Annotated\[(\w+), msgspec\.Meta\([^)]*\)\]", r"\1"),
    (r"Literal\[([^]]+)\]", r"\1"),
    (r"tuple\[(.+), \.\.\.\]", r"list of \1"),
    (r"dict\[\w+, (.+?)\]", r"table of \1"),
    (r" \| None\b", ""),
    (r" \| ", " or "),
    (r"\b(str|Text|Name|Names|Value)\b", lambda found: "text or number" if found[0] == "Value" else "text"),
    (r"\bint\b", "whole number"),
    (r"\bfloat\b", "number"),
    (r"\bbool\b", "true or false"),
    (r"whole number or number", "number"),
    (r"\bIndex\b", "whole number"),
    (r"\bAny\b", "values"),
    (r"list of \"?(Item|FrameField)\b\"?", "list of tables"),
    (r"\b(\w+Options|\w+Entry|FrameNumber|FrameChecksum|StatedUncertainty|Series)\b", "table"),
    (r"table of table\b", "table of tables"),
)


def page() -> str:
    """The page."""
    from ingest.can.bus.interface import CanBusOptions
    from ingest.can.mapping_file import ChecksumEntry, CounterEntry, MessageEntry
    from ingest.instruments.scpi import ScpiOptions
    from ingest.measurement_standards import Standard
    from ingest.procedures.file import Item, Parameter
    from ingest.serial.frame_layout import FrameChecksum, FrameField, FrameLayout, FrameNumber
    from ingest.station.station import BusTable, LineTable, SlotTable, StationLocation, StationTable

    parts = ["# Keys of a station's files", "`gyrofleet config check FILE` checks each of them."]
    parts += ["## The station's file"]
    parts += _tables({"[station]": StationTable})
    parts += ["In the same table, the place:", _keys(StationLocation)]
    parts += _tables({"[buses.NAME]": BusTable, "bus of [buses.NAME]": CanBusOptions})
    parts += _tables({"[lines.NAME]": LineTable, "[slots.NAME]": SlotTable})
    parts += ['`[settings]`: the instrument of a setting that several have: `rate = "table"`.']
    parts += ["## Instruments", _text(ScpiOptions), _keys(ScpiOptions), *_instruments()]
    parts += ["### What is stated of an instrument, and of [standards.NAME]", _keys(Standard)]
    parts += ["## Mapping of CAN messages"]
    parts += _tables({"[[message]]": MessageEntry, "counter": CounterEntry, "checksum": ChecksumEntry})
    parts += ["## Layout of serial frames"]
    parts += _tables({"the file": FrameLayout, "[[fields]]": FrameField, "counter, length_field": FrameNumber})
    parts += _tables({"checksum of a frame": FrameChecksum})
    parts += ["## Procedures"]
    parts += _tables({"[[step]]": Item, "[parameters.NAME]": Parameter})
    return "\n\n".join(part for part in parts if part)


def _instruments() -> Iterable[str]:
    from ingest.instruments.base import instrument_kinds

    for kind, found in sorted(instrument_kinds().items()):
        yield f"### {kind}"
        yield f"Settings: {_named(found.settings)}. Signals: {_named(found.signals)}."
        if commands := getattr(found, "commands", None):
            rows = [(f"`{name}`", f"`{text}`") for name, text in commands.items()]
            yield _table(("commands and queries by name", "by default"), rows)
        yield _keys(found.options_type)


def _named(units: Any) -> str:
    return ", ".join(f"`{name}` in {unit}" for name, unit in units.items()) or "none"


def _tables(classes: dict[str, type[msgspec.Struct]]) -> list[str]:
    return [part for title, each in classes.items() for part in (f"### {title}", _text(each), _keys(each))]


def _text(each: type) -> str:
    """The docstring without its examples."""
    return inspect.cleandoc(each.__doc__ or "").partition("\n\n>>>")[0].replace("``", "`")


def _keys(each: type[msgspec.Struct]) -> str:
    """Keys of a table with types, defaults and meanings, of its own class."""
    rows, remark = [], ""
    names = vars(sys.modules[each.__module__])
    renamed = {field.name: field.encode_name for field in msgspec.structs.fields(each)}
    for line in textwrap.dedent(inspect.getsource(each)).splitlines():
        if line.lstrip().startswith(("def ", "@")):
            break
        if (found := _FIELD.match(line)) and found[1] in renamed:
            given = _DEFAULTS.get(found[3] or "", found[3])
            default = "needed" if found[3] is None else f"`{given}`" if given else ""
            what = (found[4] or remark).replace("``", "`")
            rows.append((f"`{renamed[found[1]]}`", _type(found[2], names), default, what))
        remark = "" if (comment := _COMMENT.match(line)) is None else comment[1]
    return _table(("key", "type", "by default", "what it is"), rows) if rows else ""


def _type(written: str, names: Mapping[str, Any] | None = None) -> str:
    """A type in plain words.

    >>> _type("tuple[str, ...]"), _type("float | None"), _type("dict[str, str]"), _type('Literal["N", "E"]')
    ('list of text', 'number', 'table of text', '"N", "E"')
    """
    for alias in re.findall(r"\b[A-Z]\w+", written):
        if choices := get_args(value) if get_origin(value := (names or {}).get(alias)) is Literal else ():
            written = written.replace(alias, ", ".join(f'"{each}"' for each in choices))
    for pattern, word in _WORDS:
        written = re.sub(pattern, word, written)
    return written


def _table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines: list[Sequence[str]] = [titles, ["---"] * len(titles), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


if __name__ == "__main__":
    print(page())
