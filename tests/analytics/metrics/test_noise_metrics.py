"""Noise coefficients as metrics: of the stored fit of a run, and of the samples of a step."""

import math
from typing import Any

import numpy as np
import pytest

from stream.batch import FloatArray
from stream.estimators.noise.normalised_random_walk import NormalisedRandomWalk, angle_random_walk_normalised
from stream.events import NoiseFitted
from tests.analytics.conftest import START_NS
from tests.analytics.metrics.metric_rows import DAY_NS, DT_NS, HOUR, exact, one


def coefficient(value: float, *, observable: bool = True) -> dict[str, Any]:
    reason = "" if observable else "not observable in this record: at most 9 deg/h"
    return {"value": value, "lo": value * 0.9, "hi": value * 1.1, "unit_of_measure": "deg/h", "observable": observable,
            "reason": reason}  # fmt: skip


def fill(tested: Any) -> FloatArray:
    """Two units, of one of which a fit is stored; the fast samples of that one."""
    rng = np.random.default_rng(15)
    white = rng.normal(0, 6.0, HOUR)
    fast = rng.normal(0, 6.0, 12_000)
    tested.run("r1", procedure="allan_variance")
    tested.step("r1", "U1", white, t0_ns=START_NS, dt_ns=DT_NS, procedure="allan_variance")
    tested.step("r1", "U2", white, t0_ns=START_NS, dt_ns=DT_NS, procedure="allan_variance")
    keys = ("quantization_noise", "angle_random_walk", "bias_instability", "rate_random_walk", "rate_ramp")
    coefficients = {key: coefficient(i + 1.0, observable=i < 3) for i, key in enumerate(keys)}
    fit: dict[str, Any] = {**coefficients, "markov": None, "misfit": 0.0}
    tested.document(NoiseFitted(run="r1", t_ns=START_NS + DAY_NS, unit="U1", signal="rate", coefficients=fit))
    tested.run("r2", procedure="random_walk")
    tested.step("r2", "U1", fast, t0_ns=START_NS, dt_ns=5_000_000, procedure="random_walk")
    tested.step("r2", "U2", fast[::2], t0_ns=START_NS, dt_ns=10_000_000, procedure="random_walk")
    return fast


def test_noise_coefficients(tested: Any) -> None:
    fast = fill(tested)
    found = tested.metrics("angle_random_walk", "rate_ramp")
    walks = found["angle_random_walk"]
    fitted = one(walks, unit="U1", method="allan")
    assert [fitted[name] for name in ("value", "lo", "hi", "record")] == [2.0, 1.8, 2.2, "run"]
    own = one(walks, unit="U2", method="allan")
    assert own["record"] == "step"
    # the Allan variance at the shortest averaging time is nearly all there is to tell white noise by
    truth = 6.0 * math.sqrt(0.25) / 60
    assert own["lo"] < truth < own["hi"]
    assert own["value"] == pytest.approx(truth, rel=5 / math.sqrt(2 * HOUR / 1.5))
    short = one(walks, unit="U1", method="normalised")
    seconds = fast.reshape(60, 200).mean(axis=1)
    halves = np.median([seconds[:30].std(ddof=1), seconds[30:].std(ddof=1)]) / 60
    assert short["value"] == exact(halves)
    alone = angle_random_walk_normalised(fast, 0.005)
    assert isinstance(alone, NormalisedRandomWalk)
    assert short["hi"] == exact(alone.coefficient.hi)
    assert "less than 0.01 s" in one(walks, unit="U2", method="normalised")["reason"]

    ramp = found["rate_ramp"]
    assert one(ramp, unit="U1")["reason"] == "not observable in this record: at most 9 deg/h"
    assert "no noise fit is stored" in one(ramp, unit="U2")["reason"]


@pytest.mark.long
def test_each_coefficient_of_a_stored_fit_is_a_metric(tested: Any) -> None:
    fill(tested)
    found = tested.metrics("bias_instability", "quantization_noise", "rate_random_walk")
    assert one(found["bias_instability"], unit="U1")["value"] == 3.0
    assert one(found["quantization_noise"], unit="U1")["lo"] == 0.9
    assert one(found["rate_random_walk"], unit="U1")["value"] is None
