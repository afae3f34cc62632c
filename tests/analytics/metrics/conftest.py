"""A rate table to measure a unit on."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.analytics.conftest import START_NS
from tests.analytics.metrics.rate_table import Gyro, Table


@pytest.fixture
def table(tested: Any) -> Callable[..., Table]:
    def begin(run: str = "r1", gyro: Gyro = lambda rate: rate, **options: Any) -> Table:
        tested.run(run, t_ns=options.get("t_ns", START_NS), procedure=options.pop("procedure", None))
        product = options.pop("product", None)
        if product is not None:
            tested.mount(run, "U1", product=product)
        return Table(tested, run, gyro, **options)

    return begin
