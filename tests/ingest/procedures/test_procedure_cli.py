"""The commands `gyrofleet procedure ...` as a user types them."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from ingest.commands.procedure import procedure
from ingest.procedures.file import ready_names
from ingest.procedures.procedure import load_procedure


def run(*arguments: object, code: int = 0) -> str:
    done = CliRunner().invoke(procedure, [str(each) for each in arguments])
    assert done.exit_code == code, done.output
    return done.output


def test_the_list_names_all_in_two_languages() -> None:
    listed = json.loads(run("list", "--json"))
    assert [each["name"] for each in listed] == list(ready_names())
    assert {"en", "zh"} == set(listed[0]["names"])
    text = run("list")
    assert all(name in text for name in ready_names())
    assert "零偏温度灵敏度" in text


def test_show_prints_every_step_with_what_was_chosen() -> None:
    shown = json.loads(run("show", "scale_factor", "--set", "max_rate_deg_per_s=200", "--json"))
    assert shown["parameters"]["max_rate_deg_per_s"]["value"] == 200.0
    assert max(step["settings"].get("rate", 0.0) for step in shown["steps"]) == 200.0
    assert [step["number"] for step in shown["steps"]] == list(range(1, 26))
    text = run("show", "scale_factor", "--set", "max_rate_deg_per_s=200")
    assert "rate -200" in text
    assert "rest_after" in text
    assert "安装陀螺仪" in text


def test_check_says_what_a_station_lacks() -> None:
    assert "rate -300 to 300 deg/s" in run("check", "scale_factor")
    assert json.loads(run("check", "scale_factor", "--settings", "rate,angle", "--json"))["station_checked"]
    reported = run("check", "scale_factor", "--settings", "temperature", code=1)
    assert "no instrument of the station has that setting" in reported
    assert "'speed' is no setting" in run("check", "scale_factor", "--settings", "speed", code=1)


def test_check_says_what_lies_beyond_an_instrument(tmp_path: Path) -> None:
    """The chamber reaches -40 to 85 degC."""
    (tmp_path / "station.toml").write_text(
        '[station]\nsite = "s"\nname = "n"\n[instruments.chamber]\nkind = "temperature_chamber"\n'
        'resource = "TCPIP::127.0.0.1::1::SOCKET"\n'
    )
    own = 'name = "own"\nnames = {{en = "Own", zh = "自定义"}}\n[[step]]\nname = "still"\nrecord_s = 90\n{}\n'
    for celsius, code in ((60, 0), (300, 1)):
        (tmp_path / "own.toml").write_text(own.format(f"temperature_deg_c = {celsius}"), encoding="utf-8")
        said = run("check", tmp_path / "own.toml", "--station", tmp_path / "station.toml", code=code)
        assert ("may be set to -40 to 85 degC" in " ".join(said.split())) == (code == 1)


def test_a_file_of_ones_own_works_where_a_name_does(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    text = 'name = "own"\nnames = {en = "Own", zh = "自定义"}\n[[step]]\nname = "still"\nrecord_s = 90\n'
    path.write_text(text, encoding="utf-8")
    assert "own: 1 steps" in run("check", path)
    assert json.loads(run("estimate-time", path, "--json"))["total_s"] == 90.0
    path.write_text(text + "setle_s = 3\n", encoding="utf-8")
    error = json.loads(run("check", path, "--json", code=1))["error"]
    assert error["kind"] == "BadInput"
    assert "own.toml: Object contains unknown field `setle_s` - at `$.step[0]`" in error["message"]


def test_the_estimate_is_the_sum_of_its_parts() -> None:
    found = json.loads(run("estimate-time", "bias_temperature_sensitivity", "--chamber", 1, "--prompt", 0, "--json"))
    assert found["total_s"] == pytest.approx(sum(each["total_s"] for each in found["parts"]))
    assert found["total"]["record_s"] == 7 * 3600.0
    # 23 to -40 and up to 60 degC at 1 degC/min
    assert found["total"]["ramp_s"] == pytest.approx((63 + 100) * 60.0)
    assert found["total_s"] == load_procedure("bias_temperature_sensitivity").duration_s() + (163 * 30.0) - 300.0
    assert "in all" in run("estimate-time", "bias_temperature_sensitivity")


@pytest.mark.parametrize("given", ["max_rate_deg_per_s", "=3", "max_rate_deg_per_s="])
def test_a_choice_without_a_value_is_refused(given: str) -> None:
    assert "write it as NAME=VALUE" in run("show", "scale_factor", "--set", given, code=1)


def test_a_choice_given_twice_is_refused() -> None:
    assert "given twice" in run("show", "static_bias", "--set", "warm_up_s=1", "--set", "warm_up_s=2", code=1)
