"""Files of samples of any format: a first pass checks the file, a second one delivers its samples."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol
from uuid import UUID

from ingest.tables.grid import Sampling
from ingest.tables.rows import BadRow
from stream.batch import BoolArray, CountArray, FloatArray, IntArray, SampleBatch
from stream.errors import BadInput
from stream.events import StepEnded, StepStarted, StepWords

Progress = Callable[[float], None]
Keep = Callable[[str, str, str, IntArray], BoolArray]


@dataclass(frozen=True)
class SignalSummary:
    """One signal of one unit and run, delivered as counts (int32) or values (float64)."""

    unit: str
    run: str
    signal: str
    unit_of_measure: str
    is_counts: bool
    sampling: Sampling


@dataclass(frozen=True)
class TableSummary:
    """Result of the first pass.

    Parameters
    ----------
    rows: Rows of the file, without header, comments and blank lines.
    bad_rows: Number of bad rows; `bad` holds the first 1000.
    date_known: Whether times are UTC; otherwise they count from an unknown moment.
    steps: Steps that the step words define.
    counted: What `rows` counts, for messages.
    damage: Defect of the file whose good part is used; empty if there is none.
    remarks: Sentences for the user.
    words: Step words that apply to all rows.
    """

    rows: int
    bad_rows: int
    bad: tuple[BadRow, ...]
    date_known: bool
    steps: int
    signals: tuple[SignalSummary, ...]
    counted: str = "rows"
    damage: str = ""
    remarks: tuple[str, ...] = ()
    words: StepWords | None = None


@dataclass(frozen=True)
class SignalChunk:
    """Consecutive samples of one signal: counts if `data` is int32, values if it is float64."""

    unit: str
    run: str
    signal: str
    times_ns: IntArray
    data: FloatArray | CountArray


class SampleFile(Protocol):
    """A file of samples: a table or a CAN log."""

    def check(self, progress: Progress | None = None) -> TableSummary:
        """Read the whole file; raises BadInput if it cannot be used."""

    def chunks(self, progress: Progress | None = None) -> Iterator[SignalChunk]:
        """Every sample, signal by signal and block by block."""

    def batches(
        self, epoch_of: Callable[[str, str], UUID], keep: Keep | None = None, progress: Progress | None = None
    ) -> Iterator[SampleBatch | StepStarted | StepEnded]:
        """Batches of the samples that `keep` selects, numbered from 0 per signal, and the steps around them."""


class FileStamp:
    """Size and modification time of a file, to detect changes between two passes.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "drift.csv"
    ...     _ = path.write_text("1")
    ...     stamp = FileStamp(path)
    ...     stamp.check()
    ...     _ = path.write_text("12")
    ...     stamp.check()  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    stream.errors.BadInput: ...drift.csv: changed while it was read; import it again once it is complete
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found = self._now()

    def check(self) -> None:
        """Raise BadInput if the file has changed or is gone."""
        if self._now() != self._found:
            raise BadInput(f"{self._path}: changed while it was read; import it again once it is complete")

    def _now(self) -> tuple[int, int]:
        try:
            status = self._path.stat()
        except OSError:
            return -1, -1
        return status.st_size, status.st_mtime_ns
