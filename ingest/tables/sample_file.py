"""What a file must offer to be imported: a first pass that checks it, and a second that delivers its samples."""

from collections.abc import Callable, Iterator
from typing import Protocol
from uuid import UUID

from ingest.tables.summary import SignalChunk, TableSummary
from stream.batch import BoolArray, IntArray, SampleBatch
from stream.events import StepEnded, StepStarted

Progress = Callable[[float], None]
Keep = Callable[[str, str, str, IntArray], BoolArray]


class SampleFile(Protocol):
    """A file of samples, whatever its format: tables and CAN logs are."""

    def check(self, progress: Progress | None = None) -> TableSummary:
        """Read the whole file and say what it holds; raises BadInput where it cannot be used."""

    def chunks(self, progress: Progress | None = None) -> Iterator[SignalChunk]:
        """Every sample, signal by signal and block by block."""

    def batches(
        self, epoch_of: Callable[[str, str], UUID], keep: Keep | None = None, progress: Progress | None = None
    ) -> Iterator[SampleBatch | StepStarted | StepEnded]:
        """Batches of the samples that `keep` asks for, numbered from 0 per signal, and the steps around them."""
