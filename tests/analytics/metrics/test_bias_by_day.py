"""The view of the bias by day: one row for each position and temperature."""

from typing import Any

import numpy as np
import pytest

from tests.analytics.conftest import SECOND_NS, START_NS


def test_the_bias_of_a_day_keeps_temperatures_positions_and_tests_apart(tested: Any) -> None:
    """What a unit gives at -40 degC, with its axis up, or at rest between two rates is not its bias of the day."""
    tested.run("r", t_ns=START_NS)
    t_ns = START_NS
    for procedure, position, temperature, rate, deg_per_h, count in (
        ("static_bias", "IRA_east", None, 0.0, 1.0, 300),
        ("static_bias", "IRA_east", None, 0.0, 4.0, 100),
        ("static_bias", "IRA_up", None, 0.0, 11.0, 100),
        ("bias_temperature_sensitivity", "IRA_east", -40.0, 0.0, -3.0, 100),
        ("scale_factor", "IRA_east", None, 0.0, 900.0, 100),
        ("scale_factor", "IRA_east", None, 10.0, 36000.0, 100),
    ):
        t_ns = tested.step("r", "FOG-0231", np.full(count, deg_per_h) + np.arange(count) % 2, t0_ns=t_ns,
                           dt_ns=SECOND_NS, procedure=procedure, position=position,
                           temperature_command_deg_c=temperature, rate_command_deg_per_s=rate)  # fmt: skip
    with tested.catalog() as catalog:
        rows = catalog.rows(
            "select position, temperature_command, bias, steps from bias_by_day order by position, temperature_command"
        )
    assert [(row[0], row[1], row[3]) for row in rows] == [
        ("IRA_east", -40.0, 1), ("IRA_east", None, 2), ("IRA_up", None, 1),
    ]  # fmt: skip
    # of the two static steps the longer counts three times: (3 * 1.5 + 4.5) / 4
    assert [row[2] for row in rows] == pytest.approx([-2.5, 2.25, 11.5], abs=1e-9)
