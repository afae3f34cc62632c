"""A dependence on two channels that no effect of the library has: a black box finds it, and the verdict says so."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Outcome

Command = Callable[..., Outcome]
MODEL = ("--model", "rate = bias + temperature")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, run_command: Command) -> Path:
    """Eight runs of two units, of which N-1 is imported; the bias of X-1 depends on two signs together."""
    folder = tmp_path_factory.mktemp("signs")
    rng = np.random.default_rng(5)
    t_s = np.arange(0, 7200, 10.0)
    for unit, size in (("X-1", 0.25), ("N-1", 0.0)):
        names = []
        for run in range(8):
            first, second = rng.choice([1800, 2400, 3000]), rng.choice([700, 900, 1100])
            temperature = 25 + 15 * np.sin(2 * np.pi * t_s / first + rng.uniform(0, 6))
            supply = 12 + 0.5 * np.sign(np.sin(2 * np.pi * t_s / second + rng.uniform(0, 6)))
            supply += rng.normal(0, 0.02, t_s.size)
            rate = 3 + rng.normal(0, 0.2) + size * np.sign((temperature - 25) * (supply - 12))
            rate += rng.normal(0, 0.4, t_s.size)
            rows = zip(t_s, rate, temperature, supply, strict=True)
            text = "\n".join(f"{a:g},{b:.5f},{c:.3f},{d:.4f}" for a, b, c, d in rows)
            names.append(f"{unit}-{run}.csv")
            (folder / names[-1]).write_text(f"time[s],rate[deg/h],temperature[degC],supply_voltage[V]\n{text}")
    assert run_command("import", *names, "--unit", "N-1", "--store", "S", cwd=folder).code == 0
    return folder / "S"


@pytest.fixture(scope="module")
def both(store: Path, run_command: Command) -> Path:
    """The store once X-1 is imported, which no test of the gate asks for."""
    names = sorted(path.name for path in store.parent.glob("X-1-*.csv"))
    assert run_command("import", *names, "--unit", "X-1", "--store", "S", cwd=store.parent).code == 0
    return store


@pytest.mark.long
def test_what_no_effect_explains_is_named_with_its_channels(gyrofleet: Command, both: Path, tmp_path: Path) -> None:
    ask = ("diagnose", "--store", both, "--unit", "X-1", *MODEL)
    assert gyrofleet(*ask, "--no-explainable", "--json").json["explainable"] is None
    found = gyrofleet(*ask, "--json").json
    assert found["verdict"] == "unexplained"
    left = found["explainable"]
    assert sorted(left["channels"]) == ["supply_voltage", "temperature"]
    assert 0.3 < left["lo"] == left["at_least"] < left["value"] < left["hi"] <= 1.0
    report = tmp_path / "report.html"
    out = gyrofleet(*ask, "--report", report, "--lang", "zh").out
    assert "temperature、supply_voltage" in out or "supply_voltage、temperature" in out
    assert "剩余误差" in report.read_text()


def test_in_noise_there_is_nothing_to_explain(gyrofleet: Command, store: Path) -> None:
    found = gyrofleet("diagnose", "--store", store, "--unit", "N-1", *MODEL, "--explainable", "--json").json
    assert found["verdict"] == "nothing_missing"
    assert (found["explainable"]["significant"], found["explainable"]["channels"]) == (False, [])


@pytest.mark.long
def test_of_several_units_it_is_tried_where_it_is_asked_for(gyrofleet: Command, both: Path) -> None:
    ask = ("diagnose", "--store", both, "--fleet", *MODEL, "--json")
    assert [each["explainable"] for each in gyrofleet(*ask).json["units"].values()] == [None, None]
    units = gyrofleet(*ask, "--explainable").json["units"]
    assert [units[name]["verdict"] for name in ("X-1", "N-1")] == ["unexplained", "nothing_missing"]
