"""Laws that every effect keeps; a new one in the package is found by itself and compared with them.

Each is planted by its own simulator in a short campaign of all types of test and found again by its own columns. The
bounds come from the significance at which it is planted (z standard errors) and from how far a block's mean of the
simulated effect is from what the columns say of it, which is bounded itself.
"""

import json
import re
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
import pytest

from analytics.loop.blocks.run_blocks import Channel
from analytics.loop.effects.base import Effect, EffectKind, Role, coefficient_unit, parameter_unit
from analytics.loop.effects.registry import effect, effects, effects_for, unavailable_effects
from stream.errors import BadInput
from stream.quantities import check_unit
from tests.bench.loop_campaign import Planted
from tests.laws.planted_effects import (
    ALL_CHANNELS,
    beside,
    campaign,
    clean,
    columns_of,
    direction_of,
    ramp,
    recorded,
    shape_of,
    shapes_of,
    simulated,
    stacked,
    without_blocks,
    without_channel,
)

NAMES = tuple(effects())
EVERY = pytest.mark.parametrize("name", NAMES)
GRID = tuple(name for name in NAMES if len(effects()[name].parameters) == 1 and effects()[name].parameters[0].grid)
Z = 25.0
# Share of an effect that its columns miss, at most: instants of two seconds, the noise of sensors (0.3 % of what a
# channel does), a curve taken as straight over 30 s.
MISSED = 0.06
# Where rate or level step within a block, of which only mean and spread are known, more is missed; a threshold is
# missed in the blocks that cross it, and what a frozen sensor has not seen is guessed.
MISSED_BY = MappingProxyType(
    {
        "dead_zone": 0.45,
        "function_of_input_rate": 0.35,
        "function_of_vibration": 0.15,
        "rate_clock_rate": 0.25,
        "rate_time_offset": 0.25,
        "saturation": 0.12,
        "stale_input_rate": 0.3,
        "stale_temperature": 0.45,
        "supply_voltage*gravity_s": 0.13,
        "supply_voltage*input_rate": 0.13,
        "temperature_threshold": 0.35,
        "vibration*gravity_s": 0.13,
        "vibration*input_rate": 0.3,
    }
)
# a threshold between two that are tried is wrong in all blocks between
SEEN_BETWEEN = MappingProxyType({"dead_zone": 0.9, "temperature_threshold": 0.55})


def test_the_library_holds_what_it_should() -> None:
    library = [name for name in NAMES if effect(name).kind is not EffectKind.SECOND_TIER]
    assert len(library) >= 32
    assert {effect(name).kind for name in NAMES} == set(EffectKind)
    assert {effect(name).role for name in NAMES} == set(Role)
    assert len({effect(name).en for name in NAMES}) == len({effect(name).zh for name in NAMES}) == len(NAMES)


@EVERY
def test_says_in_both_languages_what_it_is(name: str) -> None:
    its = effect(name)
    assert re.fullmatch(r"[a-z][a-z0-9_]*(\*[a-z][a-z0-9_]*)?", name)
    for text in (its.en, its.cause, its.reference, its.separating_test):
        assert text
        assert text == text.strip()
        assert text.isascii(), text
    for text in (its.zh, its.cause_zh, its.separating_test_zh):
        assert re.search(r"[\u4e00-\u9fff]", text)
    assert len(re.findall(r"[.](?: |$)", its.cause)) == 2, its.cause
    assert its.cause_zh.count("。") == 2, its.cause_zh
    assert name not in its.aliases
    assert set(its.aliases) <= set(NAMES), set(its.aliases) - set(NAMES)
    for parameter in its.parameters:
        assert parameter.en
        assert re.search(r"[\u4e00-\u9fff]", parameter.zh)


@EVERY
def test_units_can_be_read_whatever_the_channels_are_in(name: str) -> None:
    for run in (clean()[0], ramp(lambda name: "count")):
        check_unit(coefficient_unit(effect(name), "deg/h", run))
        for parameter in effect(name).parameters:
            check_unit(parameter_unit(parameter, run))


@EVERY
def test_columns_are_finite_as_many_as_reported_and_leave_their_input_alone(name: str) -> None:
    for run in recorded(name):
        before = {each: (channel.mean.copy(), channel.spread.copy()) for each, channel in run.channels.items()}
        first = effect(name).regressors(run, shape_of(name))
        assert first.shape == (len(run), len(columns_of(name)))
        assert first.dtype == np.float64
        assert np.isfinite(first).all()
        np.testing.assert_array_equal(first, effect(name).regressors(run, shape_of(name)))
        for each, (mean, spread) in before.items():
            np.testing.assert_array_equal(run.channels[each].mean, mean)
            np.testing.assert_array_equal(run.channels[each].spread, spread)
    assert len(set(columns_of(name))) == len(columns_of(name))


@EVERY
def test_columns_say_what_its_simulation_does(name: str) -> None:
    direction = direction_of(name)
    for shape in shapes_of(name):
        pair = beside(
            name, np.column_stack([simulated(name, direction, shape), stacked(name, recorded(name), shape) @ direction])
        )
        off = np.linalg.norm(pair[:, 0] - pair[:, 1]) / np.linalg.norm(pair[:, 0])
        assert off < MISSED_BY.get(name, MISSED), (shape, off)


@EVERY
def test_planted_in_noise_it_comes_back_with_sign_and_size(name: str) -> None:
    shape, direction = shape_of(name), direction_of(name)
    whole = beside(name, simulated(name, direction, shape)[:, None])[:, 0]
    size = Z / np.linalg.norm(whole)
    planted = Planted(name, (size * direction).tolist(), shape)
    runs = campaign().runs([planted], channels=ALL_CHANNELS)
    value = np.concatenate([run.value - rest.value for run, rest in zip(runs, recorded(name), strict=True)])
    data = beside(name, np.column_stack([value, stacked(name, runs) @ direction]))
    found = float(data[:, 0] @ data[:, 1] / (data[:, 1] @ data[:, 1]))
    # five standard errors, and what the columns miss; the columns may differ from the effect in length by as much
    missed = MISSED_BY.get(name, MISSED)
    assert abs(found / size - 1.0) < (5.0 / Z + missed) / (1.0 - missed)


@pytest.mark.in_gate("saturation", "dead_zone", "scale_factor_warm_up")
@pytest.mark.parametrize("name", GRID)
def test_between_two_values_of_its_grid_it_is_still_seen(name: str) -> None:
    (parameter,) = effect(name).parameters
    shapes = shapes_of(name)
    columns = beside(name, np.hstack([stacked(name, recorded(name), shape) for shape in shapes]))
    columns /= np.linalg.norm(columns, axis=0)
    for shape, after in pairwise(shapes):
        low, high = (np.asarray(each[parameter.name], float) for each in (shape, after))
        middle = float(np.sqrt(low * high)) if low > 0 else float(0.5 * (low + high))
        planted = beside(name, simulated(name, np.ones(1), {parameter.name: middle})[:, None])[:, 0]
        kept = np.max(np.abs(planted @ columns)) / np.linalg.norm(planted)
        assert kept > SEEN_BETWEEN.get(name, 0.95), (middle, kept)


@EVERY
def test_a_gap_is_stepped_over_by_true_time(name: str) -> None:
    run, gone = ramp(), slice(150, 230)
    shape = shape_of(name)
    whole = np.delete(effect(name).regressors(run, shape), gone, axis=0)
    broken = effect(name).regressors(without_blocks(run, gone), shape)
    # beside a gap the slope of what is curved is seen from one side
    np.testing.assert_allclose(broken, whole, rtol=1e-3, atol=1e-9 * max(1.0, float(np.max(np.abs(whole)))))


@EVERY
def test_where_a_channel_has_no_reading_only_those_blocks_are_lost(name: str) -> None:
    run, gone = ramp(), slice(150, 230)
    for needed in effect(name).needs:
        channel = run.channels[needed]
        mean, spread = channel.mean.copy(), channel.spread.copy()
        mean[gone], spread[gone] = np.nan, np.nan
        channels = {**run.channels, needed: Channel(mean, spread, channel.unit_of_measure)}
        columns = effect(name).regressors(replace(run, channels=channels), shape_of(name))
        is_lost: npt.NDArray[np.bool_] = np.isnan(columns.sum(axis=1))
        assert not np.delete(is_lost, gone).any()
        assert is_lost[gone].all() or needed != effect(name).needs[0]


@EVERY
def test_a_missing_or_constant_channel_is_reported(name: str) -> None:
    runs = recorded(name)
    assert effect(name).unavailable(runs) is None
    for needed in effect(name).needs:
        lacking = [without_channel(runs[0], needed), *runs[1:]]
        assert effect(name).unavailable(lacking) == f"channel {needed} is missing in 1 of {len(runs)} runs"
        assert name not in effects_for(lacking)
        assert name in unavailable_effects(lacking)
        resting = []
        for run in runs:
            still = Channel(np.full(len(run), 3.0), np.zeros(len(run)), "count")
            resting.append(replace(run, channels={**run.channels, needed: still}))
        assert effect(name).unavailable(resting) == f"channel {needed} stays at 3 count in these runs"


@EVERY
def test_its_shape_outlives_json(name: str) -> None:
    for shape in shapes_of(name):
        again = json.loads(json.dumps(shape))
        run = recorded(name)[3]
        np.testing.assert_array_equal(
            effect(name).regressors(run, again), effect(name).regressors(run, shape), err_msg=str(shape)
        )


@EVERY
def test_a_shape_that_is_none_is_refused(name: str) -> None:
    needs_a_value = [p for p in effect(name).parameters if not p.name.endswith("_nominal")]
    for parameter in needs_a_value:
        run = campaign().names[3]
        with pytest.raises(BadInput, match=parameter.name):
            effect(name).regressors(clean()[3], {**shape_of(name), parameter.name: "wide", "run": run})


def test_channels_of_other_names_take_part() -> None:
    candidates = effects_for(clean())
    assert "channel:compressor" in candidates
    assert "channel:temperature" not in candidates
    lacking = [without_channel(run, "temperature") for run in clean()]
    assert "channel:case_temperature" in effects_for(lacking)
    its = candidates["channel:compressor"]
    assert its.regressors(clean()[1], {}).shape == (len(clean()[1]), 1)
    assert isinstance(effect("channel:compressor"), Effect)


def test_an_unknown_name_is_answered_with_what_looks_alike() -> None:
    with pytest.raises(BadInput, match="did you mean thermal_lag"):
        effect("thermal_lagg")
    with pytest.raises(BadInput, match="known are ageing, "):
        effect("xyzzy")
