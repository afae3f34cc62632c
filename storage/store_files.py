"""Files of a store are written by the program alone, never as the output of a command."""

from pathlib import Path

from storage.store import Store
from stream.errors import BadInput

# folders in which people find what commands have written for them
_FOR_PEOPLE = {"plots", "reports"}


def check_outside(store: Store, path: Path) -> None:
    """Refuse an output file that would lie among a store's own files, or replace one.

    Raises
    ------
    BadInput: If it would.
    """
    folder, target = store.folder.resolve(), path.resolve()
    if target.is_relative_to(folder):
        inside = target.relative_to(folder).parts
        if len(inside) < 2 or inside[0] not in _FOR_PEOPLE:
            raise BadInput(f"{path} would lie among the files of the store {store.folder}; give a file elsewhere")
