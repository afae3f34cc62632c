"""Files that travel beside the segments: certificates, error models, attestations; none that is here is replaced."""

from collections.abc import Callable
from pathlib import Path

from storage.carried_names import is_carried
from storage.replication.arriving.arrival import ArrivalRefused, Arrivals, Wanted
from storage.replication.sources.folder_source import kept_sha256
from storage.replication.sources.source import MAX_FILE_BYTES, MAX_FILES, CarriedFile, SegmentMissing, SegmentSource

_MAX_REFUSED = 1_000

Refuse = Callable[[str, str, str], None]


class Stopped(Exception):
    """The pass is to end now; the next one resumes."""


class CarriedFiles:
    """Fetches them in one pass; `added` have arrived."""

    def __init__(self) -> None:
        self.added = 0

    def fetch(
        self, source: SegmentSource, folder: Path, arrivals: Arrivals, report: Refuse, stopped: Callable[[], bool]
    ) -> None:
        """Bring those that a store's folder lacks; `report` gets kind, name and reason of what is not taken."""
        refused = 0

        def refuse(kind: str, name: str, what: str) -> None:
            nonlocal refused
            refused += 1
            report(kind, name, what)

        for number, file in enumerate(source.files()):
            if stopped():
                raise Stopped
            if number >= MAX_FILES or refused >= _MAX_REFUSED:
                refuse("endless_list", file.name, f"more than {number:,} files are listed, {refused:,} were refused")
                return
            if not is_carried(file.name) or not 0 <= file.size <= MAX_FILE_BYTES:
                refuse("file_invalid", file.name[:200], f"{file.name[:80]!r} is no file that travels, or too long")
            elif not (folder / file.name).exists():
                self._bring(source, file, folder / file.name, arrivals, refuse)
            elif _differs(folder / file.name, file):
                refuse("changed_file", file.name, f"{file.name} is another file than the one here, which is kept")

    def _bring(
        self, source: SegmentSource, file: CarriedFile, target: Path, arrivals: Arrivals, refuse: Refuse
    ) -> None:
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            arrivals.fetch(source, Wanted(file.name, file.size, file.sha256), target, lambda _part: None)
        except (ArrivalRefused, SegmentMissing) as error:
            refuse(error.kind if isinstance(error, ArrivalRefused) else "file_missing", file.name, str(error))
        else:
            self.added += 1


def _differs(path: Path, file: CarriedFile) -> bool:
    status = path.stat()
    if status.st_size != file.size:
        return True
    return kept_sha256(str(path), status.st_ino, status.st_size, status.st_mtime_ns) != file.sha256
