"""Measured recordings, read in place."""

import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from stream.batch import SampleBatch
from stream.errors import BadInput
from stream.events import StepStarted

Tool = Callable[..., Any]
DATA = Path(__file__).parents[3].parent / "shared" / "data"
G1 = TableOptions(unit="G1")

pytestmark = [
    pytest.mark.measured,
    pytest.mark.skipif(not DATA.is_dir(), reason=f"measured recordings are not in {DATA}"),
]


def test_a_million_rows_at_100_hz(deliver: Tool) -> None:
    table = TableFile(DATA / "adis16405_static_run1.parquet", G1)
    begin = time.process_time()
    summary = table.check()
    middle = time.process_time()
    batches = deliver(table)
    end = time.process_time()
    assert (summary.rows, summary.bad_rows, summary.date_known) == (1_000_000, 0, False)
    for found in summary.signals:
        assert (found.sampling.samples, found.sampling.dt_ns, found.sampling.off_grid) == (1_000_000, 10**7, 0)
    assert Counter(map(len, batches)) == {6000: 6 * 166, 4000: 6}  # a minute each, and the rest
    assert all(batch.times_ns is None for batch in batches)
    # 7 million cells at 20 M cells/s, with room for a busy machine
    assert middle - begin < 1.5
    assert end - middle < 1.5


def test_steps_of_a_calibration_session(deliver: Tool, samples: Tool) -> None:
    path = DATA / "ferraris_session.parquet"
    table = TableFile(path, G1)
    assert {found.sampling.dt_ns for found in table.check().signals} == {9765625}
    delivered = deliver(table)
    steps = [str(item.words.step) for item in delivered if isinstance(item, StepStarted)]
    assert sorted(steps) == sorted(["x_p", "x_a", "y_p", "y_a", "z_p", "z_a", "x_rot", "y_rot", "z_rot"])
    found = samples(delivered)["G1", "ferraris_session", "rate_x"]
    assert [value for _, value in found] == pl.read_parquet(path)["rate_x[deg/s]"].to_list()


def test_bursts_stay_bursts(deliver: Tool) -> None:
    table = TableFile(DATA / "psim_cold_chamber.parquet", G1)
    summary = table.check()
    assert len(summary.steps) == 25
    kinds = {found.signal: found.is_counts for found in summary.signals}
    assert [signal for signal, is_counts in kinds.items() if is_counts] == ["temperature"]
    assert {(found.sampling.gaps, found.sampling.irregular) for found in summary.signals} == {(24, True)}
    rates = [item for item in deliver(table) if isinstance(item, SampleBatch) and item.signal == "rate_x"]
    assert len(rates) == 25
    assert max(batch.last_ns - batch.t0_ns for batch in rates) < 6 * 10**9


@pytest.mark.parametrize("unit", range(5))
def test_hand_rotations_in_rad_per_s(unit: int) -> None:
    summary = TableFile(DATA / f"mpu9150_unit{unit}.parquet", G1).check()
    assert {found.unit_of_measure for found in summary.signals} == {"rad/s", "m/s^2"}
    assert {found.sampling.irregular for found in summary.signals} == {False}


def test_a_wall_clock_without_a_date_is_refused() -> None:
    with pytest.raises(BadInput, match=r"column 'clock' holds '15:45', a time of day without a date: .*'clock='"):
        TableFile(DATA / "psim_cold_chamber_probe.csv", G1)
