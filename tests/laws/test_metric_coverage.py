"""Limits of metrics hold the truth as often as they say: the short form of ``tests/bench/metric_coverage.py``."""

from pathlib import Path

import pytest

from storage.store import Store
from tests.bench.metric_coverage import CHECKS, covered


@pytest.mark.long
def test_limits_hold_the_truth_as_often_as_they_say(tmp_path: Path) -> None:
    """Tests of few steps, few units."""
    few = {"static_bias", "bias_acceleration_sensitivity", "scale_factor", "misalignment_repeatability"}
    checks = [each for each in CHECKS if each.procedure in few]
    found = list(covered(Store.create(tmp_path / "store"), 25, 7, checks))
    assert [each for each in found if each.outside] == []
    assert {each.rows for each in found} == {25}
