"""Signals that share a grid have the sampling that each has alone; blocks that are kept are read once."""

from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ingest.tables.checks import GoodRows, Owner
from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from ingest.tables.rows import CellBlock, NumberCells, Room
from ingest.tables.text.csv_chunks import CsvTable
from ingest.tables.text.csv_lines import usual_lines
from ingest.tables.timing.grid import SamplingGrid, SignalGrids
from stream.batch import SampleBatch

_cells = st.sampled_from(["all", "some", "none", "valid"])
_blocks = st.lists(st.tuples(st.integers(1, 60), st.lists(_cells, min_size=3, max_size=3)), min_size=1, max_size=5)


@given(_blocks, st.integers(0, 2**32 - 1))
def test_signals_of_one_grid_have_the_sampling_of_each_alone(blocks: list[tuple[int, list[str]]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    grids, alone = SignalGrids(), [SamplingGrid() for _ in range(3)]
    begun: list[int] = []
    t_ns = 0
    for rows, cells in blocks:
        times_ns = t_ns + np.cumsum(rng.choice([10**7, 10**7, 3 * 10**7, 10**7 + 7], rows))
        t_ns = int(times_ns[-1])
        valid = {
            "all": None, "some": rng.random(rows) < 0.5, "none": np.zeros(rows, np.bool_),
            "valid": np.ones(rows, np.bool_),
        }  # fmt: skip
        signals = {f"s{k}": NumberCells(np.zeros(rows), valid[kind]) for k, kind in enumerate(cells)}
        grids.add(GoodRows(Owner("U1", "r1"), times_ns, signals, [(0, rows, None)], 1.0))
        for k, kind in enumerate(cells):
            mask = valid[kind]
            alone[k].add(times_ns if mask is None else times_ns[mask])
            if k not in begun and (mask is None or mask.any()):
                begun.append(k)
    assert grids.finish() == {(Owner("U1", "r1"), f"s{k}"): alone[k].finish() for k in begun}


@given(st.lists(st.sampled_from(["", " ", "#c", "t,x", "1,2", "\t"]), max_size=12), st.booleans(), st.integers(1, 4))
def test_lines_read_at_once_are_those_read_one_by_one(lines: list[str], has_end: bool, rows: int) -> None:
    text = "\r\n".join(lines) + "\r\n" * has_end
    content = text.encode()
    found: list[tuple[str, int]] = []
    end = 0
    for raw in content.splitlines(keepends=True):
        if sum(bool(each.strip()) and not each.startswith("#") for each, _ in found) >= rows:
            break
        end += len(raw)
        found.append((raw.decode().rstrip("\r\n"), end))
    assert usual_lines(content, rows, is_whole=True) == found
    begin = usual_lines(content, rows, is_whole=False)
    assert begin in ([], found)
    assert not usual_lines("t,ä\n1,2\n".encode(), rows, is_whole=True)
    assert not usual_lines(b"t,x\r1,2\n", rows, is_whole=True)


def batches(path: Path, options: TableOptions) -> list[SampleBatch]:
    table = TableFile(path, options)
    table.check()
    return [each for each in table.batches(lambda _unit, _run: UUID(int=1)) if isinstance(each, SampleBatch)]


def test_a_small_file_is_parsed_once_while_there_is_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time[s],rate[deg/s],flow[V]\n" + "".join(f"{i * 0.5},{i},{i % 7}.25\n" for i in range(300)))
    parsed: list[int] = []
    read = CsvTable._parse_fast

    def counting(table: CsvTable, block: bytes, line: int, done: float) -> CellBlock | None:
        parsed.append(line)
        return read(table, block, line, done)

    monkeypatch.setattr(CsvTable, "_parse_fast", counting)
    room = Room()
    kept = batches(path, TableOptions(unit="U1", room=room))
    assert len(parsed) == 1
    assert room.take(32 << 20)  # given back
    again = batches(path, TableOptions(unit="U1", room=Room(0)))
    assert len(parsed) == 3
    for one, other in zip(kept, again, strict=True):
        assert (one.signal, one.seq, one.t0_ns) == (other.signal, other.seq, other.t0_ns)
        assert np.array_equal(one.value_array, other.value_array)
