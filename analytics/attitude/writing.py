"""Compensated rates of a run as a table: raw and compensated rates, and the angles since each step began."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as pq

from analytics.attitude.accuracy import CompensatedStep
from stream.errors import BadInput
from stream.files.atomic_file import replacement


def write_compensated(steps: Sequence[CompensatedStep], axes: Sequence[str], path: Path) -> int:
    """Write a table to FILE.parquet or FILE.csv, and return its rows; raises BadInput if that cannot be.

    Columns: `step` (its index), `t_ns`, and for each axis the rate by its scale factor, the compensated rate (deg/s),
    and the compensated angle since the step began (deg).
    """
    if path.suffix.lower() not in {".parquet", ".csv"}:
        raise BadInput(f"{path}: give a name that ends with .parquet or .csv")
    schema = _schema(axes)
    rows = 0
    try:
        with replacement(path) as fresh, ExitStack() as stack:
            to_parquet = path.suffix.lower() == ".parquet"
            writer = stack.enter_context(
                pq.ParquetWriter(fresh, schema) if to_parquet else csv.CSVWriter(fresh, schema)
            )
            for batch in _batches(steps, schema):
                writer.write_batch(batch)
                rows += batch.num_rows
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror or error}") from error
    return rows


def _schema(axes: Sequence[str]) -> pa.Schema:
    names = [name.lower() for name in axes]
    return pa.schema([
        ("step", pa.int64()), ("t_ns", pa.int64()), *((f"rate_{name}_deg_per_s", pa.float64()) for name in names),
        *((f"rate_{name}_compensated_deg_per_s", pa.float64()) for name in names),
        *((f"angle_{name}_compensated_deg", pa.float64()) for name in names),
    ])  # fmt: skip


def _batches(steps: Sequence[CompensatedStep], schema: pa.Schema) -> Iterator[pa.RecordBatch]:
    for each in steps:
        angles = np.cumsum(each.compensated_deg_per_s, axis=1) * each.rates.dt_s
        n = len(each.rates.t_ns)
        columns = [
            np.full(n, each.step.number, np.int64), each.rates.t_ns, *each.rates.deg_per_s,
            *each.compensated_deg_per_s, *angles,
        ]  # fmt: skip
        yield pa.record_batch([pa.array(column) for column in columns], schema=schema)
