"""Columns of effects from channels of which each block has one mean: changes within blocks, frozen references."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from analytics.loop.blocks.edge_slope import mean_slope_per_s
from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.effects.registry import effect
from stream.batch import FloatArray

BLOCK_S = 30.0
FINE = 300  # instants in a block


def of_means(**channels: FloatArray) -> RunBlocks:
    """A run whose channels have one reading in each block, the mean."""
    size = next(iter(channels.values())).size
    one = np.ones(size)
    measures = {"gravity_i": "g_0", "gravity_o": "g_0"}
    made = {name: Channel(mean, np.zeros(size), measures.get(name, "deg/s")) for name, mean in channels.items()}
    return RunBlocks("U", "r", "rate", np.arange(size), BLOCK_S, 0, one, np.ones(size, int), one, "deg/h", made)


@given(
    levels=st.lists(st.integers(-40, 40), min_size=2, max_size=8),
    within=st.lists(st.floats(0.01, 0.99), min_size=7, max_size=7),
)
def test_a_step_within_a_block_is_the_change_of_that_block_alone(levels: list[int], within: list[float]) -> None:
    apart = 5  # blocks between two steps
    fine = np.repeat(np.asarray(levels, float), apart * FINE)
    starts = [apart * number for number in range(1, len(levels))]
    for (before, after), block, share in zip(pairwise(levels), starts, within, strict=False):
        first = block * FINE
        fine[first : first + round(share * FINE)] = before
        fine[first + round(share * FINE) : first + FINE] = after
    expected = np.zeros(len(fine) // FINE)
    expected[starts] = np.diff(levels)
    mean = fine.reshape(-1, FINE).mean(axis=1)
    changes = mean_slope_per_s(of_means(input_rate=mean), "input_rate") * BLOCK_S
    np.testing.assert_allclose(changes, expected, atol=1e-9)


def test_a_steady_ramp_changes_alike_in_all_blocks() -> None:
    slope = mean_slope_per_s(of_means(input_rate=0.3 * np.arange(40.0)), "input_rate")
    np.testing.assert_allclose(slope, 0.3 / BLOCK_S)


def turned(*attitudes: tuple[float, float], blocks: int = 50) -> tuple[FloatArray, FloatArray]:
    """Gravity along input and output axis of a gyro that is turned on a table with a vertical axis."""
    each = np.repeat(np.asarray(attitudes), blocks, axis=0)
    return each[:, 0], each[:, 1]


def test_a_reference_frozen_in_another_attitude_follows_the_ratio_of_that_attitude() -> None:
    gravity_i, gravity_o = turned((1.0, 0.0), (0.0, 1.0), (1.0, 0.0), (-1.0, 0.0))
    table = np.tile([10.0, 10.0, -10.0, -10.0, 5.0], 40)
    true = table * gravity_i
    read = true.copy()
    read[60:90] = read[60]  # across the table's axis: the reading stands still, and so does the true rate
    read[104:144] = read[104]  # along it
    run = of_means(input_rate=read, table_rate=table, gravity_i=gravity_i, gravity_o=gravity_o)
    np.testing.assert_allclose(effect("stale_input_rate").regressors(run, {})[:, 0], read - true, atol=1e-9)


def test_without_gravity_channels_the_blocks_beside_the_gap_give_the_ratio() -> None:
    table = np.tile([10.0, -10.0, 5.0], 50)
    read = 0.6 * table
    read[60:90] = read[60]
    column = effect("stale_input_rate").regressors(of_means(input_rate=read, table_rate=table), {})[:, 0]
    np.testing.assert_allclose(column, read - 0.6 * table, atol=1e-9)


def test_an_attitude_never_seen_with_a_live_reference_gives_no_error() -> None:
    gravity_i, gravity_o = turned((1.0, 0.0), (0.0, 1.0), (1.0, 0.0))
    table = np.tile([10.0, -10.0, 5.0], 50)
    read = table * gravity_i
    read[50:100] = 3.0
    run = of_means(input_rate=read, table_rate=table, gravity_i=gravity_i, gravity_o=gravity_o)
    assert not effect("stale_input_rate").regressors(run, {}).any()


def test_the_noise_of_a_table_at_rest_gives_no_ratio() -> None:
    rng = np.random.default_rng(1)
    table = 1e-7 * rng.standard_normal(200)
    table[90:100] = 4.0  # turned across the input axis, which reads exact zeros at rest as well
    read = 1e-7 * rng.standard_normal(200)
    read[60:130] = 0.0
    run = of_means(input_rate=read, table_rate=table, gravity_i=np.zeros(200), gravity_o=np.ones(200))
    assert np.abs(effect("stale_input_rate").regressors(run, {})).max() < 1e-6


def test_beside_gaps_a_slope_is_none_or_not_known() -> None:
    one = np.ones(4)
    rate = Channel(np.array([0.0, 3.0, 9.0, 12.0]), 0 * one, "deg/s")
    slots = np.array([0, 1, 9, 17])
    run = RunBlocks("U", "r", "rate", slots, BLOCK_S, 0, one, np.ones(4, int), one, "deg/h", {"table_rate": rate})
    across = mean_slope_per_s(run, "table_rate") * BLOCK_S
    beside = mean_slope_per_s(run, "table_rate", across_gaps=False) * BLOCK_S
    assert across[2] == 0.0  # what it did in the blocks that are missing says nothing of this one
    assert np.isnan(beside).tolist() == [False, False, True, True]
    np.testing.assert_array_equal(beside[:2], across[:2])
