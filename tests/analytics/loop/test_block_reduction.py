"""Reduction of a store to blocks: equal to NumPy on the same samples; gaps, chosen runs, bad input."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.loop.blocks.block_reducer import BlockReducer, Reduction
from analytics.loop.model.error_model import ErrorModel
from storage.lake.builder import builder_lock
from storage.lake.lake import Lake
from storage.sql.catalog import Catalog
from storage.store import Store
from storage.upkeep.retention import Rule, apply_rule
from stream.batch import FloatArray
from stream.errors import BadInput, NotFound
from tests.analytics.conftest import SECOND_NS, START_NS, TestedUnits, reduced


def white_variance(values: FloatArray, per_piece: int) -> float:
    """Variance of the mean of `values` by successive differences of the means of pieces."""
    pieces = values.reshape(-1, per_piece).mean(axis=1)
    return float(np.mean(np.diff(pieces) ** 2) / 2.0 / len(pieces))


@pytest.mark.long
@pytest.mark.parametrize("block_s", [30.0, 10.0, 0.8])
def test_means_and_scatter_are_those_of_numpy(tested: TestedUnits, block_s: float) -> None:
    rng = np.random.default_rng(1)
    tested.run("r1")
    rate = 5.0 + rng.normal(0.0, 2.0, 6000) + np.linspace(0.0, 3.0, 6000)
    tested.samples("r1", "U1", "rate", rate / 3600.0, t0_ns=START_NS, dt_ns=SECOND_NS // 10, unit_of_measure="deg/s")
    (run,) = reduced(tested, block_s=block_s).runs
    per_block = round(10 * block_s)
    blocks = rate.reshape(-1, per_block)
    assert (run.unit_of_measure, run.t0_ns, run.block_s) == ("deg/h", START_NS, block_s)
    np.testing.assert_array_equal(run.slot, np.arange(len(blocks)))
    np.testing.assert_array_equal(run.n, per_block)
    np.testing.assert_allclose(run.value, blocks.mean(axis=1), rtol=1e-12)
    if block_s == 30.0:
        expected = [white_variance(each, 10) for each in blocks]
        np.testing.assert_allclose(run.white_variance, expected, rtol=1e-9)
    # 8 or more differences a block: sd of their mean square over two is at most sqrt(3/8) of it, less over all blocks
    assert np.median(run.white_variance) == pytest.approx(4.0 / per_block, rel=0.25)


def test_slow_change_hardly_counts_as_white_noise(tested: TestedUnits) -> None:
    tested.run("r1")
    ramp = np.linspace(0.0, 36.0, 36_000)  # deg/h over an hour: 0.3 in a block
    noise = np.random.default_rng(2).normal(0.0, 1.0, 36_000)
    tested.samples("r1", "U1", "rate", ramp + noise, t0_ns=START_NS)
    (run,) = reduced(tested).runs
    # 120 blocks of 29 differences, each with relative variance 2 and next ones correlated 1/4: sd of the mean 0.03
    assert run.white_variance.mean() == pytest.approx(1.0 / 300.0, rel=0.12)


def test_gaps_leap_and_a_short_block_takes_the_scatter_of_its_run(tested: TestedUnits) -> None:
    rng = np.random.default_rng(3)
    tested.run("r1")
    first, second, third = rng.normal(0.0, 1.0, 3000), rng.normal(0.0, 1.0, 65), rng.normal(0.0, 1.0, 35)
    tested.samples("r1", "U1", "rate", first, t0_ns=START_NS)
    tested.samples("r1", "U1", "rate", second, t0_ns=START_NS + 600 * SECOND_NS)
    tested.samples("r1", "U1", "rate", third, t0_ns=START_NS + 900 * SECOND_NS)
    (run,) = (reduction := reduced(tested)).runs
    assert run.slot.tolist() == [*range(10), 20]
    assert [note.text for note in reduction.notes if note.what == "partial"] == [
        "1 blocks are left out in run r1: they hold less than 20% of the usual number of samples"
    ]
    assert run.n[-1] == 65
    assert run.value[-1] == pytest.approx(second.mean())
    # the median of some 290 squares of normal deviates: sd 0.14 of it
    assert run.white_variance[-1] * 65 == pytest.approx(1.0, rel=0.5)


@pytest.mark.long
def test_samples_that_are_no_numbers_are_left_out_and_counted(tested: TestedUnits) -> None:
    tested.run("r1")
    rate = np.random.default_rng(5).normal(10.0, 1.0, 6000)
    rate[450:750] = np.nan
    tested.samples("r1", "U1", "rate", rate, t0_ns=START_NS)
    reduction = reduced(tested)
    (run,) = reduction.runs
    assert run.n.tolist() == [300, 150, 150, *([300] * 17)]
    np.testing.assert_allclose(run.value[1], rate[300:450].mean())
    (note,) = [note for note in reduction.notes if note.what == "not_finite"]
    assert note.text == "300 samples are not finite in run r1: left out"


@pytest.mark.long
def test_runs_and_time_are_chosen(tested: TestedUnits) -> None:
    for run, t0_ns in (("r1", START_NS), ("r2", START_NS + 3600 * SECOND_NS)):
        tested.run(run, t_ns=t0_ns)
        tested.samples(run, "U1", "rate", np.arange(6000.0) % 5, t0_ns=t0_ns)
    assert [run.run for run in reduced(tested, runs=["r2"]).runs] == ["r2"]
    since = reduced(tested, since_ns=START_NS + 300 * SECOND_NS, until_ns=START_NS + 3700 * SECOND_NS)
    assert [(run.run, int(run.slot[0]), len(run)) for run in since.runs] == [("r1", 10, 10), ("r2", 0, 4)]
    with pytest.raises(NotFound, match="no run r9; it has r1, r2"):
        reduced(tested, runs=["r1", "r9"])
    with pytest.raises(NotFound, match="reaches from 2025-11-21T00:00:00Z to 2025-11-21T01:09:59Z"):
        reduced(tested, until_ns=START_NS - SECOND_NS)
    with pytest.raises(NotFound, match="unit 'U9' is not in"):
        reduced(tested, unit="U9")


@pytest.mark.parametrize("options", [{"block_s": 0.0}, {"block_s": np.nan}, {"tolerance_s": -1.0}])
def test_lengths_that_are_none_are_refused(tested: TestedUnits, options: dict[str, Any]) -> None:
    tested.run("r1")
    with pytest.raises(BadInput, match="give a positive number of seconds"):
        reduced(tested, **options)


@pytest.mark.long
def test_dropped_samples_leave_the_rollups(tmp_path: Path) -> None:
    tested = TestedUnits(tmp_path / "store")
    rng = np.random.default_rng(8)
    tested.run("r1")
    tested.power_on("r1", "U1", START_NS)
    rate = rng.normal(0.0, 1.0, 6000)
    tested.samples("r1", "U1", "rate", rate, t0_ns=START_NS)
    tested.samples("r1", "U1", "table_angle", np.arange(6000.0) % 360.0, t0_ns=START_NS, unit_of_measure="deg")
    before = reduced(tested).runs[0]
    tested.release()
    with builder_lock(tested.store):
        apply_rule(Lake(tested.store), Rule(older_than_s=0.0), now_ns=START_NS + 10**15)
    with Catalog(tested.store) as catalog:
        (after,) = BlockReducer(catalog, "rate").reduce("U1").runs
        with pytest.raises(BadInput, match=r"give blocks of whole seconds, not 7\.5 s"):
            BlockReducer(catalog, "rate", block_s=7.5).reduce("U1")
    np.testing.assert_array_equal(after.value, before.value)
    np.testing.assert_array_equal(after.white_variance, before.white_variance)
    assert np.isnan(after.mean("table_angle")).all()


def test_runs_in_units_that_do_not_go_together_are_refused(tested: TestedUnits) -> None:
    for run, unit in (("r1", "deg/s"), ("r2", "V")):
        tested.run(run)
        tested.samples(run, "U1", "rate", np.arange(600.0), t0_ns=START_NS, unit_of_measure=unit)
    with pytest.raises(BadInput, match="runs are in V and deg/h, which cannot be brought together"):
        reduced(tested)


@pytest.mark.long
def test_a_table_of_means_is_a_block_a_row(gyrofleet: Any, tmp_path: Path) -> None:
    """The published means of a hemispherical resonator gyro (HIT 2012 table 1): what the paper's model leaves."""
    table = Path(__file__).parents[2] / "golden" / "hit2012_table1.csv"
    assert gyrofleet("import", table, "--unit", "HRG", "--store", "store").code == 0
    with Catalog(Store.open(tmp_path / "store")) as catalog:
        reduction = BlockReducer(catalog, "rate", block_s=60.0).reduce("HRG")
    assert [(run.run, len(run), run.unit_of_measure) for run in reduction.runs] == [
        (f"speed-{speed}", 10, "V") for speed in (20, 30, 40)
    ]
    assert all(np.isnan(run.white_variance).all() for run in reduction.runs)
    assert "no_scatter" in {note.what for note in reduction.notes}
    paper = "rate = bias + table_rate + cross_axis_o + cross_axis_s + fixture_cos + fixture_sin"
    model = ErrorModel.parse(paper, reduction.runs[0].channels)
    assert rms_mv(reduction, model) == pytest.approx(0.8127, abs=1e-4)
    found = model.with_term("function_of_position").shaped(reduction.runs)
    assert rms_mv(reduction, found) == pytest.approx(0.1160, abs=1e-4)
    # alpha is 0, 90 or 180 deg only: sine, its square and the square of the cosine cannot be distinguished
    same = [
        rms_mv(reduction, model.with_term(each)) for each in ("gravity_s", "gravity_s_squared", "gravity_o_squared")
    ]
    np.testing.assert_allclose(same, 0.2550, atol=1e-4)


def rms_mv(reduction: Reduction, model: ErrorModel) -> float:
    """What least squares leaves, mV."""
    columns = np.concatenate([model.columns(run) for run in reduction.runs])
    value = np.concatenate([run.value for run in reduction.runs])
    columns = columns / np.abs(columns).max(axis=0)
    found = np.linalg.lstsq(columns, value, rcond=None)[0]
    return float(1e3 * np.sqrt(np.mean((value - columns @ found) ** 2)))


@pytest.mark.long
def test_measured_bursts_in_a_cold_chamber(gyrofleet: Any, tmp_path: Path, measured: Path) -> None:
    file = measured / "psim_cold_chamber.parquet"
    assert gyrofleet("import", file, "--unit", "PSIM", "--start", "2020-01-01T15:45:00Z", "--store", "s").code == 0
    with Catalog(Store.open(tmp_path / "s")) as catalog:
        (run,) = BlockReducer(catalog, "rate_x").reduce("PSIM").runs
    assert len(run) == 25  # bursts of 5 s
    assert int(run.n.sum()) >= 0.99 * 6250  # the edge of a block cuts a few
    assert run.channels["temperature"].unit_of_measure == "count"
    assert np.isfinite(run.mean("temperature")).all()
    assert np.isfinite(run.white_variance).all()


@pytest.mark.long
def test_blocks_shorter_than_the_interval_of_the_samples_are_told(tested: TestedUnits) -> None:
    tested.run("r1")
    values = np.random.default_rng(4).standard_normal(600)
    tested.samples("r1", "U1", "rate", values, t0_ns=START_NS, dt_ns=10**9)
    (reported,) = [limit for limit in reduced(tested, block_s=0.1).limits if "apart" in limit]
    assert "samples are up to 1 s apart" in reported
    assert "give blocks from 1 s on" in reported
    assert not any("apart" in limit for limit in reduced(tested, block_s=1.0).limits)
