"""What a backup holds of a store: all of its log, and every file that cannot be computed from it."""

from collections.abc import Iterator
from pathlib import Path

from storage.log.files import is_own
from storage.manifests.lake import NEW_LAKE
from storage.manifests.log import SNAPSHOT
from storage.sql.catalog import layers
from storage.store import Store
from storage.store_marker import MARKER, REPLICA

_DERIVED = {"lake", NEW_LAKE, "checkpoints", "plots", "reports", SNAPSHOT, "published"}
_OF_PROCESSES = {"tmp", "status", "control", "spool"}
_OF_FLEET = {REPLICA}  # the backup of a copy in a fleet store is one of the plant's own store
DATABASE = ".db"


def other_files(store: Store) -> Iterator[Path]:
    """Files beside the log: certificates, error models, copies of specifications, keys, kept alerts.

    Left out is what is computed from the log, what processes that are at work tell each other, and the spool of a
    source, whose messages are not in the store yet.
    """
    left_out = _DERIVED | _OF_PROCESSES | _OF_FLEET | {"log", *(layer.folder for layer in layers())}
    for top in sorted(store.folder.iterdir()):
        if top.name in left_out or top.name.startswith(("lake-aside", f"{store.lake.name}-aside")):
            continue
        for path in [top] if top.is_file() else sorted(top.rglob("*")):
            if path.is_file() and not path.is_symlink() and not _is_temporary(path):
                yield path


def unlisted_segments(store: Store, listed: set[str]) -> list[Path]:
    """Segments that the log's manifest does not list: the one that is written now, and one that was just sealed."""
    found = [*store.log.glob("*.mcap"), *store.log.glob("*.mcap.open")]
    return sorted(path for path in found if path.name not in listed and is_own(store, path))


def _is_temporary(path: Path) -> bool:
    return path.suffix in {".lock", ".part"} or path.name in {".lock", MARKER} or path.name.endswith(("-wal", "-shm"))
