"""One run alone, short and in bursts: a slow effect is reported, its kind is not; a random walk is no effect."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.loop.blocks.block_reducer import BlockReducer
from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.case import FEWEST_BLOCKS_TO_SPLIT
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import FloatArray

HIT_2012 = Path(__file__).parents[2] / "golden" / "hit2012_table1.csv"
PAPER = "rate = bias + table_rate + cross_axis_o + cross_axis_s + fixture_cos + fixture_sin"


def one_run(error: FloatArray, step: int, block_s: float = 30.0) -> RunBlocks:
    """A cooling unit at rest, one block in every `step`, without a declared noise."""
    size = error.size
    slot = np.arange(size) * step
    since_s = np.asarray((slot + 0.5) * block_s, dtype=np.float64)
    temperature = np.asarray(20.0 + 40.0 * np.expm1(-since_s / 9000.0))
    channels = {
        "temperature": Channel(temperature, np.full(size, 0.01), "degC"),
        "time_since_power_on": Channel(since_s, np.full(size, block_s / 12.0**0.5), "s"),
    }
    n, unknown = np.full(size, 250), np.full(size, np.nan)
    return RunBlocks("U", "cold", "rate", slot, block_s, 0, error, n, unknown, "deg/h", channels)


def reported(error: FloatArray, step: int, model: str) -> Diagnosis:
    return diagnose([one_run(error, step)], ErrorModel.parse(model))


def test_a_short_run_with_a_transient_is_confounded() -> None:
    """25 bursts, 5 min apart; a transient of 30 deg/h in a scatter of 4: there it is, but what it is nobody can tell.

    Every kind of thermal transient that was tried and has some evidence is named, with the test that would separate it.
    """
    rng = np.random.default_rng(3)
    since_s = np.arange(25) * 300.0
    error = 30.0 * np.exp(-since_s / 1500.0) + rng.normal(0.0, 4.0, 25)
    found = reported(error, 10, "rate = bias + temperature")
    named = {*found.names, *(each.name for each in found.confounded)}
    assert found.verdict is ModelVerdict.CONFOUNDED
    assert found.replication == "within_run"
    assert len(named & {"warm_up", "thermal_lag", "temperature_rate", "temperature_squared"}) >= 3
    assert all(each.separating_test for each in found.confounded)
    assert any("no held-out set: one run of 25 blocks" in limit for limit in found.limits)
    assert FEWEST_BLOCKS_TO_SPLIT > 25


@pytest.mark.parametrize("seed", range(6))
def test_a_short_run_without_an_effect_has_none(seed: int) -> None:
    """The family-wise chance is 1 % for the library and lines and jumps are not looked for in 25 blocks."""
    rng = np.random.default_rng((5, seed))
    found = reported(rng.normal(0.0, 4.0, 25), 10, "rate = bias + temperature")
    assert found.verdict is ModelVerdict.NOTHING_MISSING


@pytest.mark.parametrize("seed", range(3))
def test_a_long_run_tells_a_random_walk_by_itself(seed: int) -> None:
    """1000 blocks with a walk of 20 times what is supposed of a short run: the trace abstains and fits the walk."""
    rng = np.random.default_rng((7, seed))
    per_block = 0.3 * 4.0
    error = rng.normal(0.0, 4.0, 1000) + np.cumsum(rng.normal(0.0, per_block, 1000))
    found = reported(error, 1, "rate = bias")
    assert not [each for each in found.effects if each.name != "jump"]
    assert found.noise is not None
    assert pytest.approx(per_block / np.sqrt(30.0 / 3600.0), rel=0.3) == found.noise.K


@pytest.mark.long
def test_a_bias_of_each_mounting_is_named_beside_gravity(gyrofleet: Any, tmp_path: Path) -> None:
    """Each position of the table was mounted once: gravity, its square, and the mounting itself are all named."""
    assert gyrofleet("import", HIT_2012, "--unit", "HRG", "--store", "store").code == 0
    with Catalog(Store.open(tmp_path / "store")) as catalog:
        runs = BlockReducer(catalog, "rate", block_s=60.0).reduce("HRG").runs
    found = diagnose(runs, ErrorModel.parse(PAPER, runs[0].channels).shaped(runs))
    named = {*found.names, *(each.name for each in found.confounded)}
    assert found.verdict is ModelVerdict.CONFOUNDED
    assert named >= {"function_of_position", "gravity_s", "gravity_s_squared", "gravity_o_squared"}
    assert found.holdout is not None
    assert found.holdout.accepted
    assert found.error is not None
    row = found.error.rows[0]
    assert row.before == pytest.approx(0.82e-3, rel=0.05)  # V
    assert row.after < 0.3e-3


@pytest.mark.long
@pytest.mark.measured
def test_a_measured_transient_in_a_cold_chamber_is_confounded(gyrofleet: Any, tmp_path: Path, measured: Path) -> None:
    file = measured / "psim_cold_chamber.parquet"
    assert gyrofleet("import", file, "--unit", "PSIM", "--store", "store").code == 0
    with Catalog(Store.open(tmp_path / "store")) as catalog:
        runs = BlockReducer(catalog, "rate_x", block_s=30.0).reduce("PSIM").runs
    found = diagnose(runs, ErrorModel.parse("rate_x = bias + temperature"))
    assert found.verdict is ModelVerdict.CONFOUNDED
    named = {*found.names, *(each.name for each in found.confounded)}
    assert len(named & {"temperature_rate", "thermal_lag", "warm_up", "temperature_squared"}) >= 3
