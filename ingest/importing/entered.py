"""Documents that a person enters, above all checks made by eye or by hand."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from storage.recording.client import record_documents
from storage.store import Store, writer_endpoint
from stream.errors import BadInput
from stream.events import AnyDocument, CheckEntered, Verdict
from stream.identity import Place, check_name
from stream.quantities import check_unit

_MOST_TEXT = 1000


class Entry(NamedTuple):
    """A check as it was entered."""

    unit: str
    item: str  # what was checked: ``visual``, ``electrical``, or another word
    by: str  # the inspector
    verdict: Verdict | None = None  # PASS or FAIL; may be left out if there are a value and a limit
    value: float | None = None  # measured value; its limits are in the same unit
    unit_of_measure: str = ""
    lower: float | None = None
    upper: float | None = None
    note: str = ""
    run: str = ""  # the run that it belongs to; empty for none


def enter(folder: Path, documents: Sequence[AnyDocument], *, role: str) -> bool:
    """Write documents into a store, created if there is none, and on disk when this returns; whether SQL sees them now.

    It does not if a recorder writes the store, which brings checks to the lake in some seconds, anything else
    with its next segment. `role` is the name of the command, for the message that another writer gets. Raises
    StoreError if a process writes the store that takes no messages, or it cannot be written; DeliveryError if the
    recorder that writes it does not acknowledge them.
    """
    store = Store.create(folder)
    is_recorded = writer_endpoint(folder) is not None
    record_documents(store, documents, role=role, place=Place("local", "entered"), builds_lake=True)
    return not is_recorded


def check_entered(entry: Entry, t_ns: int) -> CheckEntered:
    """An entry as a document; raises BadInput if it is incomplete or contradicts itself."""
    check_name("unit", entry.unit)
    if entry.run:
        check_name("run", entry.run)
    for option, text in (("--item", entry.item), ("--by", entry.by)):
        if not text.strip():
            raise BadInput(f"check of unit {entry.unit}: {option} is empty; say what was checked, and who did")
    for option, text in (("--item", entry.item), ("--by", entry.by), ("--note", entry.note)):
        if len(text) > _MOST_TEXT:
            raise BadInput(f"check of unit {entry.unit}: {option} has {len(text)} characters, {_MOST_TEXT} may be")
    where = f"check {entry.item} of unit {entry.unit}"
    _check_numbers(entry, where)
    return CheckEntered(
        run=entry.run, t_ns=t_ns, unit=entry.unit, item=entry.item.strip(), verdict=_verdict(entry, where),
        by=entry.by.strip(), value=entry.value,
        unit_of_measure="" if entry.value is None else check_unit(entry.unit_of_measure), lower=entry.lower,
        upper=entry.upper, note=entry.note.strip(),
    )  # fmt: skip


def _check_numbers(entry: Entry, where: str) -> None:
    for option, number in (("--value", entry.value), ("--lower", entry.lower), ("--upper", entry.upper)):
        if number is not None and not math.isfinite(number):
            raise BadInput(f"{where}: {option} {number} is no finite number")
    if entry.value is None and (entry.unit_of_measure or entry.lower is not None or entry.upper is not None):
        raise BadInput(f"{where}: a limit or unit of measure without --value; give the value, or only the --verdict")
    if entry.lower is not None and entry.upper is not None and entry.lower > entry.upper:
        raise BadInput(f"{where}: --lower {entry.lower:g} lies above --upper {entry.upper:g}")


def _verdict(entry: Entry, where: str) -> Verdict:
    found: Verdict | None = None
    if entry.value is not None and (entry.lower is not None or entry.upper is not None):
        is_high = entry.lower is None or entry.value >= entry.lower
        found = Verdict.PASS if is_high and (entry.upper is None or entry.value <= entry.upper) else Verdict.FAIL
    if entry.verdict is None and found is None:
        raise BadInput(f"{where}: nothing says how it was judged; give --verdict PASS or FAIL, or --value and a limit")
    if entry.verdict is not None and found is not None and entry.verdict is not found:
        raise BadInput(
            f"{where}: --verdict is {entry.verdict}, but {entry.value:g} against its limits is {found}; correct the "
            f"one or the other, and explain in --note what is special"
        )
    return found or entry.verdict or Verdict.NO_DATA
