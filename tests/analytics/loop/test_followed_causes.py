"""What else a finding may mean: causes that a proxy follows, channels that a run lacks, nothing that moves."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.report.finding_sentences import alternative
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Wording
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.partial_channels import partial_channels
from analytics.loop.tracing.result.diagnosis_result import ModelVerdict
from stream.batch import FloatArray

BIAS = ErrorModel.parse("rate = bias")
NOISE = ModelNoise(N=0.0046, B=0.01, K=0.01, turn_on=0.3)
BLOCKS = 240
DAY_NS = 86_400 * 10**9
SLOT = np.arange(BLOCKS)
UNITS = {"temperature": "degC", "supply_current": "A", "chamber_temperature": "degC", "input_rate": "deg/s"}


def one_run(number: int, error: FloatArray, rng: np.random.Generator, channels: Mapping[str, FloatArray]) -> RunBlocks:
    """Two hours of 30 s with a bias of its own and noise of 0.05 deg/h a block."""
    ones = np.ones(BLOCKS)
    value = 0.3 * rng.standard_normal() + error + 0.05 * rng.standard_normal(BLOCKS)
    return RunBlocks(
        "U1", f"r{number}", "rate", SLOT, 30.0, number * DAY_NS, value, 30 * ones.astype(int), 0.0025 * ones, "deg/h",
        {name: Channel(mean, 0.01 * ones, UNITS[name]) for name, mean in channels.items()},
    )  # fmt: skip


def supply_runs() -> list[RunBlocks]:
    """The supply moves bias and current; nobody records the voltage."""
    rng = np.random.default_rng(12)
    runs = []
    for number in range(9):
        volts = 0.5 * np.sign(np.sin(SLOT / (9.0 + number)))
        warm = 25.0 + 0.5 * np.sin(SLOT / 50.0 + number)
        current = 0.4 + 0.1 * volts + 0.001 * rng.standard_normal(BLOCKS)
        runs.append(one_run(number, 0.3 * volts, rng, {"temperature": warm, "supply_current": current}))
    return runs


def test_a_proxy_stands_for_causes_that_are_not_recorded() -> None:
    runs = supply_runs()
    found = diagnose(runs, BIAS, declared_noise=NOISE)
    assert found.names == ("supply_current",)
    assert found.verdict is ModelVerdict.CONFOUNDED
    others = {each.name: each for each in found.confounded}
    assert not others["supply_voltage"].recorded
    assert others["supply_voltage"].evidence_behind is None
    assert others["temperature"].recorded
    assert "supply voltage (not recorded)" in verdict_sentence(found, Wording("en", runs[0]))
    assert "not recorded" in alternative(others["supply_voltage"], Wording("en", runs[0]))
    document = {each["name"]: each["recorded"] for each in found.document()["confounded"]}
    assert document["supply_voltage"] is False


def test_every_proxy_follows_causes_that_the_library_has() -> None:
    for name in ("chamber_setpoint", "chamber_temperature", "supply_current", "table_rate"):
        causes = [effect(each) for each in effect(name).follows]
        assert len(causes) >= 3
        assert {each.role.value for each in causes} == {"cause"}


def rate_runs() -> list[RunBlocks]:
    rng = np.random.default_rng(13)
    runs = []
    for number in range(10):
        rate = np.array([-20.0, 3.0, 0.0, 7.0, 15.0])[(SLOT // 24 + number) % 5]
        warm = 25.0 + 5.0 * np.sin(SLOT / 40.0 + number)
        runs.append(one_run(number, 3600.0 * rate, rng, {"input_rate": rate, "temperature": warm}))
    still = one_run(3, np.zeros(BLOCKS), rng, {"temperature": np.asarray(25.0 + np.sin(SLOT / 30.0))})
    return [*runs[:3], still, *runs[4:]]


@pytest.mark.long
def test_one_run_of_ten_without_a_channel_hides_its_effect_from_none_of_the_others() -> None:
    found = diagnose(rate_runs(), BIAS, declared_noise=NOISE)
    assert "scale_factor" in found.names
    assert "r3" not in found.runs
    assert any(each.startswith("r3 lack channel input_rate") for each in found.limits)
    assert found.document()["left_out"] == [
        {"what": "runs (r3)", "share": 0.1, "why": "channel input_rate is not recorded there"}
    ]
    assert found.error is not None
    assert found.error.rows[0].after < 1.0  # deg/h, before it is 36,000


def test_effects_of_a_channel_that_one_run_lacks_are_looked_for_where_it_is() -> None:
    """Nothing is missing: all ten runs stay, and the effect has a detection limit all the same."""
    runs = rate_runs()
    model = ErrorModel.parse("rate = bias")
    quiet = [
        run if "input_rate" not in run.channels else replace(run, value=run.value - 3600.0 * run.mean("input_rate"))
        for run in runs
    ]
    found = diagnose(quiet, model, declared_noise=NOISE)
    assert found.verdict is ModelVerdict.NOTHING_MISSING
    assert len(found.runs) == 10
    assert found.detection_limits["scale_factor"].absent_above < 0.01
    assert "scale_factor" not in found.not_tested


@pytest.mark.parametrize(("without", "is_partial"), [(1, True), (3, True), (4, False), (10, False)])
def test_a_channel_that_more_than_a_third_lacks_is_looked_for_nowhere(without: int, is_partial: bool) -> None:
    rng = np.random.default_rng(1)
    still = {"temperature": np.full(BLOCKS, 25.0)}
    both = {**still, "input_rate": np.zeros(BLOCKS)}
    runs = [one_run(n, np.zeros(BLOCKS), rng, still if n < without else both) for n in range(10)]
    some = partial_channels(runs)
    assert (some is not None) is is_partial
    if some is not None:
        assert some.channels == ("input_rate",)
        assert len(some.runs) == 10 - without
    assert partial_channels(runs, [runs[0].run]) is None  # it is to be held out


def test_what_moves_by_rounding_alone_is_not_called_absent() -> None:
    """25 degC to its last digit moves by 1e-16 degC/s: a limit of 1e15 deg/h/(degC/s) says nothing."""
    rng = np.random.default_rng(14)
    last_digit = float(np.spacing(25.0))
    runs = []
    for number in range(6):
        warm = np.asarray(25.0 + last_digit * rng.integers(0, 3, BLOCKS), dtype=np.float64)
        runs.append(one_run(number, np.zeros(BLOCKS), rng, {"temperature": warm}))
    found = diagnose(runs, BIAS, declared_noise=NOISE)
    assert found.verdict is ModelVerdict.NOTHING_MISSING
    assert "temperature_rate" not in found.detection_limits
    assert "too little to test it" in found.not_tested["temperature_rate"]
    assert all(each.absent_above < 1e9 for each in found.detection_limits.values())
