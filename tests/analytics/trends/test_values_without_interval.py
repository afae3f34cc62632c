"""Values without an interval count, and the report says so; all points beyond 3 sigma are named."""

import json
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from analytics.trends.charts.capability import Capability, capability
from analytics.trends.document import document
from analytics.trends.report import sentences
from analytics.trends.series import read_series
from analytics.trends.trend import trend_of
from gyrofleet import main
from tests.analytics.trends.reported_values import Reported, english, one_each

LIMITS = 'revision = "A"\n[[limit]]\nmetric = "bias"\nlower = 0.0\nupper = 2.0\nunit_of_measure = "deg/h"\n'
UNITS, SAMPLES, FROZEN = 24, 101, 40


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A lot of 24 units, of which the output of one stood still for three fifths of its record."""
    here = tmp_path_factory.mktemp("frozen")
    rng = np.random.default_rng(8)
    lines = ["unit,time[s],rate[deg/h],procedure,step,position"]
    for unit in range(UNITS):
        values = rng.normal(1.0, 0.1) + rng.normal(0, 0.1, SAMPLES)
        if unit == 5:
            values[FROZEN:] = values[FROZEN]
        lines += [f"K{unit:02},{at},{value:.5f},static_bias,static,IRA_up" for at, value in enumerate(values)]
    (here / "lot.csv").write_text("\n".join(lines))
    (here / "spec.toml").write_text(LIMITS)
    for words in (("import", "lot.csv", "--start", "2026-01-05T08:00:00Z"), ("limits", "add", "spec.toml")):
        given = [str(here / word) if word.endswith((".csv", ".toml")) else word for word in words]
        assert CliRunner().invoke(main, [*given, "--store", str(here / "S")]).exit_code == 0
    done = CliRunner().invoke(main, ["trend", "bias", "--store", str(here / "S"), "--json"])
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_the_capability_says_how_many_of_its_values_have_no_interval(report: dict[str, Any]) -> None:
    said = "\n".join(each["en"] for each in report["report"])
    assert "of 24 values, 1 of them without an interval; the uncertainty of measurement of 23 of them is " in said
    why = f"{SAMPLES - FROZEN} of {SAMPLES} samples in a row are alike"
    assert f"1 of 24 values has no interval and counts as the others do: K05 ({why}" in said
    (lacking,) = report["without_interval"]
    assert (lacking["unit"], lacking["remark"].startswith(why)) == ("K05", True)
    found = report["charts"][0]["capability"]
    assert (found["n"], found["share_of"], found["without_interval"]) == (24, 23, [lacking])
    chinese = "\n".join(each["zh"] for each in report["report"])
    assert "24 个值中有 1 个无区间" in chinese
    assert "alike" not in chinese


def test_the_share_of_the_uncertainty_is_that_of_the_values_that_have_one() -> None:
    values = np.random.default_rng(1).normal(0, 2.0, 40)
    uncertainty = np.full(40, 1.0)
    uncertainty[:10] = np.nan
    found = capability(values, -9, 9, uncertainty=uncertainty)
    assert isinstance(found, Capability)
    assert found.share_of == 30
    assert found.measurement_share == pytest.approx(1.0 / values.var(ddof=1))


def test_all_points_beyond_3_sigma_are_named_beside_a_wild_one(reported: Reported) -> None:
    values = np.random.default_rng(20260747).normal(0, 0.5, 100)
    values[30], values[7] = 300.0, 20.0
    said = english(trend_of(read_series(reported(one_each(values)), "bias")))
    assert "A wild point (U030" in said
    assert "Beyond 3 sigma as well: U007, " in said
    values[4:92:8] = 10.0  # eleven, far apart: no change of level
    said = english(trend_of(read_series(reported(one_each(values)), "bias")))
    assert said.count("10.00 deg/h (+") == 7
    assert " and 4 more." in said


def test_a_point_beyond_3_sigma_is_named_where_nothing_is_significant(reported: Reported) -> None:
    values = np.random.default_rng(20260747).normal(0, 0.5, 100)
    values[30] = -2.0
    trend = trend_of(read_series(reported(one_each(values)), "bias"))
    said = english(trend)
    assert "Nothing stands out" in said
    (point,) = document(trend)["charts"][0]["beyond_3_sigma"]
    assert (point["unit"], point["value"]) == ("U030", -2.0)
    assert point["sigmas"] < -3
    where, z = f"U030, {point['run']}, {point['time']}", f"{point['sigmas']:+.1f}"
    assert f"Beyond 3 sigma, not significantly more than noise gives: {where}: -2.00 deg/h ({z} sigma)." in said
    chinese = "\n".join(each.zh for each in sentences(trend))
    assert f"3σ 以外（未显著超过随机预期）：{where}：-2.00 deg/h（{z}σ）。" in chinese
    assert ("standard=" in said, "standard=" in chinese, "标准 " in chinese) == (True, False, True)
