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
    unit, run, signal : str
        Which.
    unit_of_measure : str
        Unit of its values.
    is_counts : bool
        Whether it is delivered as counts (int32) rather than values (float64).
    sampling : Sampling
        Samples, times and interval.
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
    rows : int
        Rows in the file, without header and blank lines.
    bad_rows : int
        How many of them are bad.
    bad : tuple of BadRow
        The first 1000 of these.
    date_known : bool
        Whether times are UTC; else they count from an unknown moment.
    steps : int
        Steps that the step words make.
    signals : tuple of SignalSummary
        Every signal that has samples.
    counted : str
        What `rows` counts, for people.
    damage : str
        What is wrong with the file as a whole, where what is good of it is used; empty where nothing is.
    remarks : tuple of str
        What whoever imports it should know, for people.
    words : StepWords, optional
        What was given for all of its steps, where the file does not say it.
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
