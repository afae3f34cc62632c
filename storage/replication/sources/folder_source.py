"""A plant whose store, or an exported copy of its log, is a folder here."""

import os
from collections.abc import Iterator
from functools import lru_cache
from itertools import islice
from pathlib import Path

from storage.carried_names import is_carried
from storage.manifests.entries import SegmentEntry
from storage.manifests.log import FIRST, manifest_path
from storage.plant import Plant, plant_of
from storage.replication.plant_list import checked_line
from storage.replication.sources.source import MAX_FILE_BYTES, CarriedFile, SegmentMissing, SourceGone, is_segment
from storage.segments.disk import sha256_of
from storage.store import Store
from stream.closing import Closing
from stream.errors import StoreError

_FOLDERS = ("certificates", "models", "attestations")  # those that attest come after what they attest


class FolderSource(Closing):
    """The store of a plant as a source; `name` is the plant's at its first use, by default the folder's.

    The store may be written meanwhile: only sealed segments that the manifest lists are seen.
    """

    def __init__(self, folder: Path, name: str | None = None) -> None:
        self.store = Store.open(folder)
        self.where = str(folder)
        self._name = name
        self._place = (0, 0, 0)  # of the list's file: its number, lines read, and their bytes

    def plant(self) -> Plant | None:
        """Identity of the plant; None as long as its list is empty."""
        first = next(self._lines(0), None)
        if first is None:
            return None
        entry = checked_line(first, FIRST).entry
        return plant_of(self.store.folder, self.store.identity, (entry.segment, entry.sha256), self._name)

    def segments(self, after: int) -> Iterator[bytes]:
        """Lines of the log's manifest beyond the first `after`."""
        yield from self._lines(after)

    def originals(self) -> tuple[SegmentEntry, ...]:
        """None: a plant has what it lists last."""
        return ()

    def files(self) -> Iterator[CarriedFile]:
        """Issued certificates, error models and attestations."""
        root = self.store.folder
        for path in (path for folder in _FOLDERS for path in sorted((root / folder).rglob("*"))):
            name = path.relative_to(root).as_posix()
            if is_carried(name) and path.is_file() and not path.is_symlink():
                status = path.stat()
                if status.st_size <= MAX_FILE_BYTES:
                    digest = kept_sha256(str(path), status.st_ino, status.st_size, status.st_mtime_ns)
                    yield CarriedFile(name, status.st_size, digest)

    def read(self, name: str, offset: int, length: int) -> bytes:
        """A range of a segment or file; other files of the store are never read."""
        if not (is_segment(name) or is_carried(name)):
            raise SegmentMissing(f"{name[:80]!r} is no segment or file that travels")
        path = self.store.folder / name if is_carried(name) else self.store.log / name
        try:
            with path.open("rb") as file:
                return os.pread(file.fileno(), length, offset)
        except FileNotFoundError:
            raise SegmentMissing(f"{path} is missing") from None
        except OSError as error:
            raise SegmentMissing(f"{path} cannot be read: {error}") from error

    def close(self) -> None:
        """Nothing is open."""

    def _lines(self, after: int) -> Iterator[bytes]:
        path = manifest_path(self.store)
        try:
            with path.open("rb") as file:
                number = os.fstat(file.fileno()).st_ino
                is_known = self._place[0] == number and self._place[1] <= after
                lines, at = self._place[1:] if is_known else (0, 0)
                file.seek(at)
                for line in islice(file, after - lines):
                    lines, at = lines + 1, at + len(line)
                if lines < after:
                    return
                self._place = (number, lines, at)
                for line in file:
                    if line.endswith(b"\n"):  # else it is being written
                        yield line[:-1]
        except FileNotFoundError:
            if self.store.log.is_dir():
                return  # nothing is sealed yet
            raise SourceGone(f"{self.store.log} is missing") from None
        except OSError as error:
            raise SourceGone(f"{path} cannot be read: {error}") from error


@lru_cache(maxsize=1_000_000)
def kept_sha256(path: str, _number: int, _size: int, _mtime_ns: int) -> str:
    """SHA-256 of a file, computed once as long as its number, size and time stay."""
    try:
        return sha256_of(Path(path))
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error}") from error
