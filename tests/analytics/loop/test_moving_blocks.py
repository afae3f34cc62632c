"""Blocks in which a channel moves: means of curved functions are those of its samples, not of a normal scatter."""

from collections.abc import Callable

import numpy as np
import pytest

from analytics.loop.blocks.block_reducer import BlockReducer
from analytics.loop.blocks.edge_slope import mean_slope_per_s
from analytics.loop.blocks.inside import Inside, inside_of
from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.effects.base import range_over
from analytics.loop.effects.block_kernels import mean_excess, mean_inside, mean_magnitude, share_above
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.diagnosis import diagnose
from stream.batch import FloatArray
from tests.analytics.conftest import START_NS, TestedUnits

SETTLE_S, DWELL_S = 1.5, 410  # of a table; steps and blocks of 30 s do not fall together
LEVELS = (20.0, -20.0, 60.0, -60.0, 100.0, -100.0)
FORMS: dict[str, tuple[Callable[[Channel], FloatArray], Callable[[FloatArray], FloatArray]]] = {
    "magnitude": (mean_magnitude, np.abs),
    "excess": (lambda rate: mean_excess(rate, 90.0), lambda x: np.maximum(x - 90.0, 0.0)),
    "inside": (lambda rate: mean_inside(rate, 30.0), lambda x: np.where(np.abs(x) < 30.0, x, 0.0)),
    "share": (lambda rate: share_above(rate, 10.0), lambda x: (x > 10.0).astype(np.float64)),
}


def settling(seed: int) -> FloatArray:
    """Rates of a table each second, deg/s; each is reached as by a first-order lag."""
    commanded = np.repeat(np.random.default_rng(seed).permutation(LEVELS), DWELL_S)
    rate, share = np.empty_like(commanded), 1.0 - np.exp(-1.0 / SETTLE_S)
    now = 0.0
    for at, wanted in enumerate(commanded):
        now += share * (wanted - now)
        rate[at] = now
    return rate


def filled(tested: TestedUnits, error: Callable[[FloatArray], FloatArray], runs: int = 6) -> list[FloatArray]:
    """Runs of a unit with an error in its rate, deg/h; the true rates."""
    rng, rates = np.random.default_rng(1), []
    for number in range(runs):
        name, start_ns = f"r{number}", START_NS + number * 86_400 * 10**9
        rate = settling(number)
        tested.run(name, t_ns=start_ns)
        output = 3600.0 * rate + error(rate) + rng.normal(0.0, 0.5, rate.size)
        tested.samples(name, "U1", "input_rate", rate, unit_of_measure="deg/s", t0_ns=start_ns, dt_ns=10**9)
        tested.samples(name, "U1", "rate", output, t0_ns=start_ns, dt_ns=10**9)
        rates.append(rate)
    return rates


def of_samples(run: RunBlocks, rate: FloatArray, form: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Means over the blocks of a run of a function of each sample."""
    number = np.arange(rate.size) // round(run.block_s)
    means = np.bincount(number, form(rate)) / np.bincount(number)
    return np.asarray(means[run.slot])


@pytest.mark.parametrize("form", FORMS)
def test_means_over_blocks_are_those_of_the_samples(tested: TestedUnits, form: str) -> None:
    of_channel, of_sample = FORMS[form]
    (rate,) = filled(tested, np.zeros_like, runs=1)
    with tested.catalog() as catalog:
        (run,) = BlockReducer(catalog, "rate").reduce("U1").runs
    channel = run.channels["input_rate"]
    assert channel.inside is not None
    assert len(set(channel.inside.row.tolist())) >= len(LEVELS) - 1
    np.testing.assert_allclose(of_channel(channel), of_samples(run, rate, of_sample), rtol=0, atol=1e-6)


def test_those_of_some_blocks_are_the_same(tested: TestedUnits) -> None:
    (rate,) = filled(tested, np.zeros_like, runs=1)
    with tested.catalog() as catalog:
        (run,) = BlockReducer(catalog, "rate").reduce("U1").runs
    for rows in (slice(7, 60), np.arange(len(run)) % 3 == 0):
        part = run.part(rows)
        expected = of_samples(part, rate, np.abs)
        np.testing.assert_allclose(mean_magnitude(part.channels["input_rate"]), expected, rtol=0, atol=1e-6)


def test_a_cube_and_splines_go_by_the_samples_as_well(tested: TestedUnits) -> None:
    (rate,) = filled(tested, np.zeros_like, runs=1)
    with tested.catalog() as catalog:
        (run,) = BlockReducer(catalog, "rate").reduce("U1").runs
    cubic = effect("scale_factor_cubic").regressors(run, {})[:, 0]
    np.testing.assert_allclose(cubic, of_samples(run, rate, lambda x: x**3), rtol=1e-9, atol=1e-6)
    function = effect("function_of_input_rate")
    (shape,) = function.shapes([run])
    hats = function.regressors(run, shape)
    heights = np.arange(1.0, hats.shape[1] + 1.0)
    exact = of_samples(run, rate, lambda x: function.simulate(x, {"input_rate": x}, heights.tolist(), shape))
    np.testing.assert_allclose(hats @ heights, exact, rtol=0, atol=1e-6)


def test_a_saturated_output_on_a_table_that_settles_is_one_effect(tested: TestedUnits) -> None:
    """The blocks of its edges had given two more effects, "confirmed", and a coefficient off by a multiple of its U."""
    filled(tested, lambda rate: 3600.0 * (np.clip(rate, -90.0, 90.0) - rate))
    with tested.catalog() as catalog:
        runs = BlockReducer(catalog, "rate").reduce("U1").runs
    (found,) = diagnose(runs, ErrorModel.parse("bias + scale_factor*input_rate")).effects
    (coefficient,) = found.coefficients
    assert (found.name, found.parameters["limit"]) == ("saturation", pytest.approx(90.0, rel=1e-3))
    assert coefficient.lo <= -3600.0 <= coefficient.hi
    assert coefficient.hi - coefficient.lo < 10.0, "0.3 %: only one rate is beyond the limit, which is not known either"
    low, high = found.parameter_bounds["limit"]
    assert low <= 90.0 <= high
    assert high - low < 0.03


@pytest.mark.in_gate("0")
@pytest.mark.parametrize("seed", range(4))
def test_an_asymmetry_is_no_unknown_function(tested: TestedUnits, seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    filled(tested, lambda rate: 0.108 * np.abs(rate) + np.cumsum(rng.normal(0.0, 0.003, rate.size)))
    with tested.catalog() as catalog:
        runs = BlockReducer(catalog, "rate").reduce("U1").runs
    diagnosis = diagnose(runs, ErrorModel.parse("bias + scale_factor*input_rate"))
    assert [each.name for each in diagnosis.effects] == ["scale_factor_asymmetry"]
    (coefficient,) = diagnosis.effects[0].coefficients
    # of four intervals of 95 %
    assert abs(coefficient.value - 0.108) < 3.0 * (coefficient.hi - coefficient.lo) / 3.92 + 1e-4


def test_the_motion_of_a_table_is_no_periodic_line(tested: TestedUnits) -> None:
    """It was a line of 51,000 deg/h, taken from the scale factor: 2,000 of 3,600 deg/h/(deg/s) were left of it."""
    rng = np.random.default_rng(5)
    for number, amplitude in enumerate((20.0, 30.0, 40.0, 50.0)):
        name, start_ns = f"r{number}", START_NS + number * 86_400 * 10**9
        rate = amplitude * np.sin(2 * np.pi * 0.05 * 0.1 * np.arange(12_000))
        output = 3600.0 * rate + 0.36 * np.abs(rate) + 20.0 + rng.normal(0.0, 5.0, rate.size)
        tested.run(name, t_ns=start_ns)
        tested.samples(name, "U1", "input_rate", rate, unit_of_measure="deg/s", t0_ns=start_ns)
        tested.samples(name, "U1", "rate", output, t0_ns=start_ns)
    with tested.catalog() as catalog:
        runs = BlockReducer(catalog, "rate", block_s=2.0).reduce("U1").runs
    found = diagnose(runs, ErrorModel.parse("bias + scale_factor*input_rate"))
    assert [each.name for each in found.effects] == ["scale_factor_asymmetry"]
    (coefficient,) = found.effects[0].coefficients
    assert coefficient.lo <= 0.36 <= coefficient.hi


@pytest.mark.parametrize("swings", [False, True])
def test_an_asymmetry_is_right_where_every_block_moves(tested: TestedUnits, *, swings: bool) -> None:
    """Of dwells shorter than a block 0.03 of 0.1 were found, and a square; of a swinging table 1.13 times as much."""
    rng = np.random.default_rng(3)
    for number in range(6):
        name, start_ns = f"r{number}", START_NS + number * 86_400 * 10**9
        seconds = np.arange(2400)
        rate = np.repeat(rng.choice(LEVELS, 120), 20)
        if swings:
            rate = np.repeat(rng.uniform(20.0, 80.0, 4), 600) * np.sin(2 * np.pi * 0.03 * seconds)
        output = 3600.0 * rate + 0.36 * np.abs(rate) + rng.normal(0.0, 2.0, rate.size)
        tested.run(name, t_ns=start_ns)
        tested.samples(name, "U1", "input_rate", rate, unit_of_measure="deg/s", t0_ns=start_ns, dt_ns=10**9)
        tested.samples(name, "U1", "rate", output, t0_ns=start_ns, dt_ns=10**9)
    with tested.catalog() as catalog:
        runs = BlockReducer(catalog, "rate").reduce("U1").runs
    found = diagnose(runs, ErrorModel.parse("bias + scale_factor*input_rate"))
    assert [each.name for each in found.effects] == ["scale_factor_asymmetry"]
    (coefficient,) = found.effects[0].coefficients
    assert abs(coefficient.value - 0.36) < 3.0 * (coefficient.hi - coefficient.lo) / 3.92


def test_the_range_of_a_rate_goes_by_the_seconds_that_are_known() -> None:
    """Where steps do not name the axis of a table the rate is not known, nor are its seconds."""
    number = np.repeat(np.arange(8), 30)
    value = np.repeat(np.tile([-100.0, 100.0], 8), 15)
    blocks = (np.zeros(8), np.full(8, 100.0), np.zeros(8, np.bool_))
    inside = inside_of(number, np.ones(240, int), value, np.zeros(240), blocks)
    assert inside is not None
    along = np.array([1.0, np.nan] * 4)
    rate = Channel(np.zeros(8) * along, np.full(8, 100.0), "deg/s", inside=inside.scaled(along))
    one = np.ones(8)
    run = RunBlocks("U", "r", "rate", np.arange(8), 30.0, 0, one, one.astype(int), one, "deg/h", {"input_rate": rate})
    assert range_over("input_rate", [run]) == (-100.0, 100.0)


def test_only_blocks_that_move_far_more_than_the_others_have_pieces() -> None:
    number = np.repeat(np.arange(8), 30)
    quiet = np.random.default_rng(2).normal(0.0, 1.0, number.size)
    ones, none = np.ones(number.size, int), np.zeros(number.size)

    def found(value: FloatArray, far: int | None = None) -> Inside | None:
        mean = np.array([value[number == each].mean() for each in range(8)])
        spread = np.array([value[number == each].std() for each in range(8)])
        return inside_of(number, ones, value, none, (mean, spread, np.arange(8) == far))

    assert found(quiet) is None
    stepped = quiet + 100.0 * (np.arange(number.size) > 100)  # within block 3
    inside = found(stepped)
    assert inside is not None
    assert set(inside.row.tolist()) == {3}
    assert found(stepped, far=3) is None, "an outlier is no motion"
    swinging = found(100.0 * np.sin(np.arange(number.size)))  # as wide in every block
    assert swinging is not None
    assert set(swinging.row.tolist()) == set(range(8))


def swinging(tested: TestedUnits, frequency_hz: float, delay_s: float = 0.0, runs: int = 4) -> None:
    """Runs of 600 s on a table that swings, of a gyro at 100 Hz and a table rate at 10 Hz."""
    rng = np.random.default_rng(7)
    gyro_s, table_s = 0.01 * np.arange(60_000), 0.1 * np.arange(6000)
    for number in range(runs):
        name, start_ns = f"r{number}", START_NS + number * 86_400 * 10**9
        turning = 2 * np.pi * frequency_hz * (1.0 + 0.013 * number)
        output = 3600.0 * 40.0 * np.sin(turning * (gyro_s - delay_s) + number) + rng.normal(0.0, 200.0, gyro_s.size)
        rate = 40.0 * np.sin(turning * table_s + number)
        tested.run(name, t_ns=start_ns)
        tested.samples(name, "U1", "input_rate", rate, unit_of_measure="deg/s", t0_ns=start_ns)
        tested.samples(name, "U1", "rate", output, t0_ns=start_ns, dt_ns=10**7)


@pytest.mark.parametrize(("frequency_hz", "lost"), [(0.1, 0), (0.2, 4)])
def test_means_of_two_sample_rates_are_of_one_time(tested: TestedUnits, frequency_hz: float, lost: int) -> None:
    """The samples of a second at 10 Hz are 0.045 s earlier than those at 100 Hz: 5,000 deg/h on this table."""
    swinging(tested, frequency_hz, runs=1)
    with tested.catalog() as catalog:
        reduction = BlockReducer(catalog, "rate", block_s=2.0).reduce("U1")
    (run,) = reduction.runs
    (note,) = [each for each in reduction.notes if each.what == "two_rates"]
    assert note.text in reduction.limits
    assert "every 0.1 s, the signal every 0.01 s" in note.text
    assert "less than 0.0001 s" in note.text
    assert "--block" not in note.text
    at_gyro = 40.0 * np.sin(2 * np.pi * frequency_hz * 0.01 * np.arange(60_000)).reshape(-1, 200).mean(axis=1)
    off = run.mean("input_rate") - at_gyro
    assert int(np.isnan(off).sum()) == lost, "how fast swings go on beyond the record is not known"
    assert float(np.nanmax(np.abs(off))) < 0.01 * 40.0 * 2 * np.pi * frequency_hz * 0.045
    edges_s = np.arange(0.0, 601.0, 2.0) - 0.005  # between the samples
    exact = np.diff(40.0 * np.sin(2 * np.pi * frequency_hz * edges_s)) / 2.0
    changes = mean_slope_per_s(run, "input_rate")[5:-5]
    np.testing.assert_allclose(changes, exact[5:-5], rtol=0, atol=0.01 * np.abs(exact).max())


@pytest.mark.parametrize(("delay_s", "names"), [(0.0, []), (0.1, ["rate_time_offset"])])
def test_a_delay_is_that_of_the_gyro_and_not_of_two_sample_rates(
    tested: TestedUnits, delay_s: float, names: list[str]
) -> None:
    """A time offset of 0.04 s had been "confirmed" without any, and one of 0.05 s in place of 0.1 s."""
    swinging(tested, 0.1, delay_s)
    with tested.catalog() as catalog:
        runs = BlockReducer(catalog, "rate", block_s=2.0).reduce("U1").runs
    found = diagnose(runs, ErrorModel.parse("bias + scale_factor*input_rate")).effects
    assert [each.name for each in found] == names
    for each in found:
        assert each.coefficients[0].value == pytest.approx(-3600.0 * delay_s, rel=0.005)


def test_a_ramp_that_begins_with_a_block_does_not_reach_into_the_one_before(tested: TestedUnits) -> None:
    """A polynomial through the bend had put 24 deg/h into the block of constant rate before it."""
    table_s = np.arange(0.0, 900.0)
    rate = np.interp(table_s, [150.0, 155.0, 450.0, 455.0, 600.0, 605.0], [0.0, 10.0, 10.0, -30.0, -30.0, 60.0])
    rate += np.random.default_rng(4).normal(0.0, 1e-5, rate.size)
    tested.run("r1")
    tested.samples("r1", "U1", "table_rate", rate, unit_of_measure="deg/s", t0_ns=START_NS, dt_ns=10**9)
    tested.samples("r1", "U1", "rate", np.zeros(18_000), t0_ns=START_NS, dt_ns=50_000_000)
    with tested.catalog() as catalog:
        (run,) = BlockReducer(catalog, "rate").reduce("U1").runs
    constant = ~np.isin(run.slot, [5, 15, 20])
    commanded = np.repeat([0.0, 10.0, -30.0, 60.0], [5, 10, 5, 10])[run.slot]
    np.testing.assert_allclose(run.mean("table_rate")[constant], commanded[constant], rtol=0, atol=1e-5)


def test_blocks_too_long_for_the_rates_name_those_that_fit(tested: TestedUnits) -> None:
    """Of rates held for a minute 81 % of the blocks of 30 s were left out, with "more readings keep more"."""
    rng = np.random.default_rng(6)
    rate = np.repeat(rng.choice(LEVELS, 20), 60)
    tested.run("r1")
    tested.samples("r1", "U1", "input_rate", rate, unit_of_measure="deg/s", t0_ns=START_NS, dt_ns=10**9)
    output = 3600.0 * np.roll(np.repeat(rate, 10), 3) + rng.normal(0.0, 30.0, 12_000)
    tested.samples("r1", "U1", "rate", output, t0_ns=START_NS)
    kept = {}
    for block_s in (30.0, 5.0):
        with tested.catalog() as catalog:
            found = BlockReducer(catalog, "rate", block_s=block_s).reduce("U1")
        kept[block_s] = sum(map(len, found.runs)) * block_s / 1200.0
        (note,) = [each for each in found.notes if each.what == "unresolved"]
        assert ("--block 5s keeps more" in note.text) is (block_s == 30.0)
    assert kept[30.0] < 0.25
    assert kept[5.0] > 0.75
