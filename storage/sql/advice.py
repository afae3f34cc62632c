"""What somebody can do whose statement is refused, or exceeds a limit; it depends on where they ask."""

from typing import NamedTuple


class Advice(NamedTuple):
    """The ends of the messages: to keep a result, and of a statement with too many rows, too much time or memory."""

    kept: str
    rows: str
    time: str
    memory: str


COMMAND_LINE = Advice(
    kept="to keep a result use --csv or --parquet FILE",
    rows="ask for less, or for more rows (--max-rows, QueryLimits.rows)",
    time="ask for less, or give it more time (--max-time, QueryLimits.time_s)",
    memory="ask for less, or give it more (--max-memory, QueryLimits.memory_bytes)",
)
