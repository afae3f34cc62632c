"""The one tree of errors.

Every message is a sentence a test engineer can act on: what happened (unit, run, file, line), what was
expected, and what to do next.
"""


class GyrofleetError(Exception):
    """Root of all errors that gyrofleet raises on purpose; its text is meant for people."""

    exit_code = 1
    """Of a command that ends with it."""


class BadInput(GyrofleetError):
    """A file, column, cell or option that does not keep the import contract."""


class UnknownUnit(BadInput):
    """A unit of measure that cannot be read."""


class NotFound(GyrofleetError):
    """A unit, signal or run that the store does not hold."""


class NotEnoughData(GyrofleetError):
    """A record that is too short, or a question that the data cannot answer; the message says why."""


class QueryError(GyrofleetError):
    """A SQL statement that is refused, fails, or takes more than it may."""

    exit_code = 2


class StoreError(GyrofleetError):
    """A store that cannot be opened, written or trusted."""


class OutOfMemory(GyrofleetError):
    """Something that does not fit into the memory there is, and may be sound."""


class WireError(GyrofleetError):
    """A message that cannot be decoded."""


class NewerSchema(WireError):
    """A message written by a newer gyrofleet than this one."""


class BusError(GyrofleetError):
    """A bus that cannot be opened or reached."""


class DeliveryError(GyrofleetError):
    """Samples that no recorder has acknowledged in time."""


class InstrumentError(GyrofleetError):
    """An instrument or bus that cannot be reached, refuses, or answers what makes no sense."""


class RunAborted(GyrofleetError):
    """A run that an operator or a fault has ended before its time."""


class EstimatorError(GyrofleetError):
    """An estimator that is given what it cannot use."""


class CheckpointDamaged(EstimatorError):
    """A checkpoint that cannot be gone on from; the one before it, or the log, can."""
