"""Tables as bytes of the Arrow stream format, as tasks receive and return them."""

import pyarrow as pa

_OPTIONS = pa.ipc.IpcWriteOptions(compression="zstd")


def to_bytes(table: pa.Table) -> bytes:
    """A table as bytes, each number as it is.

    >>> from_bytes(to_bytes(pa.table({"t_ns": [1_763_683_200_000_000_001]})))["t_ns"].to_pylist()
    [1763683200000000001]
    """
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema, options=_OPTIONS) as writer:
        writer.write_table(table)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def from_bytes(content: bytes) -> pa.Table:
    """The table of bytes."""
    return pa.ipc.open_stream(content).read_all()
