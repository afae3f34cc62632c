"""The measured scale factor, in what a unit that gives rates is judged by."""

from typing import Any

import numpy as np
import pytest

from stream.events import NoiseFitted
from tests.analytics.conftest import START_NS, TestedUnits

RATES = (4.0, 6.3, 10.0, 16.0, 25.0, 40.0, 63.0, 100.0, 160.0, 250.0, 300.0)
K = 1.05
BIAS = 50.3  # deg/h of input
HOUR = 36_000


def turned(
    tested: TestedUnits, measure: str, per_deg_per_s: float, k: float = K, *, zero: float = 0.0, **words: Any
) -> int:
    """A scale factor is measured; returns when that ended."""
    tested.run("rates")
    t_ns = START_NS
    for rate in (0.0, *(sign * rate for rate in RATES for sign in (1, -1)), 0.0):
        t_ns = tested.step(
            "rates", "U1", np.full(20, per_deg_per_s * k * rate + zero), t0_ns=t_ns, unit_of_measure=measure,
            procedure="scale_factor", rate_command_deg_per_s=rate, **words,
        )  # fmt: skip
    return t_ns


def at_rest(tested: TestedUnits, measure: str, per_deg_per_s: float, t_ns: int, k: float = K) -> None:
    noise = np.random.default_rng(4).normal(0, 1.0, HOUR)
    values = (BIAS + noise) / 3600 * k * per_deg_per_s
    tested.run("still", t_ns=t_ns)
    tested.step("still", "U1", values, t0_ns=t_ns, unit_of_measure=measure, procedure="static_bias")


def only(rows: list[dict[str, Any]], **words: Any) -> dict[str, Any]:
    (row,) = [row for row in rows if all(row[name] == value for name, value in words.items())]
    return row


@pytest.mark.in_gate("mV-20.0")
@pytest.mark.parametrize(("measure", "per_deg_per_s"), [("deg/h", 3600.0), ("deg/s", 1.0), ("mV", 20.0)])
def test_a_bias_is_of_the_input_whatever_the_output_is_in(
    tested: TestedUnits, measure: str, per_deg_per_s: float
) -> None:
    at_rest(tested, measure, per_deg_per_s, turned(tested, measure, per_deg_per_s))
    of = tested.metrics("bias", "bias_stability")
    bias = only(of["bias"], run="still", earth_rate="none")
    assert bias["value"] == pytest.approx(BIAS, abs=0.03)
    assert bias["scale_factor"] == "measured in run rates"
    assert only(of["bias_stability"], run="still")["value"] == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize("sign", [pytest.param(1, marks=pytest.mark.long), -1])
def test_an_axis_that_points_down_has_a_zero_and_a_scale_factor_of_its_own(tested: TestedUnits, sign: int) -> None:
    # sign -1: the table counts its rate against the axis
    zero = BIAS / 3600 * K * 20.0
    t_ns = turned(tested, "mV", sign * 20.0, zero=zero, position="IRA_down")
    at_rest(tested, "mV", 20.0, t_ns)
    of = tested.metrics("fitted_zero", "bias")
    found = only(of["fitted_zero"], standard="JJF2014")
    assert found["value"] == pytest.approx(BIAS, rel=1e-9)
    assert found["output"] == pytest.approx(zero, rel=1e-9)
    bias = only(of["bias"], run="still", earth_rate="none")
    assert bias["value"] == pytest.approx(BIAS, abs=0.03)
    assert bias["scale_factor"] == "measured in run rates"


@pytest.mark.long
def test_noise_coefficients_are_of_the_input_too(tested: TestedUnits) -> None:
    t_ns = turned(tested, "deg/h", 3600.0)
    at_rest(tested, "deg/h", 3600.0, t_ns)
    found = {"value": 2.1, "lo": 1.05, "hi": 4.2, "unit_of_measure": "deg/h", "observable": True, "reason": ""}
    keys = ("quantization_noise", "angle_random_walk", "bias_instability", "rate_random_walk", "rate_ramp")
    fit: dict[str, Any] = {**dict.fromkeys(keys, found), "markov": None, "misfit": 0.0}
    tested.document(NoiseFitted(run="still", t_ns=t_ns + 1, unit="U1", signal="rate", coefficients=fit))
    row = only(tested.metric("bias_instability"), run="still")
    assert [row[name] for name in ("value", "lo", "hi")] == pytest.approx([2.0, 1.0, 4.0])


@pytest.mark.long
def test_an_axis_that_did_not_turn_keeps_its_unit(tested: TestedUnits) -> None:
    t_ns = turned(tested, "deg/h", 3600.0, k=0.004)
    at_rest(tested, "deg/h", 3600.0, t_ns, k=1.0)
    bias = only(tested.metric("bias"), run="still", earth_rate="none")
    assert bias["value"] == pytest.approx(BIAS, abs=0.03)
    assert bias["scale_factor"] == "output is a rate"


@pytest.mark.long
def test_a_scale_factor_of_another_unit_of_measure_is_not_taken(tested: TestedUnits) -> None:
    at_rest(tested, "deg/h", 3600.0, turned(tested, "mV", 20.0), k=1.0)
    assert only(tested.metric("bias"), run="still", earth_rate="none")["value"] == pytest.approx(BIAS, abs=0.03)
