"""The metric `allan_deviation`: at the averaging times that limits name, of the samples of a step."""

import re
from importlib.resources import files
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from analytics.metrics import allan_deviation
from analytics.specifications.verdicts import verdicts_of
from ingest.procedures.file import ready_names
from ingest.procedures.procedure import load_procedure
from ingest.station import run_limits
from ingest.station.run_limits import has_one_record_at_rest
from storage.sql.reading import read_signal
from tests.allan_definition import overlapping_allan_variance
from tests.analytics.conftest import START_NS, TestedUnits

SPECIFICATION = """
[[limit]]
metric = "allan_deviation"
parameters = {{ tau_s = {tau_s} }}
upper = {upper}
unit_of_measure = "deg/h"
"""


def recorded(tested: TestedUnits, seconds: int = 600) -> np.ndarray:
    values = np.random.default_rng(2).normal(1.0, 2.0, 10 * seconds)
    tested.run("r1", procedure="static_bias")
    tested.step("r1", "U1", values, t0_ns=START_NS, procedure="static_bias", position="IRA_east_west")
    return values


@pytest.mark.long
@pytest.mark.parametrize("tau_s", [0.1, 0.5, 10, 32, 150])
def test_it_is_the_overlapping_deviation_at_the_time_that_is_asked_for(tested: TestedUnits, tau_s: float) -> None:
    values = recorded(tested)
    tested.product('revision = "A"\n' + SPECIFICATION.format(tau_s=tau_s, upper=1.0))
    (row,) = tested.metric("allan_deviation")
    expected = np.sqrt(overlapping_allan_variance(values, round(10 * tau_s)))
    # of means over a sixteenth from 9.6 s on, which share nearly all of their information with every window
    assert row["value"] == pytest.approx(expected, rel=0.001 if tau_s < 9.6 else 0.1)
    assert row["lo"] < row["value"] < row["hi"]
    assert row["tau_s"] == tau_s


@pytest.mark.long
def test_without_a_limit_there_is_no_value_and_too_short_a_record_says_so(tested: TestedUnits) -> None:
    recorded(tested)
    assert tested.metric("allan_deviation") == []
    tested.product('revision = "A"\n' + SPECIFICATION.format(tau_s=400, upper=1.0))
    (row,) = tested.metric("allan_deviation")
    assert row["value"] is None
    assert len(row["reason"]) > 10


@pytest.mark.long
def test_a_limit_that_is_entered_later_brings_its_averaging_time(tested: TestedUnits, tmp_path: Path) -> None:
    recorded(tested)
    with tested.catalog() as catalog:
        assert verdicts_of(catalog).verdicts == []
    tested.product('revision = "A"\n' + SPECIFICATION.format(tau_s=10, upper=1.0))
    with tested.catalog() as catalog:
        (row,) = verdicts_of(catalog).verdicts
    assert (row["metric"], row["verdict"]) == ("allan_deviation", "PASS")


def test_live_limits_are_for_the_procedures_whose_records_are_of_a_bias() -> None:
    live = {name for name in ready_names() if has_one_record_at_rest(load_procedure(name).steps(), name)}
    assert live == {"static_bias", "allan_variance"}
    text = files("analytics.evaluation").joinpath("views", "05_procedures.sql").read_text(encoding="utf-8")
    macro = text[text.index("is_no_bias_procedure(") :].split(";")[0]
    families = set(re.findall(r"[a-z_0-9]{4,}", "".join(re.findall(r"'([^']*)'", macro))))

    assert families == set(re.findall(r"[a-z_0-9]{4,}", run_limits._NO_BIAS.pattern))


@pytest.mark.long
def test_two_steps_and_two_times_are_read_at_once_and_kept_apart(
    tested: TestedUnits, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(3)
    tested.run("r1", procedure="static_bias")
    steps = []
    for index in range(2):
        steps.append(rng.normal(1.0, 2.0 + index, 6000))
        place = "IRA_east_west" if index == 0 else "IRA_up"
        t0_ns = START_NS + index * 700 * 10**9
        tested.step("r1", "U1", steps[-1], t0_ns=t0_ns, procedure="static_bias", position=place)
    limits = "".join(SPECIFICATION.format(tau_s=tau_s, upper=9.0) for tau_s in (0.5, 5))
    tested.product('revision = "A"\n' + limits)
    reader = Mock(side_effect=read_signal)
    monkeypatch.setattr(allan_deviation, "read_signal", reader)
    rows = {(row["steps"][0], row["tau_s"]): row["value"] for row in tested.metric("allan_deviation")}
    assert reader.call_count == 1
    for (index, tau_s), value in rows.items():
        expected = np.sqrt(overlapping_allan_variance(steps[index - 1], round(10 * tau_s)))
        assert value == pytest.approx(expected, rel=0.001)
    assert len(rows) == 4
