"""All errors of gyrofleet.

Every message is a sentence a test engineer can act on: what happened (unit, run, file, line), what was
expected, and what to do next.
"""

_MOST_CHARS = 2000  # of a message; more is of a file that is none, and would hide what is wrong
_HEAD_CHARS, _TAIL_CHARS = 1400, 400


class GyrofleetError(Exception):
    """Base class of all errors that gyrofleet raises on purpose; the text is for people.

    >>> len(str(BadInput("x" * 100_000))) < 2000
    True
    """

    exit_code = 1  # exit code of a command that fails with it
    option = ""  # of a command, by its parameter's name, where the error is about one

    def __str__(self) -> str:
        """The message; the middle of an overlong one is left out."""
        text = super().__str__()
        if len(text) <= _MOST_CHARS:
            return text
        left_out = len(text) - _HEAD_CHARS - _TAIL_CHARS
        return f"{text[:_HEAD_CHARS]} ... ({left_out:,} characters left out) ... {text[-_TAIL_CHARS:]}"


class BadInput(GyrofleetError):
    """A file, column, cell or option that violates the import contract."""


class UnknownUnit(BadInput):
    """A unit of measure that cannot be read."""


class NotFound(GyrofleetError):
    """A unit, signal or run that the store does not hold."""


class NotEnoughData(GyrofleetError):
    """A record that is too short, or a question that the data cannot answer; the message says why."""


class QueryError(GyrofleetError):
    """A SQL statement that is refused, fails, or exceeds its limits."""

    exit_code = 2


class StoreError(GyrofleetError):
    """A store that cannot be opened, written or trusted."""


class OutOfMemory(GyrofleetError):
    """Valid data that does not fit into the available memory."""


class WireError(GyrofleetError):
    """A message that cannot be decoded."""


class NewerSchema(WireError):
    """A message written by a newer gyrofleet than this one."""


class BusError(GyrofleetError):
    """A bus that cannot be opened or reached."""


class DeliveryError(GyrofleetError):
    """Samples that no recorder has acknowledged in time."""


class InstrumentError(GyrofleetError):
    """An instrument or bus that cannot be reached, refuses, or answers nonsense."""


class RunAborted(GyrofleetError):
    """A run ended early by an operator or a fault."""


class EstimatorError(GyrofleetError):
    """Invalid input of an estimator."""


class CheckpointDamaged(EstimatorError):
    """A checkpoint that cannot be resumed from; the one before it, or the log, can."""
