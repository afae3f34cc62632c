"""What of a trace becomes a version of a unit's error model."""

import numpy as np
import pytest

from analytics.loop.model.model_use import InUse
from analytics.loop.model_promotion import version_of
from analytics.loop.unit_diagnosis import diagnose_units
from analytics.loop.unit_reduction import Question
from stream.security.actor import Actor
from tests.analytics.conftest import START_NS, TestedUnits

DAY_NS = 86_400 * 10**9


@pytest.mark.long
def test_a_line_is_found_and_no_model_holds_it(tested: TestedUnits) -> None:
    rng = np.random.default_rng(8)
    t_s = np.arange(3600.0)
    for number in range(6):
        run, t0_ns = f"r{number}", START_NS + number * DAY_NS
        tested.run(run)
        line = 2.0 * np.sin(2.0 * np.pi * t_s / 400.0 + number)
        tested.samples(run, "U1", "rate", line + rng.standard_normal(t_s.size), t0_ns=t0_ns, dt_ns=10**9)
    with tested.catalog() as catalog:
        found = diagnose_units(catalog, ["U1"], Question("rate = bias")).units["U1"]
        version = version_of(catalog, found, InUse(), by=Actor("Li"))
    assert found.diagnosis.names == ("periodic_line",)
    assert found.diagnosis.holdout is not None
    assert found.diagnosis.holdout.accepted
    assert version.added == ()
    assert version.text == "rate = bias"
