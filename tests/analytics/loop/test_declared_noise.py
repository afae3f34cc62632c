"""Noise to start from where nobody declares it: from the Allan fits of a unit's runs."""

from typing import Any

import numpy as np
import pytest

from analytics.loop.blocks.block_reducer import BlockReducer
from analytics.loop.model.declared_noise import declared_noise
from analytics.loop.model.error_model import ErrorModel
from stream.estimators.base import NoEstimate
from stream.events import NoiseFitted
from tests.analytics.conftest import START_NS, TestedUnits


def test_noise_comes_from_the_allan_fits_of_the_unit(tested: TestedUnits) -> None:
    rng = np.random.default_rng(7)
    for at, run in enumerate(("r1", "r2", "r3", "r4", "r5")):
        tested.run(run)
        tested.samples(run, "U1", "rate", 10.0 * at + rng.normal(0.0, 1.0, 6000), t0_ns=START_NS)
        seen = {"observable": True, "lo": 0.0, "hi": 0.9}
        fit: dict[str, Any] = {
            "angle_random_walk": {"value": 0.01 * (1 + at), **seen},
            "bias_instability": {"value": 0.2, **seen},
            "rate_random_walk": {"value": 0.0, "lo": 0.0, "hi": 0.9, "observable": False},
            "misfit": 0.9 if run == "r1" else 0.01,
        }
        tested.document(NoiseFitted(run=run, t_ns=START_NS, unit="U1", signal="rate", coefficients=fit))
    with tested.catalog() as catalog:
        runs = BlockReducer(catalog, "rate").reduce("U1").runs
        noise = declared_noise(catalog, runs, ErrorModel.parse("bias"))
        assert not isinstance(noise, NoEstimate)
        # the fit of r1 does not describe it; lower quartile of 0.02 to 0.05
        np.testing.assert_allclose([noise.N, noise.B, noise.K], [0.0275, 0.2, 0.3])
        assert noise.most == (0.9, 0.9, 0.9)
        assert noise.turn_on == pytest.approx(14.826, rel=0.01)  # of constants 10 apart
        none = declared_noise(catalog, runs[:1], ErrorModel.parse("bias"))
        assert isinstance(none, NoEstimate)
        assert "give --noise" in none.reason


def test_flicker_and_walk_come_from_long_runs(tested: TestedUnits) -> None:
    """The long averages of short runs show their effects."""
    rng = np.random.default_rng(9)
    for run, samples, walk in (("r1", 1000, 5.0), ("r2", 1000, 6.0), ("r3", 1000, 7.0), ("r4", 9000, 0.1)):
        tested.run(run)
        tested.samples(run, "U1", "rate", rng.normal(0.0, 1.0, samples), t0_ns=START_NS)
        keys = ("angle_random_walk", "bias_instability", "rate_random_walk")
        fit: dict[str, Any] = {
            key: {"value": value, "observable": True, "lo": 0.0, "hi": 9.0}
            for key, value in zip(keys, (0.02, walk, walk), strict=True)
        }
        tested.document(
            NoiseFitted(run=run, t_ns=START_NS, unit="U1", signal="rate", coefficients=fit | {"misfit": 0.0})
        )
    with tested.catalog() as catalog:
        noise = declared_noise(catalog, BlockReducer(catalog, "rate").reduce("U1").runs, ErrorModel.parse("bias"))
    assert not isinstance(noise, NoEstimate)
    np.testing.assert_allclose([noise.N, noise.B, noise.K], [0.02, 0.1, 0.1])


def test_the_walk_of_a_declared_temperature_term_is_none(tested: TestedUnits) -> None:
    """Allan curves of temperature cycles gave 0.24 deg/h/sqrt(h) for 0.01, and a caveat in nine of ten units."""
    rng = np.random.default_rng(10)
    seconds = np.arange(7200)
    for at in range(4):
        run, warmer = f"r{at}", (-1.0) ** at * np.interp(seconds, [600, 2400, 3600, 6000, 7200], [0, 20, 20, -15, 0])
        tested.run(run)
        walk = np.cumsum(rng.normal(0.0, 0.01 / 60.0, seconds.size))
        output = 0.08 * warmer + walk + rng.normal(0.0, 0.6, seconds.size)
        tested.samples(run, "U1", "temperature", 25 + warmer, t0_ns=START_NS, dt_ns=10**9, unit_of_measure="degC")
        tested.samples(run, "U1", "rate", output, t0_ns=START_NS, dt_ns=10**9)
        keys = ("angle_random_walk", "bias_instability", "rate_random_walk")
        fit: dict[str, Any] = {
            key: {"value": value, "observable": True, "lo": 0.0, "hi": 9.0}
            for key, value in zip(keys, (0.01, 0.02, 0.24), strict=True)
        }
        tested.document(
            NoiseFitted(run=run, t_ns=START_NS, unit="U1", signal="rate", coefficients=fit | {"misfit": 0.0})
        )
    with tested.catalog() as catalog:
        runs = BlockReducer(catalog, "rate").reduce("U1").runs
        alone, beside = (
            declared_noise(catalog, runs, ErrorModel.parse(each)) for each in ("bias", "bias + temperature")
        )
    assert not isinstance(alone, NoEstimate)
    assert not isinstance(beside, NoEstimate)
    assert pytest.approx(0.24) == alone.K, "of a term that is not declared it is left to the search"
    assert 0.01 < beside.K < 0.1


@pytest.mark.long
def test_allan_fits_of_runs_in_which_the_unit_was_turned_do_not_count(tested: TestedUnits) -> None:
    """They are of the motion: white noise of 15 deg/sqrt(h) would hide everything."""
    rng = np.random.default_rng(8)
    for run, turned in (("r1", 0.0), ("r2", 1.0), ("r3", 1.0)):
        tested.run(run)
        rate = turned * np.repeat(np.tile([10.0, -10.0, 0.0], 4), 500)  # deg/s
        tested.samples(run, "U1", "input_rate", rate, t0_ns=START_NS, unit_of_measure="deg/s")
        tested.samples(run, "U1", "rate", 3600.0 * rate + rng.normal(0.0, 1.0, rate.size), t0_ns=START_NS)
        seen = {"observable": True, "lo": 0.0, "hi": 0.9}
        value = 15.0 if turned else 0.02
        keys = ("angle_random_walk", "bias_instability", "rate_random_walk")
        fit: dict[str, Any] = {key: {"value": value, **seen} for key in keys} | {"misfit": 0.0}
        tested.document(NoiseFitted(run=run, t_ns=START_NS, unit="U1", signal="rate", coefficients=fit))
    with tested.catalog() as catalog:
        runs = BlockReducer(catalog, "rate").reduce("U1").runs
        noise = declared_noise(catalog, runs, ErrorModel.parse("bias + scale_factor*input_rate"))
        assert not isinstance(noise, NoEstimate)
        assert pytest.approx(0.02) == noise.N
        none = declared_noise(catalog, runs[1:], ErrorModel.parse("bias + scale_factor*input_rate"))
        assert isinstance(none, NoEstimate)
        assert "it was turned in all runs" in none.reason


def test_white_noise_that_no_curve_shows_is_that_of_neighbouring_blocks(tested: TestedUnits) -> None:
    """Of means of a minute N was a third of its bound, and sound units had "more noise than declared"."""
    sigma, rng = 0.6, np.random.default_rng(12)  # deg/h of a minute: N = 0.0775
    for run in ("r1", "r2", "r3"):
        tested.run(run)
        walk = np.cumsum(rng.normal(0.0, 0.02, 240))
        tested.samples(run, "U1", "rate", rng.normal(5.0, sigma, 240) + walk, t0_ns=START_NS, dt_ns=60 * 10**9)
        unseen = {"value": 0.0, "lo": 0.0, "observable": False}
        fit: dict[str, Any] = {
            "angle_random_walk": unseen | {"hi": 0.09},
            "bias_instability": unseen | {"hi": 0.5},
            "rate_random_walk": unseen | {"hi": 0.9},
            "misfit": 0.0,
        }
        tested.document(NoiseFitted(run=run, t_ns=START_NS, unit="U1", signal="rate", coefficients=fit))
    with tested.catalog() as catalog:
        runs = BlockReducer(catalog, "rate", block_s=60.0).reduce("U1").runs
        noise = declared_noise(catalog, runs, ErrorModel.parse("bias"))
    assert not isinstance(noise, NoEstimate)
    # half the relative variance of a median of 717 squares, 2 * 1.5 / 0.37 / 717; four standard deviations
    assert pytest.approx(sigma / 60**0.5, rel=4 * 0.5 * (8.1 / 717) ** 0.5) == noise.N
    np.testing.assert_allclose([noise.B, noise.K], [0.5 / 3, 0.3])
