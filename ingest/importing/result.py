"""Result of an import."""

from dataclasses import dataclass

from ingest.can.summary import CanCounts
from ingest.tables.rows import BadRow


@dataclass(frozen=True)
class SignalImport:
    """Result for one signal of a file; `in_lake` is None if the lake cannot be seen from here."""

    unit: str
    run: str
    signal: str
    unit_of_measure: str
    in_file: int
    added: int
    already_stored: int
    in_lake: int | None
    sample_interval_s: float
    irregular: bool


@dataclass(frozen=True)
class FileImport:
    """Result for one file."""

    file: str
    rows: int
    bad_row_count: int
    bad_rows: tuple[BadRow, ...]
    steps: int
    date_known: bool
    seconds: float
    signals: tuple[SignalImport, ...]
    recovered: tuple[str, ...] = ()
    counted: str = "rows"
    damage: str = ""
    remarks: tuple[str, ...] = ()
    frames: CanCounts | None = None

    @property
    def added(self) -> int:
        """Samples that the store did not have."""
        return sum(signal.added for signal in self.signals)
