"""What the tests of the table reader share."""

from collections.abc import Callable
from pathlib import Path
from uuid import UUID

import numpy as np
import polars as pl
import pytest

from ingest.instruments.table_file import TableFile
from ingest.instruments.table_rows import BadRow
from stream.batch import SampleBatch
from stream.events import StepEnded, StepStarted

Delivered = list[SampleBatch | StepStarted | StepEnded]


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write text, bytes or columns as a file and give its path."""

    def do(content: str | bytes | dict[str, object], name: str = "run1.csv") -> Path:
        path = tmp_path / name
        if isinstance(content, dict):
            pl.DataFrame(content).write_parquet(path)
        else:
            path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return do


@pytest.fixture
def deliver() -> Callable[[TableFile], Delivered]:
    """Give everything that a table delivers, in one epoch."""
    return lambda table: list(table.batches(lambda unit, run: UUID(int=7)))


@pytest.fixture
def samples() -> Callable[[Delivered], dict[tuple[str, str, str], list[tuple[int, float]]]]:
    """Put batches together again: (time, value) of each unit, run and signal; checks the numbering."""

    def do(delivered: Delivered) -> dict[tuple[str, str, str], list[tuple[int, float]]]:
        result: dict[tuple[str, str, str], list[tuple[int, float]]] = {}
        for batch in delivered:
            if isinstance(batch, SampleBatch):
                found = result.setdefault((batch.unit, batch.run, batch.signal), [])
                assert batch.seq == len(found)
                assert np.all(np.diff(batch.time_array) > 0)
                found.extend(zip(batch.time_array.tolist(), batch.value_array.tolist(), strict=True))
        return result

    return do


@pytest.fixture
def by_signal() -> Callable[[Delivered], dict[str, Delivered]]:
    """Sort what is delivered by its signal; how signals are interleaved depends on the size of the blocks."""

    def do(delivered: Delivered) -> dict[str, Delivered]:
        result: dict[str, Delivered] = {}
        for item in delivered:
            result.setdefault(item.signal if isinstance(item, SampleBatch) else "steps", []).append(item)
        return result

    return do


@pytest.fixture
def said() -> Callable[[tuple[BadRow, ...]], list[str]]:
    """Give bad rows as people read them."""
    return lambda bad: [str(row) for row in bad]
