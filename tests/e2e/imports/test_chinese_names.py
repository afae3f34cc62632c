"""What Chinese names and words mean behind the import: outputs, temperatures, units, starts, files of Windows."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

LIMITS = """name = "规范"
revision = "A"
valid_from = 2026-01-01
[[limit]]
metric = "bias"
unit_of_measure = "度每小时"
lower = -1
upper = 1
"""


def imported(gyrofleet: Callable[..., Any], path: Path, titles: str, cells: str, *words: str) -> Any:
    rows = [titles, *(cells.format(at=at, v=0.1 + at % 7 / 1000) for at in range(40))]
    path.write_text("\n".join(rows), encoding="utf-8")
    done = gyrofleet("import", path.name, "--unit", "U", "--store", "S", "--json", *words)
    assert done.code == 0, done.err
    return done.json["files"][0]


def test_g_is_gravity_in_columns_of_accelerations(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    titles = "时间(s),X加计(g),Y加速度(g),加速度计Z(g),X陀螺(度每小时)"
    file = imported(gyrofleet, tmp_path / "r.csv", titles, "{at},0.0,{v},1.0,{v}")
    found = {each["signal"]: each["unit_of_measure"] for each in file["signals"]}
    assert found == {"X加计": "g_0", "Y加速度": "g_0", "加速度计Z": "g_0", "X陀螺": "deg/h"}


def test_temperatures_in_du_and_units_in_words(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    titles = "时间(s),箱温(度),Temp (deg C),温度(C),陀螺输出电压(毫伏),光纤陀螺X(弧度每秒),转速(转每分)"
    file = imported(gyrofleet, tmp_path / "r.csv", titles, "{at},25,25,25,{v},{v},{v}")
    found = {each["signal"]: each["unit_of_measure"] for each in file["signals"]}
    assert found == {
        "箱温": "degC", "Temp": "degC", "温度": "degC", "陀螺输出电压": "mV", "光纤陀螺X": "rad/s", "转速": "rpm",
    }  # fmt: skip


def test_a_prefix_in_the_wrong_case_is_refused(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    (tmp_path / "r.csv").write_text("time[s],陀螺输出(MV)\n0,1\n1,2\n", encoding="utf-8")
    done = gyrofleet("import", "r.csv", "--unit", "U", "--store", "S")
    assert done.code != 0
    assert "unit 'MV' is 1e+06 V: M is mega and G is giga; write 'mV'" in done.err


def test_speeds_of_motors_and_tables_are_no_outputs(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    step = ("--procedure", "static_bias", "--position", "IRA_up", "--latitude", "39.9")
    titles = "时间(s),电机转速(转/分),内框角速率(°/s),信号甲(V)"
    file = imported(gyrofleet, tmp_path / "r.csv", titles, "{at},3000,{v},{v}", *step)
    assert any("no signal is taken for the output of a gyro: if 信号甲 is one" in each for each in file["remarks"])
    assert gyrofleet("metrics", "--metric", "bias", "--store", "S", "--json").json == []


def test_a_scale_factor_without_rates_is_named(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    imported(gyrofleet, tmp_path / "r.csv", "时间(s),陀螺输出(V)", "{at},{v}", "--procedure", "scale_factor")
    told = gyrofleet("metrics", "--store", "S", "--lang", "zh").err
    assert "程序 scale_factor 的步骤没有 rate_command（指令角速率），不用于任何特性" in told


def test_an_output_and_a_temperature_by_their_chinese_names(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    step = ("--procedure", "static_bias", "--position", "IRA_up", "--latitude", "39.9")
    imported(gyrofleet, tmp_path / "r.csv", "时间(s),陀螺输出[V],陀螺温度(℃)", "{at},{v},25.5", *step)
    (row, *_) = gyrofleet("metrics", "--metric", "bias", "--store", "S", "--json").json
    assert row["signal"] == "陀螺输出"
    assert "no scale factor for an output in V" in row["reason"]
    (means, *_) = gyrofleet(
        "sql", "select temperature from step_means where signal = '陀螺输出'", "--store", "S", "--json"
    ).json
    assert means["temperature"] == pytest.approx(25.5)


def test_a_file_without_an_output_is_warned_of(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    step = ("--procedure", "static_bias", "--position", "IRA_up")
    file = imported(gyrofleet, tmp_path / "r.csv", "时间(s),信号甲(V),温度(℃)", "{at},{v},25.5", *step)
    assert any("no signal is taken for the output of a gyro: if 信号甲 is one" in each for each in file["remarks"])
    told = gyrofleet("metrics", "--unit", "U", "--store", "S", "--lang", "zh")
    assert "信号 信号甲（V）未作为陀螺输出：请命名为 rate" in told.err


@pytest.mark.parametrize("start", ["2026/11/3 8:05", "2026年11月3日 8:05"])
def test_a_start_is_written_as_columns_are(start: str, tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    imported(
        gyrofleet,
        tmp_path / "r.csv",
        "时间(s),rate[deg/h]",
        "{at},{v}",
        "--start",
        start,
        "--time-zone",
        "Asia/Shanghai",
    )
    (row,) = gyrofleet("sql", "select min(t_ns) as t_ns from samples", "--store", "S", "--json").json
    assert row["t_ns"] == 1793664300 * 10**9  # 2026-11-03T00:05:00Z


def test_toml_files_of_windows(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    (tmp_path / "bom.toml").write_bytes(b"\xef\xbb\xbf" + LIMITS.encode())
    done = gyrofleet("limits", "add", "bom.toml", "--store", "S")
    assert done.code == 0, done.err + done.out
    (tmp_path / "gbk.toml").write_bytes(LIMITS.encode("gbk"))
    refused = gyrofleet("limits", "add", "gbk.toml", "--store", "S")
    assert refused.code != 0
    assert "line 1 is not UTF-8 text but perhaps GBK, as of a Chinese Windows: save the file as UTF-8" in refused.err


def test_resistances_in_chinese(gyrofleet: Callable[..., Any]) -> None:
    words = (
        "check",
        "--unit",
        "U",
        "--item",
        "electrical",
        "--value",
        "120",
        "--lower",
        "100",
        "--by",
        "Li",
        "--store",
        "S",
    )
    assert gyrofleet(*words, "--unit-of-measure", "兆欧").code == 0
    refused = gyrofleet(*words, "--unit-of-measure", "雷")
    assert "known units are: deg/s, deg/h, rad/s, g_0, m/s^2, degC, V, mA, ohm, Mohm" in refused.err
