"""`gyrofleet diagnose` on published and measured records."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ingest.procedures.procedure import load_procedure

HIT_2012 = Path(__file__).resolve().parents[2] / "golden" / "hit2012_table1.csv"
HIT_MODEL = "rate = bias + channel:table_rate + cross_axis_o + cross_axis_s + fixture_cos + fixture_sin"


def test_hit_2012_lacks_something_that_the_table_cannot_name(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    assert gyrofleet("import", HIT_2012, "--unit", "HRG", "--store", "S").code == 0
    found = gyrofleet(
        "diagnose", "--unit", "HRG", "--model", HIT_MODEL, "--store", "S", "--block", "60s", "--json"
    ).json
    # gravity along the spin axis, its square and that of the output axis are the same column in these positions
    members = {each["name"] for each in (*found["effects"], *found["confounded"])}
    assert found["verdict"] == "confounded"
    assert {"gravity_s", "gravity_s_squared", "gravity_o_squared"} <= members
    assert all(each["separating_test"] for each in found["confounded"])
    assert found["holdout"]["accepted"]
    before, after = (found["error"][part]["rms_60s"] for part in ("before", "after"))
    assert before == pytest.approx(0.82e-3, rel=0.1)  # V, the speed that was held out
    assert after < 0.5 * before
    assert any("remounted" in note["text"] for note in found["reduction"])


@pytest.mark.long
def test_the_next_test_of_hit_2012_mounts_each_position_several_times(
    gyrofleet: Callable[..., Any], tmp_path: Path
) -> None:
    gyrofleet("import", HIT_2012, "--unit", "HRG", "--store", "S")
    path = tmp_path / "next.toml"
    ask = ("diagnose", "--unit", "HRG", "--model", HIT_MODEL, "--store", "S", "--block", "60s")
    asked = gyrofleet(*ask, "--write-procedure", path, "--json").json["next_test"]
    assert "function_of_position" in asked["rivals"]
    first = asked["plans"][0]
    assert first["procedure"].startswith("remounting_")
    # five positions, twice or more, ten minutes each
    assert first["hours"] > 2 * 5 / 6
    assert first["power"] >= 0.9
    assert set(first["by_truth"]) == set(asked["rivals"])
    mounted = [step.words.position for step in load_procedure(path).steps()]
    words = {"alpha0_beta0", "alpha0_beta180", "alpha0_beta90", "alpha180_beta180", "alpha90_beta180"}
    assert min(mounted.count(word) for word in words) >= 2


@pytest.mark.long
@pytest.mark.measured
def test_adis16405_has_no_reproducible_effect_of_time_on_y_and_z(gyrofleet: Callable[..., Any], measured: Path) -> None:
    files = [measured / f"adis16405_static_run{number}.parquet" for number in (1, 2)]
    assert gyrofleet("import", *files, "--unit", "ADIS16405", "--store", "S").code == 0
    for signal in ("rate_y", "rate_z"):
        found = gyrofleet(
            "diagnose", "--unit", "ADIS16405", "--model", f"{signal} = bias", "--store", "S", "--json"
        ).json
        assert found["verdict"] in ("nothing_missing", "unreplicated")
        assert found["effects"] == []


@pytest.mark.long
@pytest.mark.measured
def test_psim_x_lacks_a_thermal_transient_of_a_kind_that_the_record_cannot_tell(
    gyrofleet: Callable[..., Any], measured: Path
) -> None:
    gyrofleet("import", measured / "psim_cold_chamber.parquet", "--unit", "PSIM", "--store", "S")
    found = gyrofleet(
        "diagnose", "--unit", "PSIM", "--model", "rate_x = bias + temperature", "--store", "S", "--json"
    ).json
    assert found["verdict"] == "confounded"
    assert found["replication"] == "within_run"
    assert found["holdout"] is None
    together = {each["name"] for each in (*found["effects"], *found["confounded"])}
    assert {"thermal_lag", "warm_up", "thermal_hysteresis"} <= together
    assert all(each["separating_test"] for each in found["confounded"])
