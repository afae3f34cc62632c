"""A lake that was made beside the one in force takes its place; begun once, it is finished by whoever comes next."""

import shutil
import time
from pathlib import Path

from storage.store import Store, sync_folder

NEW_LAKE = "lake-new"
_COMPLETE = "complete"  # in a new lake: it may take its place
_REMOVABLE = "removable"  # in an old one: nothing is in it that the new one has not


def switch(store: Store, *, keep_old: bool) -> None:
    """Let the new lake, which is complete, take the place of the old one, which is removed or quarantined."""
    mark = store.folder / NEW_LAKE / _COMPLETE
    mark.write_text("keep" if keep_old else "remove")
    sync_folder(mark.parent)
    finish_switch(store)


def finish_switch(store: Store) -> None:
    """Do what is left of a switch that was begun, if one was."""
    fresh = store.folder / NEW_LAKE
    if (fresh / _COMPLETE).exists():
        keep_old = (fresh / _COMPLETE).read_text() != "remove"
        if store.lake.exists() and any(store.lake.iterdir()):
            if not keep_old:
                (store.lake / _REMOVABLE).touch()
            store.lake.rename(store.folder / f"lake-aside-{time.time_ns()}")
        fresh.rename(store.lake)
        sync_folder(store.folder)
    (store.lake / _COMPLETE).unlink(missing_ok=True)
    for mark in store.folder.glob(f"lake-aside-*/{_REMOVABLE}"):
        shutil.rmtree(mark.parent)


def left_aside(store: Store) -> list[Path]:
    """Old lakes that were kept because they hold more than the log gives, and damaged parts of this one."""
    return sorted(store.folder.glob("lake-aside*"))
