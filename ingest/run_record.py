"""What a station's run and a run of simulated units share: the state in a small file, and the documents."""

from pathlib import Path
from typing import Any, Generic, Literal, TypeVar
from uuid import NAMESPACE_URL, UUID, uuid5

import msgspec
from msgspec.structs import replace

from stream.decoding import decode_json
from stream.delivery.publisher import Sender
from stream.delivery.spool import Spool
from stream.errors import StoreError
from stream.events import AnyDocument, StreamTotal
from stream.files.atomic_file import write_durably
from stream.identity import Place, SampleKey, event_key, parse_key

State = TypeVar("State", bound=msgspec.Struct)

Outcome = Literal["completed", "stopped", "aborted"]
Phase = Literal["starting", "running", "ending", "ended"]
"""`starting` until the first documents are kept, `running`, `ending` when nothing more is measured, `ended` when a
recorder has everything."""


def read_state(path: Path, kind: type[State]) -> State | None:
    """The state that a file keeps, None without a file; raises StoreError if it cannot be read as this kind."""
    try:
        return decode_json(path.read_bytes(), kind)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.MsgspecError) as error:
        raise StoreError(
            f"{path} cannot be read: {error}; the run's samples are safe, but it cannot be resumed: give another --run"
        ) from error


def write_state(path: Path, state: State) -> State:
    """Put a state in the place of the one before, which stays if it cannot be written (StoreError); returns it.

    >>> import tempfile
    >>> class Progress(msgspec.Struct):
    ...     step: int
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = write_state(Path(folder) / "run.json", Progress(3))
    ...     read_state(Path(folder) / "run.json", Progress)
    Progress(step=3)
    """
    try:
        write_durably(path, msgspec.json.format(msgspec.json.encode(state)) + b"\n")
    except OSError as error:
        raise StoreError(f"{path} cannot be written: {error}; free space or mend the disk, and start again") from error
    return state


class RunRecord(Generic[State]):
    """Owner of a run's state: only its methods change it, and every change is in `file` when they return.

    The `spool` keeps what is sent until it is recorded. A run whose state cannot be written raises StoreError at its
    begin and at its end. In between, as on a full disk, it goes on: `unsaved` is why its file is behind, None where it
    is not, and each further change is written again.
    """

    def __init__(self, state: State, file: Path, spool: Spool, place: Place) -> None:
        self.state, self.place, self._file, self._spool = state, place, file, spool
        self.unsaved: str | None = None
        self._sender: Sender | None = None

    @property
    def samples(self) -> int:
        """Samples of the run so far, whichever process has sent them."""
        return sum(total.samples for total in self._totals())

    def close(self) -> None:
        """Record that a recorder has everything."""
        self._save(phase="ended")
        if self.unsaved is not None:
            raise StoreError(self.unsaved)

    def _totals(self) -> tuple[StreamTotal, ...]:
        """Samples of every stream of the run."""
        totals = []
        for stream, known in self._spool.streams.items():
            key = parse_key(stream.key)
            if isinstance(key, SampleKey) and known.appended:
                epoch = str(UUID(stream.epoch))
                totals.append(StreamTotal(unit=key.unit, signal=key.signal, epoch=epoch, samples=known.appended))
        return tuple(sorted(totals, key=lambda total: (total.unit, total.signal, total.epoch)))

    def _save(self, **changes: Any) -> None:
        self.state = replace(self.state, **changes)
        try:
            write_state(self._file, self.state)
            self.unsaved = None
        except StoreError as error:
            if not self._file.exists():
                raise
            self.unsaved = (
                f"{self._file} cannot be written: {error.__cause__}; the run goes on, and after a crash would resume "
                "from what was written last: free space or mend the disk"
            )

    def _send(self, document: AnyDocument) -> None:
        assert self._sender is not None
        self._sender.send_event(event_key(self.place), document)


def document_uid(name: str) -> str:
    """Identity of a document: the same document has the same identity however often it is sent."""
    return uuid5(NAMESPACE_URL, name).hex
