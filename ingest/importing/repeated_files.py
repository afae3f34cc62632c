"""Files whose content a store has under the name of another unit or run."""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from storage.sql.catalog import Catalog

_NOTES = """
select run, document->>'$.text' from events
where kind = 'NoteAdded' and document->>'$.author' = 'import'
  and regexp_extract(document->>'$.text', '\\(sha256 (\\w+)\\)', 1) in (select unnest($contents))
order by t_ns, run
"""
_NOTE = re.compile(r"imported (?P<name>.*) \(sha256 (?P<content>\w+)\)(?: as (?P<units>.*))?: \d+ samples")
_LISTED = 3


def note_of_import(name: str, content: str, units: Sequence[str], samples: int) -> str:
    """Text of the note on an imported file.

    >>> note_of_import("a.csv", "5ab3", ["A-17"], 2400)
    'imported a.csv (sha256 5ab3) as A-17: 2400 samples'
    """
    return f"imported {name} (sha256 {content}) as {_listed(units)}: {samples} samples"


class ImportedFile(NamedTuple):
    """A file: its SHA-256, and its runs with their units."""

    content: str
    runs: Mapping[str, Sequence[str]]


def repeated_files(catalog: "Catalog", files: Sequence[ImportedFile]) -> list[str | None]:
    """Warnings on files that the store has under other names as well; None for each of the others."""
    stored: defaultdict[str, dict[tuple[str, str], str]] = defaultdict(dict)
    for run, text in catalog.rows(_NOTES, {"contents": sorted({each.content for each in files})}):
        if (found := _NOTE.match(text)) is not None and found["units"]:
            stored[found["content"]][found["units"], str(run)] = found["name"]
    return [_warning(each, stored[each.content]) for each in files]


def _warning(file: ImportedFile, stored: Mapping[tuple[str, str], str]) -> str | None:
    own = {(_listed(units), run) for run, units in file.runs.items()}
    others = [(*names, file_name) for names, file_name in stored.items() if names not in own]
    if not others:
        return None
    listed = ", ".join(f"unit {of}, run {run} ({name})" for of, run, name in others[:_LISTED])
    listed += f" and {len(others) - _LISTED} more" if len(others) > _LISTED else ""
    return (
        f"warning: the store has this very content as {listed} too: one measurement counts several times, and one of "
        "the names is probably wrong"
    )


def _listed(names: Sequence[str]) -> str:
    distinct = list(dict.fromkeys(names))
    return ", ".join(distinct[:_LISTED]) + (f" and {len(distinct) - _LISTED} more" if len(distinct) > _LISTED else "")
