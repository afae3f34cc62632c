"""Buckets of a signal that several parts of the lake have: those of all its samples, also beyond what is asked."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analytics.serve.api.query.signals import _buckets, _Stretch
from storage.lake.rollups import roll_up, rollup_tables
from storage.lake.tables import part_writers
from storage.sql.lake_source import LocalLake
from storage.store import Store

NS = 10**9
CHANNEL, RATE_HZ, PIECE_S, PIECES = 7, 10, 100, 4
T_NS = np.arange(RATE_HZ * PIECE_S * PIECES) * (NS // RATE_HZ)
VALUES = np.sin(np.arange(T_NS.size) * 0.7) * 1e3
Lake = tuple[LocalLake, list[dict[str, Any]]]


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """A record of 400 s in four parts, with other channels before and after it."""
    folder = tmp_path_factory.mktemp("lake")
    parts = []
    for number, (t_ns, values) in enumerate(zip(np.split(T_NS, PIECES), np.split(VALUES, PIECES), strict=True)):
        rollup = roll_up(t_ns, values)
        (folder / str(number)).mkdir()
        with part_writers(folder / str(number)) as writer:
            for name, table in zip(
                ("rollup_1s", "rollup_10s"), rollup_tables([(each, rollup) for each in (2, CHANNEL, 9)]), strict=True
            ):
                writer(name).write_all([table])
        parts.append({
            "channel": CHANNEL, "is_kept": False, "filename": str(folder / str(number) / "channels.parquet"),
            "samples": t_ns.size, "t_first_ns": int(t_ns[0]), "t_last_ns": int(t_ns[-1]), "is_counts": False,
            "scale": 1.0, "offset": 0.0,
        })  # fmt: skip
    return LocalLake(Store.create(folder / "store"), ()), parts


@settings(max_examples=60)
@given(
    first_s=st.integers(-50, 420), length_s=st.integers(1, 450), points=st.integers(2, 60),
    order=st.permutations(range(PIECES)),
)  # fmt: skip
def test_whole_buckets_have_the_samples_of_all_parts(
    lake: Lake, first_s: int, length_s: int, points: int, order: list[int]
) -> None:
    source, parts = lake
    first_ns, stop_ns = first_s * NS, (first_s + length_s) * NS
    _, width_ns, found, _ = _buckets(source, _Stretch(first_ns, stop_ns, points, [parts[each] for each in order]))
    slots = T_NS // max(width_ns, 1) * width_ns
    asked = np.unique(slots[(slots + width_ns > first_ns) & (slots < stop_ns)])
    if not ((first_ns <= T_NS) & (stop_ns > T_NS)).any():
        return
    assert found.slot.tolist() == asked.tolist()
    for slot, n, mean, lo, hi in zip(*found, strict=True):
        values = VALUES[slots == slot]
        assert (n, lo, hi) == (values.size, values.min(), values.max())
        assert mean == pytest.approx(values.mean(), abs=1e-9)
