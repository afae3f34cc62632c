"""Range and polarity of a gyro on a rate table."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.analytics.metrics.rate_table import Table


def test_range_is_where_the_nonlinearity_meets_the_limit(tested: Any, table: Callable[..., Table]) -> None:
    tested.product("[product.FOG-70]\nnonlinearity_ppm = 100.0")
    table(gyro=lambda rate: float(np.clip(rate, -170, 170)), product="FOG-70").rates(procedure="scale_factor")
    for row in tested.metric("range"):
        assert (row["value"], row["lo"], row["hi"]) == (160.0, 160.0, 250.0)


@pytest.mark.long
def test_range_needs_a_limit(tested: Any, table: Callable[..., Table]) -> None:
    tested.product("[product.FOG-70]\nmax_rate_deg_per_s = 300.0")
    table(product="FOG-70").rates(procedure="scale_factor")
    assert {row["reason"] for row in tested.metric("range")} == {
        "no limit of the nonlinearity: give nonlinearity_ppm of product FOG-70 in a specification"
    }


@pytest.mark.long
@pytest.mark.parametrize(("sign", "value"), [(1, 1.0), (-1, -1.0)])
def test_polarity(tested: Any, table: Callable[..., Table], sign: int, value: float) -> None:
    rig = table(gyro=lambda rate: sign * rate)
    rig.step(10.0, procedure="polarity", step="forwards")
    rig.step(-10.0, procedure="polarity", step="backwards")
    (row,) = tested.metric("polarity")
    assert (row["value"], row["lo"], row["hi"]) == (value, value, value)


@pytest.mark.long
def test_polarity_that_cannot_be_told(tested: Any, table: Callable[..., Table]) -> None:
    rig = table(gyro=lambda rate: 0.0)
    rig.step(10.0, procedure="polarity")
    rig.step(-10.0, procedure="polarity")
    (row,) = tested.metric("polarity")
    assert row["value"] is None
    assert "cannot be distinguished" in row["reason"]
