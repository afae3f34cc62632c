"""A rate reference that is read once or twice a second beside a gyro at 20 Hz: what it resolves, and what it cannot."""

import numpy as np
import pytest

from analytics.loop.blocks.block_reducer import BlockReducer, Reduction
from analytics.loop.blocks.edge_slope import mean_slope_per_s
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import ModelVerdict
from stream.batch import FloatArray
from tests.analytics.conftest import START_NS, TestedUnits

MODEL = ErrorModel.parse("bias + scale_factor*input_rate")
GYRO_S, NOISE = 0.05, 2.0  # s, deg/h of a sample
DURATION_S = 1200


def filled(
    tested: TestedUnits, knots: tuple[FloatArray, FloatArray], reference_s: float = 1.0, runs: int = 1
) -> FloatArray:
    """A table whose rate is linear between knots (s, deg/s); the gyro's rate at its samples, each a mean about it."""
    rng = np.random.default_rng(1)
    fine_s = np.arange(-GYRO_S / 2, DURATION_S, 0.001)
    turned = np.concatenate([[0.0], np.cumsum(np.interp(fine_s[:-1] + 0.0005, *knots) * 0.001)])
    time_s, half_s = np.arange(0.0, DURATION_S, GYRO_S), GYRO_S / 2
    at_gyro = (np.interp(time_s + half_s, fine_s, turned) - np.interp(time_s - half_s, fine_s, turned)) / GYRO_S
    read_s = np.arange(0.0, DURATION_S, reference_s)
    stored(tested, at_gyro, np.interp(read_s, *knots) + rng.normal(0.0, 1e-5, read_s.size), reference_s, runs)
    return np.asarray(at_gyro)


def stored(tested: TestedUnits, gyro: FloatArray, reference: FloatArray, reference_s: float, number: int) -> None:
    rng, start_ns = np.random.default_rng(number), START_NS + number * 86_400 * 10**9
    name, dt_ns = f"r{number}", round(reference_s * 1e9)
    output = 3600.0 * gyro + rng.normal(0.0, NOISE, gyro.size)
    tested.run(name, t_ns=start_ns)
    tested.samples(name, "U1", "input_rate", reference, unit_of_measure="deg/s", t0_ns=start_ns, dt_ns=dt_ns)
    tested.samples(name, "U1", "rate", output, t0_ns=start_ns, dt_ns=round(GYRO_S * 1e9))


def swinging(tested: TestedUnits, reference_s: float, delay_s: float = 0.0, runs: int = 4) -> None:
    """Runs on a table that swings at 0.05 Hz."""
    gyro_s, read_s = np.arange(0.0, DURATION_S, GYRO_S), np.arange(0.0, DURATION_S, reference_s)
    for number in range(runs):
        turning = 2 * np.pi * 0.05 * (1.0 + 0.013 * number)
        of_gyro, of_table = (40.0 * np.sin(turning * each + number) for each in (gyro_s - delay_s, read_s))
        stored(tested, of_gyro, of_table, reference_s, number)


def reduced(tested: TestedUnits, block_s: float = 30.0) -> Reduction:
    with tested.catalog() as catalog:
        return BlockReducer(catalog, "rate", block_s=block_s).reduce("U1")


def missed(run: RunBlocks, at_gyro: FloatArray) -> FloatArray:
    """Error of the reference's means, deg/h."""
    samples = round(run.block_s / GYRO_S)
    return np.asarray(3600.0 * (run.mean("input_rate") - at_gyro.reshape(-1, samples).mean(axis=1)[run.slot]))


@pytest.mark.parametrize(("reference_s", "block_s"), [(1.0, 30.0), (1.0, 2.0), (2.0, 2.0)])
def test_means_of_a_swing_are_of_the_gyros_times(tested: TestedUnits, reference_s: float, block_s: float) -> None:
    """They were 4 ms early by blocks of 30 s, and a tenth of a true delay was lost in blocks of 2 s."""
    swinging(tested, reference_s, runs=1)
    (run,) = reduced(tested, block_s).runs
    at_gyro = 40.0 * np.sin(2 * np.pi * 0.05 * np.arange(0.0, DURATION_S, GYRO_S))
    slope, off = mean_slope_per_s(run, "input_rate"), missed(run, at_gyro) / 3600.0
    known = np.isfinite(slope + off)
    assert known.all()
    delay_s = float(slope @ off) / float(slope @ slope)
    assert abs(delay_s) < 3e-4


@pytest.mark.parametrize("reference_s", [1.0, 0.5])
def test_no_edge_of_a_table_that_steps_in_most_blocks_is_kept(tested: TestedUnits, reference_s: float) -> None:
    """The scatter that the edges give was taken for noise: 700 deg/h beside 0.2 were left."""
    begins_s = 17.3 + 41.7 * np.arange(28)
    rates = np.random.default_rng(2).choice([-60.0, -20.0, 20.0, 60.0, 90.0], begins_s.size)
    before = np.append(0.0, rates[:-1])
    knots_s = np.column_stack([begins_s, begins_s + 1e-3 + np.abs(rates - before) / 50.0]).ravel()
    at_gyro = filled(tested, (knots_s, np.column_stack([before, rates]).ravel()), reference_s)
    reduction = reduced(tested)
    kept = len(reduction.runs[0])
    assert 5 <= kept < 20
    assert np.abs(missed(reduction.runs[0], at_gyro)).max() < 1.0
    assert "unresolved" in {each.what for each in reduction.notes}


@pytest.mark.parametrize("reference_s", [1.0, 0.5])
def test_ramps_are_resolved_and_their_ends_are_not(tested: TestedUnits, reference_s: float) -> None:
    """On a table that is never at one rate, 100 deg/h were left at the ends of ramps."""
    knots_s = np.array([-1.0, 74.6, 161.7, 256.2, 370.4, 484.1, 607.9, 731.3, 842.8, 955.5, 1066.2, 1201.0])
    rates = np.array([0.0, 70.0, -50.0, 60.0, -30.0, 80.0, -60.0, 40.0, -70.0, 50.0, -40.0, 60.0])
    at_gyro = filled(tested, (knots_s, rates), reference_s)
    (run,) = reduced(tested).runs
    ends = np.isin(np.arange(40), (knots_s[1:-1] // 30.0).astype(int))
    assert set(np.flatnonzero(~ends)) == set(run.slot.tolist())
    assert np.abs(missed(run, at_gyro)).max() < 1.0


def test_a_short_ramp_does_not_reach_into_the_next_block(tested: TestedUnits) -> None:
    """A polynomial through a ramp of two seconds had put 80 deg/h into the block of constant rate after it."""
    knots_s = np.array([0.0, 296.45, 298.45, 896.2, 898.3, 1200.0])
    at_gyro = filled(tested, (knots_s, np.array([90.0, 90.0, -10.0, -10.0, 60.0, 60.0])))
    (run,) = reduced(tested).runs
    assert {10, 30} <= set(run.slot.tolist()), "the blocks after the ramps"
    assert np.abs(missed(run, at_gyro)).max() < 1.0


@pytest.mark.parametrize("delay_s", [pytest.param(0.0, marks=pytest.mark.long), 1e-4, 0.02])
def test_a_delay_that_two_rates_cannot_tell_is_not_confirmed(tested: TestedUnits, delay_s: float) -> None:
    """A delay of 4 ms was confirmed without any."""
    swinging(tested, 1.0, delay_s)
    reduction = reduced(tested, block_s=5.0)
    found = diagnose(reduction.runs, MODEL)
    assert [each.text for each in reduction.notes if "less than 0.001 s" in each.text]
    named = {each.name: each for each in found.effects if each.name != "turn_on"}
    if delay_s > 0.01:
        assert found.verdict is ModelVerdict.EFFECT_FOUND
        assert set(named) == {"rate_time_offset"}
    assert not named or set(named) <= {"rate_time_offset", "rate_clock_rate", "angular_acceleration"}
    for each in named.values():
        assert each.confirmed is (True if delay_s > 0.01 else None)
        (coefficient,) = each.coefficients
        assert coefficient.lo <= -3600.0 * delay_s <= coefficient.hi
        assert coefficient.hi - coefficient.lo >= 2 * 3.6, "what the two rates cannot tell"
    if delay_s == 1e-4:
        assert found.verdict is ModelVerdict.UNREPLICATED
        assert any("is not confirmed" in each for each in found.limits)


def test_of_a_swing_that_is_read_less_than_once_a_block_no_line_is_found(tested: TestedUnits) -> None:
    """Straight lines between its readings left "periodic line: amplitude 8,504 deg/h", confirmed."""
    read_s = np.arange(0.0, DURATION_S, 60.0)
    for number in range(4):
        gyro, reference = (
            30.0 * np.sin(2 * np.pi * s / 250.0 + number) for s in (np.arange(0.0, DURATION_S, GYRO_S), read_s)
        )
        stored(tested, gyro, reference, 60.0, number)
    reduction = reduced(tested)
    assert sum(map(len, reduction.runs)) < 20
    found = diagnose(reduction.runs, MODEL)
    assert (found.verdict, found.effects) == (ModelVerdict.NOT_ENOUGH_DATA, ())
    assert [each.text for each in reduction.notes if "have no reading each, and are left out" in each.text]
    assert [each.text for each in reduction.notes if "record it more often than once in 60 s" in each.text]


def test_at_one_rate_nothing_is_lost_and_a_saturation_is_named(tested: TestedUnits) -> None:
    """A hard limit at 40 deg/s on a table that always moves: "not in the form of any effect of the library"."""
    rng, read_s = np.random.default_rng(5), np.arange(0.0, DURATION_S, GYRO_S)
    for number in range(4):
        knots_s = np.cumsum(rng.uniform(50.0, 110.0, 30)) - 60.0
        rate = np.interp(read_s, knots_s, rng.uniform(35.0, 80.0, 30) * np.tile([-1.0, 1.0], 15))
        stored(tested, np.clip(rate, -40.0, 40.0), rate, GYRO_S, number)
    reduction = reduced(tested)
    assert sum(map(len, reduction.runs)) == 4 * DURATION_S / 30
    (found,) = [each for each in diagnose(reduction.runs, MODEL).effects if each.name != "turn_on"]
    (coefficient,) = found.coefficients
    assert (found.name, found.confounded, found.unknown_function_of) == ("saturation", (), ())
    low, high = found.parameter_bounds["limit"]
    assert low <= 40.0 <= high
    assert high - low < 0.2
    assert found.document()["parameter_bounds"] == {"limit": [low, high]}
    assert coefficient.lo <= -3600.0 <= coefficient.hi
