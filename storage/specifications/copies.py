"""Readable copies of the specifications in the store's folder ``products``; only the log counts."""

import os
import re
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from storage.findings import Finding, Severity
from storage.specifications.chain import Chain, read_chain
from storage.store import Store
from stream.errors import StoreError
from stream.events import SpecificationEntered
from stream.files.atomic_file import write_durably

FOLDER = "products"
_PLAIN = re.compile(r"\w[^/\x00]{0,199}")


def write_copy(store: Store, document: SpecificationEntered) -> None:
    """Write the copy of a revision; StoreError if it cannot be written."""
    path = store.folder / FOLDER / f"{document.name}-{document.revision}.toml"
    fresh = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(exist_ok=True)
        write_durably(path, document.content.encode(), fresh=fresh, mode=0o444)
    except OSError as error:
        raise StoreError(
            f"cannot write {path}: {error}; free the disk or mend its permissions, then `gyrofleet recover`"
        ) from error


def write_missing_copies(store: Store) -> None:
    """Write the copies of entered revisions that are not there, from the log; a name is never a path."""
    for name, document in _contents(read_chain(store)).items():
        if _PLAIN.fullmatch(name) is not None and not (store.folder / FOLDER / f"{name}.toml").exists():
            write_copy(store, document)


def specification_findings(store: Store) -> list[Finding]:
    """Breaks of the chain of specifications, and files in ``products`` that differ from the log."""
    try:
        chain = read_chain(store)
    except StoreError:
        return []  # other checks report a damaged log or lake
    return [*chain_findings(store, chain), *copy_findings(store, chain)]


def chain_findings(store: Store, chain: Chain) -> Iterator[Finding]:
    """A finding for each break of the chain."""
    labels = {link.hash: link.label for link in chain.links}
    for each in chain.breaks:
        what = f"the chain of specification documents is broken at {labels[each.at]} ({each.at[:12]}): {each.what}"
        remedy = "restore the log from a copy; or accept it by `gyrofleet limits settle --reason ...`"
        yield Finding("specification_chain_broken", Severity.DAMAGE, str(store.log), what, remedy)


def copy_findings(store: Store, chain: Chain) -> Iterator[Finding]:
    """Files in ``products`` that differ from the log, or are not in it."""
    contents = _contents(chain)
    for path in sorted((store.folder / FOLDER).glob("*.toml")):
        if path.stem not in contents:
            what = "it was never entered, so that it has no effect"
            remedy = f"`gyrofleet limits add {path}` enters it; else delete it"
            yield Finding("specification_not_entered", Severity.UNFINISHED, str(path), what, remedy)
        elif _read(path) != contents[path.stem].content.encode():
            what = "it is not what was entered; verdicts follow the log, and the change has no effect"
            remedy = "quarantine it and write it from the log; a change is a new revision (`gyrofleet limits revise`)"
            yield Finding("specification_copy_changed", Severity.DAMAGE, str(path), what, remedy)


def mend_copies(store: Store) -> Iterator[Path]:
    """Restore copies that were changed; the changed file is kept beside them, and its path is yielded."""
    chain = read_chain(store)
    contents = _contents(chain)
    for finding in list(copy_findings(store, chain)):
        if finding.kind == "specification_copy_changed":
            path = Path(finding.where)
            aside = path.with_name(f"{path.name}.changed-{time.time_ns()}")
            path.rename(aside)
            write_copy(store, contents[path.stem])
            yield aside


def _contents(chain: Chain) -> Mapping[str, SpecificationEntered]:
    return {link.label: link.document for link in chain.links if link.document.content}


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""
