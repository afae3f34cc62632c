"""Which units are released, and which supplies then power nobody."""

from pathlib import Path

import pytest

from ingest.station.bench import StationBench
from ingest.station.releases import Releases
from ingest.station.run_limits import LimitReport, RunLimits
from ingest.station.station import load_station
from ingest.station.units_file import UnitEntry
from storage.specifications.live_limits import UnitLimits
from stream.events import EarlyDecision, Limit

S = 10**9
LIMIT = Limit(characteristic="allan_deviation", signal="rate", tau_s=10.0, upper=1.0, unit_of_measure="deg/h")
OTHER = Limit(characteristic="bias_stability", signal="rate", tau_s=1.0, upper=1.0, unit_of_measure="deg/h")
STATION = """
[station]
site = "plant"
name = "bench"
[instruments.left]
kind = "power_supply"
max_voltage_v = 30.0
max_current_a = 3.0
resource = "TCPIP::127.0.0.1::5025::SOCKET"
[instruments.right]
kind = "power_supply"
max_voltage_v = 30.0
max_current_a = 3.0
resource = "TCPIP::127.0.0.1::5026::SOCKET"
[slots.A1]
power = "left"
[slots.A2]
power = "left"
[slots.B1]
power = "right"
[slots.B2]
power = "right"
"""


def decision(unit: str, limit: Limit, outcome: str, t_s: float = 100.0, fraction: float = 0.3) -> EarlyDecision:
    return EarlyDecision(
        run="r", t_ns=round(t_s * S), unit=unit, signal="rate", limit=limit, outcome=outcome, rule="look",
        error_probability=0.01, looked_at_fraction=fraction, reason="", reason_zh="",
    )  # fmt: skip


class Case:
    def __init__(self, folder: Path) -> None:
        (folder / "station.toml").write_text(STATION)
        station = load_station(folder / "station.toml")
        self.told: list[str] = []
        self.decisions = LimitReport(self.told.append)
        self.decisions.begin_record(0)
        limits = {
            "U1": UnitLimits("s-A", (LIMIT, OTHER), ()),
            "U2": UnitLimits("s-A", (LIMIT,), ()),
            "U3": UnitLimits("s-A", (LIMIT,), ("bias",)),
        }
        entries = [UnitEntry(serial=f"U{i}", slot=slot) for i, slot in enumerate(("A1", "A2", "B1", "B2"), 1)]
        bench = StationBench(station, station.make_instruments(station.make_clock()))
        self.releases = Releases(station, bench, entries, RunLimits(limits, True, ()), self.decisions)

    def due(self, *released: str) -> dict[str, str]:
        found = self.releases.due(released, 130 * S, 30 * S, 400.0)
        return {each.unit: each.verdict.value for each in found if each.recorded_s == 100.0 and each.saved_s == 300.0}


@pytest.fixture
def case(tmp_path: Path) -> Case:
    return Case(tmp_path)


def test_one_failure_releases_and_a_pass_needs_all_limits(case: Case) -> None:
    case.decisions.see(decision("U1", LIMIT, "PASS"))
    assert case.due() == {}
    case.decisions.see(decision("U1", OTHER, "UNDECIDED"))
    assert case.due() == {}
    case.decisions.see(decision("U1", OTHER, "PASS"))
    case.decisions.see(decision("U2", LIMIT, "FAIL"))
    assert case.due() == {"U1": "PASS", "U2": "FAIL"}
    assert case.due("U1") == {"U2": "FAIL"}


def test_what_is_judged_after_the_run_keeps_a_good_unit(case: Case) -> None:
    case.decisions.see(decision("U3", LIMIT, "PASS"))
    assert case.due() == {}
    case.decisions.see(decision("U3", LIMIT, "FAIL"))
    assert case.due() == {"U3": "FAIL"}
    assert [*case.releases.remarks()] == [
        "recorded to the end, since they have no limits: U4",
        "released early only as FAIL: U3; the whole record is needed for bias",
    ]


def test_a_look_at_the_end_or_at_an_earlier_record_releases_nobody(case: Case) -> None:
    case.decisions.see(decision("U2", LIMIT, "PASS", fraction=1.0))
    assert case.due() == {}
    case.decisions.see(decision("U2", LIMIT, "PASS"))
    case.decisions.begin_record(500 * S)  # begun again
    case.decisions.see(decision("U2", LIMIT, "PASS", t_s=499.0))
    assert case.due() == {}


def test_a_supply_is_idle_once_all_its_units_are_released(case: Case) -> None:
    assert case.releases.idle_supplies(()) == []
    assert case.releases.idle_supplies(("U1", "U3")) == []
    assert case.releases.idle_supplies(("U1", "U2", "U3")) == ["left"]
    assert case.releases.without_power(["left"]) == ["U1", "U2"]


def test_decisions_of_a_record_that_is_measured_again_are_not_announced(case: Case) -> None:
    resumed = LimitReport(case.told.append)
    resumed.see(decision("U2", LIMIT, "FAIL"))  # replayed
    assert case.told == []
    resumed.begin_record(500 * S)
    for _ in range(2):
        resumed.see(decision("U2", LIMIT, "PASS", t_s=600.0))
    assert len(case.told) == 1
    resumed.begin_record(900 * S)
    resumed.see(decision("U2", LIMIT, "PASS", t_s=950.0))
    assert len(case.told) == 2
