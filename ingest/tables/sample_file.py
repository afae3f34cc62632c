"""Files of samples of any format: a first pass checks the file, a second one delivers its samples."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol
from uuid import UUID

from ingest.tables.rows import BadRow
from ingest.tables.steps import FileStep
from ingest.tables.timing.grid import Sampling
from stream.batch import BoolArray, CountArray, FloatArray, IntArray, SampleBatch
from stream.errors import BadInput
from stream.events import StepEnded, StepStarted, StepWords

CAN_LOG_SUFFIXES = frozenset({".blf", ".asc", ".trc", ".log", ".mf4"})

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
    """Result of the first pass; that of a CAN log has its `frames` too."""

    rows: int  # rows of the file, without header, comments and blank lines
    bad_rows: int  # number of bad rows; `bad` holds the first 1000
    bad: tuple[BadRow, ...]
    date_known: bool  # whether times are UTC; otherwise they count from an unknown moment
    steps: tuple[FileStep, ...]  # that the step words define
    signals: tuple[SignalSummary, ...]
    counted: str = "rows"  # what `rows` counts, for messages
    damage: str = ""  # defect of the file whose good part is used; empty if there is none
    remarks: tuple[str, ...] = ()  # sentences for the user
    words: StepWords | None = None  # step words that apply to all rows
    procedures: frozenset[str | None] = frozenset()  # those of the steps
    is_run_by_name: bool = False  # whether the run is named after the file


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
    """Size and modification time of a file, to detect changes between two passes."""

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
