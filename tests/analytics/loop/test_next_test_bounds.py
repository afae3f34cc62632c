"""What a test may use: the unit's runs, the station file, and what is given."""

from pathlib import Path

import pytest

from analytics.loop.bilingual import Bilingual
from analytics.loop.next_test.candidate import CandidateTest
from analytics.loop.next_test.decisions import AT_REST
from analytics.loop.next_test.plans import TestPlan
from analytics.loop.next_test.recommendation import NextTest
from analytics.loop.next_test.station_bounds import StationBounds, limits_of_station
from analytics.loop.report.next_test_rows import bounds_sentence, next_test_rows, next_test_sentence
from analytics.loop.report.wording import Wording
from stream.errors import BadInput
from tests.bench.loop_campaign import Campaign

STATION = """
[station]
site = "plant"
name = "bench"

[instruments.chamber]
kind = "temperature_chamber"
resource = "TCPIP::127.0.0.1::1::SOCKET"
lowest_deg_c = -30.0
highest_deg_c = 50.0

[instruments.table]
kind = "rate_table"
resource = "TCPIP::127.0.0.1::2::SOCKET"
max_rate_deg_per_s = 10.0

[instruments.supply]
kind = "power_supply"
resource = "TCPIP::127.0.0.1::3::SOCKET"
max_voltage_v = 12.5
max_current_a = 2.0
"""


@pytest.fixture
def limits(tmp_path: Path) -> dict[str, float]:
    path = tmp_path / "station.toml"
    path.write_text(STATION)
    return limits_of_station(path)


def test_a_station_file_narrows_what_the_unit_has_been_through(limits: dict[str, float]) -> None:
    runs = Campaign(3, runs=6, types=("temperature", "rate", "environment"), duration_s=3600.0).runs()
    shown, bounds = StationBounds.of_runs(runs), StationBounds.of_runs(runs, limits)
    assert shown.rate_deg_per_s is not None
    assert shown.rate_deg_per_s > 10.0
    assert (bounds.rate_deg_per_s, bounds.sources["rate_deg_per_s"]) == (10.0, "station")
    assert (bounds.most_v, bounds.sources["most_v"]) == (12.5, "station")
    assert bounds.least_v == shown.least_v
    assert bounds.least_deg_c == max(-30.0, shown.least_deg_c or -99.0)
    assert "slope_deg_c_per_min" not in bounds.sources


def test_a_station_file_gives_what_the_runs_do_not_show_but_no_voltage(limits: dict[str, float]) -> None:
    runs = Campaign(3, runs=3, types=("static",), duration_s=3600.0).runs()
    bounds = StationBounds.of_runs(runs, limits)
    assert (bounds.least_deg_c, bounds.most_deg_c) == (-30.0, 50.0)
    assert bounds.sources["most_deg_c"] == "station"
    assert bounds.most_v is None
    assert bounds.document()["slope_deg_c_per_min"]["from"] == "default"


def test_a_bound_beyond_the_station_is_refused(limits: dict[str, float]) -> None:
    runs = Campaign(3, runs=3, types=("static",), duration_s=3600.0).runs()
    with pytest.raises(BadInput, match="beyond 50 degC"):
        StationBounds.of_runs(runs, limits, most_deg_c=70.0)
    assert StationBounds.of_runs(runs, limits, most_deg_c=40.0).sources["most_deg_c"] == "given"


def plan(by_truth: dict[str, float]) -> TestPlan:
    test = CandidateTest(name="tumble", what=Bilingual("six positions", "六位置翻滚"))
    power = sum(by_truth.values()) / len(by_truth)
    return TestPlan(
        test=test, hours=2.0, power=power, separation=30.0, by_truth=by_truth, assured=min(by_truth.values())
    )


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_power_is_given_for_each_truth(language: str) -> None:
    words = Wording("zh" if language == "zh" else "en")
    found = NextTest(
        question="which",
        rivals=("gravity_i", "gravity_i_squared"),
        plans=(plan({"gravity_i": 0.93, "gravity_i_squared": 0.91}),),
        bounds=StationBounds(least_deg_c=-10.0, most_deg_c=50.0, sources={"least_deg_c": "station"}),
    )
    sentence = next_test_sentence(found, words)
    assert "93%" in sentence
    assert "91%" in sentence
    (row,) = next_test_rows(found, words).rows
    assert "0.91" in row
    bounds = bounds_sentence(found, words)
    assert bounds is not None
    assert ("station file" if language == "en" else "试验台文件") in bounds


def test_the_least_power_of_a_likely_truth_counts() -> None:
    assert plan({"gravity_i": 0.95, "gravity_o": 0.92}).is_enough
    assert not plan({"gravity_i": 1.0, "gravity_o": 0.85}).is_enough


def test_unexplained_noise_is_asked_for_at_rest() -> None:
    found = NextTest(question="excess", rivals=(AT_REST,), plans=(plan({AT_REST: 0.95, "driven": 0.999}),))
    assert "95% if it is there at rest" in next_test_sentence(found, Wording("en"))
