"""What a table holds, as its first pass finds it, and the pieces in which its samples come."""

from dataclasses import dataclass

from ingest.tables.grid import Sampling
from ingest.tables.rows import BadRow
from stream.batch import CountArray, FloatArray, IntArray
from stream.events import StepWords


@dataclass(frozen=True)
class SignalSummary:
    """One signal of one unit and run, as the first pass finds it.

    Parameters
    ----------
    unit, run, signal: Which.
    unit_of_measure: Unit of its values.
    is_counts: Whether it is delivered as counts (int32) rather than values (float64).
    sampling: Samples, times and interval.
    """

    unit: str
    run: str
    signal: str
    unit_of_measure: str
    is_counts: bool
    sampling: Sampling


@dataclass(frozen=True)
class TableSummary:
    """What a table holds.

    Parameters
    ----------
    rows: Rows in the file, without header and blank lines.
    bad_rows: How many of them are bad.
    bad: The first 1000 of these.
    date_known: Whether times are UTC; else they count from an unknown moment.
    steps: Steps that the step words make.
    signals: Every signal that has samples.
    counted: What `rows` counts, for people.
    damage: What is wrong with the file as a whole, where what is good of it is used; empty where nothing is.
    remarks: What whoever imports it should know, for people.
    words: What was given for all of its steps, where the file does not say it.
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
    """Consecutive samples of one signal: counts where `data` is int32, values where it is float64."""

    unit: str
    run: str
    signal: str
    times_ns: IntArray
    data: FloatArray | CountArray
