"""Which units of a file are tested, and which measure beside them, as a chamber does."""

import re
from collections.abc import Iterable

from ingest.tables.sample_file import SignalSummary
from stream.quantities import is_angular_rate

# as the SQL macro `is_instrument_name` has it
_INSTRUMENT = re.compile(
    "^(table|input|chamber|command|set_?point|vibration|stage|platform|encoder|earth)"
    "|^(reference|ref|true|truth)(_|$)|^rate_(table|input|command|set_?point|reference|ref|true|truth)$"
    "|^(转台|台面|基准|参考|标准|指令|设定|给定|输入|温箱|地球)"
)
_OUTPUT = re.compile("^(rate|gyro|angle|output)")
_COUNTS = frozenset({"count", "LSB", "count/s", "LSB/s"})


def is_instrument_name(signal: str) -> bool:
    """Whether a signal is that of a table, a chamber, or a reference.

    >>> is_instrument_name("Table_rate"), is_instrument_name("rate_x")
    (True, False)
    """
    return _INSTRUMENT.search(signal.lower()) is not None


def tested_units(signals: Iterable[SignalSummary]) -> list[str]:
    """Units of which a signal may be the output of a gyro, by its unit of measure or its name."""
    return list(dict.fromkeys(each.unit for each in signals if may_be_output(each)))


def may_be_output(signal: SignalSummary) -> bool:
    """Whether a signal may be the output of a gyro, by its unit of measure or its name."""
    if is_instrument_name(signal.signal):
        return False
    if _OUTPUT.search(signal.signal.lower()) is not None or signal.unit_of_measure in _COUNTS:
        return True
    return is_angular_rate(signal.unit_of_measure)
