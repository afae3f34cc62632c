"""Several effects at once: of about the same strength, or of the same channel."""

from dataclasses import replace

import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import ModelVerdict
from stream.batch import FloatArray

BLOCKS, BLOCK_S, WHITE = 240, 60.0, 0.1
UNITS = {"temperature": "degC", "supply_voltage": "V", "magnetic_i": "gauss"}


def wandering(rng: np.random.Generator, blocks: int) -> FloatArray:
    """A slow signal of mean 0 and standard deviation 1."""
    made = np.convolve(rng.standard_normal(blocks + 60), np.hanning(60), "valid")[:blocks]
    return np.asarray((made - made.mean()) / made.std())


def runs_of(seed: int, error: str) -> list[RunBlocks]:
    """Nine runs over temperature, a supply and a field that wander by themselves, with an error and white noise."""
    rng, ones, found = np.random.default_rng(seed), np.ones(BLOCKS), []
    for number in range(9):
        channels = {
            "temperature": 22.0 + 38.0 * np.sin(np.linspace(0.0, 2 * np.pi, BLOCKS) + rng.uniform(0, 6.3)),
            "supply_voltage": 28.0 + 0.3 * wandering(rng, BLOCKS),
            "magnetic_i": 0.3 + 0.1 * wandering(rng, BLOCKS),
        }
        names = {"T": channels["temperature"] - 25.0, "V": channels["supply_voltage"], "B": channels["magnetic_i"]}
        value = eval(error, {"sin": np.sin}, names) + rng.normal(0, 0.02) + WHITE * rng.standard_normal(BLOCKS)
        made = {name: Channel(each, 1e-4 * ones, UNITS[name]) for name, each in channels.items()}
        noise = WHITE**2 * ones
        found.append(
            RunBlocks("U1", f"r{number}", "rate", np.arange(BLOCKS), BLOCK_S, 0, value, 60 * ones.astype(int), noise,
                      "deg/h", made)
        )  # fmt: skip
    return found


@pytest.mark.in_gate("0")
@pytest.mark.parametrize("seed", range(4))
def test_two_independent_effects_of_the_same_strength_are_no_rivals(seed: int) -> None:
    """Each has about the evidence of the other; none explains what the other does."""
    found = diagnose(runs_of(seed, "0.1*(V - 28) + 0.3*(B - 0.3)"), ErrorModel.parse("rate = bias + temperature"))
    assert (found.verdict, set(found.names)) == (ModelVerdict.EFFECT_FOUND, {"supply_voltage", "magnetic_i"})
    truth = {"supply_voltage": 0.1, "magnetic_i": 0.3}
    for each in found.effects:
        (size,) = each.coefficients
        assert abs(size.value - truth[each.name]) < 4 * (size.hi - size.lo) / (2 * 1.96)


@pytest.mark.in_gate("third degree")
@pytest.mark.parametrize(
    ("error", "truth"),
    [
        ("0.02*T + 3e-4*T**2", {"temperature": 0.02, "temperature_squared": 3e-4}),
        ("0.02*T + 3e-4*T**2 + 6e-6*T**3",
         {"temperature": 0.02, "temperature_squared": 3e-4, "temperature_cubed": 6e-6}),
    ],
    ids=["second degree", "third degree"],
)  # fmt: skip
def test_a_polynomial_of_temperature_is_named_by_its_terms(error: str, truth: dict[str, float]) -> None:
    found = diagnose(runs_of(7, error), ErrorModel.parse("rate = bias"))
    assert (found.verdict, set(found.names)) == (ModelVerdict.EFFECT_FOUND, set(truth))
    for each in found.effects:
        (size,) = each.coefficients
        assert abs(size.value - truth[each.name]) < 4 * (size.hi - size.lo) / (2 * 1.96)


def test_another_form_stays_a_function() -> None:
    """No sum of the library's effects has it."""
    found = diagnose(runs_of(9, "0.5*sin(T / 12.0)"), ErrorModel.parse("rate = bias"))
    assert found.verdict is ModelVerdict.UNKNOWN_FUNCTION


@pytest.mark.parametrize("ppm", [0.0, 5.0])
def test_a_scale_factor_that_does_not_repeat_is_no_line(ppm: float) -> None:
    """Ladders of rates in the same order: 5 ppm of scatter would be lines of the ladder's harmonics."""
    rng, ones = np.random.default_rng(5), np.ones(BLOCKS)
    ladder = np.repeat([0, 10, 30, 100, 30, 10, 0, -10, -30, -100, -30, -10], BLOCKS // 12).astype(float)
    runs = []
    for number in range(9):
        factor = 3600.0 * (1.0 + 1e-6 * ppm * rng.standard_normal())
        value = factor * ladder + rng.normal(0, 0.05) + WHITE * rng.standard_normal(BLOCKS)
        temperature = Channel(25.0 + 2.0 * wandering(rng, BLOCKS), 1e-3 * ones, "degC")
        channels = {"input_rate": Channel(ladder, 0.0 * ones, "deg/s"), "temperature": temperature}
        runs.append(
            RunBlocks("U1", f"r{number}", "rate", np.arange(BLOCKS), BLOCK_S, 0, value, 60 * ones.astype(int),
                      WHITE**2 * ones, "deg/h", channels)
        )  # fmt: skip
    found = diagnose(runs, ErrorModel.parse("rate = bias + scale_factor*input_rate"))
    about = [str(each) for each in found.limits if "differs from run to run" in str(each)]
    if ppm == 0.0:
        assert (found.verdict, about) == (ModelVerdict.NOTHING_MISSING, [])
        return
    assert found.verdict not in (ModelVerdict.NOTHING_MISSING, ModelVerdict.EFFECT_FOUND)
    assert not {"periodic_line", "jump"}.intersection(found.names)
    assert len(about) == 1
    assert "scale_factor" in about[0]


def test_what_follows_the_same_stays_a_rival_beside_a_larger_effect() -> None:
    """A sensor that is read late and the rate of temperature have one form; a strong supply does not decide."""
    found = []
    for run in runs_of(21, "2.0*(V - 28) + 0.02*T"):
        temperature, voltage = run.channels["temperature"], run.channels["supply_voltage"]
        value = run.value + 20.0 * np.gradient(temperature.mean, BLOCK_S)
        found.append(replace(run, value=value, channels={"temperature": temperature, "supply_voltage": voltage}))
    diagnosis = diagnose(found, ErrorModel.parse("rate = bias + temperature"))
    (of_rate,) = (each for each in diagnosis.effects if each.name == "temperature_rate")
    assert "temperature_time_offset" in [each.name for each in of_rate.confounded]
