"""Tables as Chinese programs write them: titles, units, encodings; and units of measure with strange characters."""

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ingest.tables.units import column_unit
from stream.errors import BadInput, UnknownUnit
from stream.quantities import check_unit, conversion, result_factor

ROWS = [[f"{at / 10:.1f}", f"{10 + at % 7}", f"{25 + at / 1000:.3f}", "28.0"] for at in range(300)]


def write(path: Path, titles: list[str], rows: list[list[str]] = ROWS, encoding: str = "utf-8") -> None:
    text = io.StringIO()
    csv.writer(text).writerows([titles, *(row[: len(titles)] for row in rows)])
    path.write_bytes(text.getvalue().encode(encoding))


@pytest.mark.parametrize(
    ("titles", "encoding", "named"),
    [
        ("时间(s),角速率(°/h),温度(℃),电压/V", "gbk", "角速率"),
        ("时间（s）,陀螺输出（°／h）,温度（℃）,电压／V", "utf-8-sig", "陀螺输出"),
        ("采样时间（秒）,角速率（度/小时）,温度（摄氏度）,电压（伏）", "gb18030", "角速率"),
        ("time[s],角速率[°/h],温度[degC],电压[V]", "gbk", "角速率"),
    ],
    ids=["GBK", "full width", "words", "brackets"],
)
@pytest.mark.in_gate("full width", "words")
def test_titles_and_encodings(
    titles: str, encoding: str, named: str, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    write(tmp_path / "甲.csv", titles.split(","), encoding=encoding)
    done = gyrofleet("import", "甲.csv", "--unit", "甲-1", "--store", "S", "--json")
    assert done.code == 0, done.err
    signals = {each["signal"]: each for each in done.json["files"][0]["signals"]}
    assert signals.keys() == {named, "温度", "电压"}
    assert {each["in_lake"] for each in signals.values()} == {300}
    assert {each["sample_interval_s"] for each in signals.values()} == {0.1}
    assert conversion(signals[named]["unit_of_measure"], "deg/h") == (1.0, 0.0)
    assert (signals["温度"]["unit_of_measure"], signals["电压"]["unit_of_measure"]) == ("degC", "V")
    remarks = " ".join(done.json["files"][0]["remarks"])
    assert ("read as GB18030" in remarks) == (encoding.startswith("gb"))
    assert "temperature under the name temperature" in remarks  # it is not left out of the metrics in silence


def test_units_in_chinese_words_are_put_together(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    """Prefixes and powers, as files of other programs have them."""
    units = {"角速率": "毫度/秒", "漂移": "度/小时/℃", "加速度": "米每二次方秒", "标度": "度/秒/伏",
             "安装角": "微弧度", "磁场": "纳特斯拉"}  # fmt: skip
    titles = ["时间(秒)", *(f"{name}({unit})" for name, unit in units.items())]
    write(tmp_path / "甲.csv", titles, [[str(at)] + [str(at % 7)] * len(units) for at in range(9)])
    done = gyrofleet("import", "甲.csv", "--unit", "甲-1", "--store", "S", "--json")
    assert done.code == 0, done.err
    found = {each["signal"]: each["unit_of_measure"] for each in done.json["files"][0]["signals"]}
    letters = ["mdeg/s", "deg/h/degC", "m/s^2", "deg/s/V", "urad", "nT"]
    assert found == dict(zip(units, letters, strict=True))


def test_a_unit_with_a_slash_needs_no_brackets(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    ends = {"陀螺输出 °/h": "°/h", "陀螺2 deg/s": "deg/s", "转速 r/min": "rpm", "加计输出 m/s": "m/s",
            "X轴 度/小时": "deg/h", "角速率°/h": "°/h", "gyro output deg/s": "deg/s", "电压/V": "V",
            "转速2/(°/s)": "°/s"}  # fmt: skip
    write(tmp_path / "甲.csv", ["时间/s", *ends], [[str(at)] + [str(at % 7)] * len(ends) for at in range(9)])
    done = gyrofleet("import", "甲.csv", "--unit", "甲-1", "--store", "S", "--json")
    assert done.code == 0, done.err
    found = {each["signal"]: each["unit_of_measure"] for each in done.json["files"][0]["signals"]}
    names = ["陀螺输出", "陀螺2", "转速", "加计输出", "X轴", "角速率", "gyro_output", "电压", "转速2"]
    assert found == dict(zip(names, ends.values(), strict=True))


def test_a_unit_of_time_on_what_is_no_time_is_refused(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    write(tmp_path / "甲.csv", ["时间/s", "陀螺输出/h"])
    words = ("import", "甲.csv", "--unit", "甲-1", "--store", "S", "--json")
    refused = gyrofleet(*words)
    assert refused.code != 0
    remedy = "陀螺输出/h=陀螺输出[deg/h]"
    assert "a unit of time, and is no time" in refused.err + refused.out
    assert f"--rename '{remedy}'" in refused.err + refused.out
    done = gyrofleet(*words, "--rename", remedy)
    assert [each["unit_of_measure"] for each in done.json["files"][0]["signals"]] == ["deg/h"]


@pytest.mark.parametrize(
    ("step_s", "decimals", "title"),
    [(1, 9, "时间"), (1, 9, "时间(s)"), (0.01, 10, "t[s]"), (60, 6, "时间(s)"), (3600, 5, "时间(d)")],
)
@pytest.mark.in_gate("1-9-时间(s)")
def test_days_of_excel_are_no_seconds(
    step_s: float, decimals: int, title: str, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    days = [46329 + (29_100 + at * step_s) / 86_400 for at in range(60)]
    write(
        tmp_path / "甲.csv",
        [title, "角速率(°/h)"],
        [[f"{day:.{decimals}f}", str(at % 5)] for at, day in enumerate(days)],
    )
    refused = gyrofleet("import", "甲.csv", "--unit", "甲-1", "--store", "S")
    assert refused.code != 0
    assert "days as Excel counts them: in Excel, format the column as yyyy-mm-dd hh:mm:ss.000" in refused.err


@pytest.mark.parametrize("step_s", [0.0001, 0.000125, 0.0025, 0.01, 1 / 60, 1.0, 10.0])
@pytest.mark.in_gate("0.0025")
def test_seconds_of_a_day_are_no_days(step_s: float, tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    rows = [[f"{46_329.0 + at * step_s:.7f}", str(at % 5)] for at in range(60)]
    write(tmp_path / "甲.csv", ["时间(s)", "角速率(°/h)"], rows)
    done = gyrofleet("import", "甲.csv", "--unit", "甲-1", "--store", "S")
    assert done.code == 0, done.err


@pytest.mark.parametrize(
    ("cell", "says"),
    [
        ("{at}", "--rename '时间=time[s]'"),
        ("202611030805{at:02d}", "write it as 2026-11-03 08:05:00"),
        ("05:{at:02d}.0", "minutes and seconds without their hour"),
        ("46329.3368{at:05d}", "days as Excel counts them"),
    ],
)
def test_a_time_without_unit_gets_the_remedy_for_what_it_holds(
    cell: str, says: str, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    write(tmp_path / "甲.csv", ["时间", "角速率(°/h)"], [[cell.format(at=at), str(at % 5)] for at in range(50)])
    refused = gyrofleet("import", "甲.csv", "--unit", "甲-1", "--store", "S")
    assert refused.code != 0
    assert says in refused.err


def imported(gyrofleet: Callable[..., Any], path: Path, text: str, *words: str) -> tuple[dict[str, Any], str]:
    """Signals of a file by name, and its remarks."""
    path.write_bytes(text.encode("gb18030"))
    done = gyrofleet("import", path.name, "--unit", "甲-1", "--store", "S", "--json", *words)
    assert done.code == 0, done.err
    (file,) = done.json["files"]
    return {each["signal"]: each for each in file["signals"]}, " ".join(file["remarks"])


def refusal(gyrofleet: Callable[..., Any], path: Path, text: str, *words: str) -> str:
    path.write_bytes(text.encode("gb18030"))
    refused = gyrofleet("import", path.name, "--unit", "甲-1", "--store", "S", *words)
    assert refused.code != 0
    return str(refused.err)


TABLE = "时间(s),陀螺输出(°/h){end}\r\n" + "".join(f"{at},0.{at}{{end}}\r\n" for at in range(9))


@pytest.mark.parametrize("lines", [
    "产品编号：陀螺-甲-001,,\r\n采样周期：1s,,\r\n",
    "产品编号,陀螺-甲-001,\r\n采样周期,1s,\r\n,,\r\n", "测试：李伟,,\r\n",
])  # fmt: skip
def test_lines_before_the_header_that_excel_filled_with_commas(
    lines: str, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    signals, remarks = imported(
        gyrofleet, tmp_path / "甲.csv", lines + TABLE.format(end=",25").replace("h),25", "h),温度(℃)")
    )
    assert signals.keys() == {"陀螺输出", "温度"}
    assert "before the header left out" in remarks


def test_columns_that_hold_no_samples_are_left_out_with_a_note(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    signals, remarks = imported(gyrofleet, tmp_path / "甲.csv", TABLE.format(end=",,"))
    assert signals.keys() == {"陀螺输出"}
    assert "column 3 has no title and no cells: it is left out" in remarks
    text = "序号,时间(s),陀螺输出(°/h),备注\n" + "".join(
        f"{at + 1},{at},0.{at},{'换班' * (at == 5)}\n" for at in range(9)
    )
    signals, remarks = imported(gyrofleet, tmp_path / "乙.csv", text)
    assert signals.keys() == {"陀螺输出"}
    assert "'序号' numbers the rows: it is left out" in remarks
    assert "'备注' holds remarks: it is left out" in remarks
    # a cell far below in a column without a title is no remark
    late = TABLE.format(end=",") + "".join(f"{at},0.1,\r\n" for at in range(9, 99)) + "99,0.1,5\r\n"
    assert "expected no cell in a column without a title" in refusal(gyrofleet, tmp_path / "丙.csv", late)


@pytest.mark.parametrize(("title", "proposed"), [
    ("时间 s", "time[s]"), ("光功率uW", "光功率[uW]"), ("温度℃", "温度[degC]"), ("温度", "温度[degC]"),
    ("产品编号", "unit"),
])  # fmt: skip
def test_titles_get_proposals_that_work(
    title: str, proposed: str, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    rest = "" if title == "时间 s" else ",时间(s)"
    text = f"{title},角速率(°/h){rest}\n" + "".join(f"{at},0.1{rest and f',{at}'}\n" for at in range(9))
    assert f"--rename '{title}={proposed}'" in refusal(gyrofleet, tmp_path / "甲.csv", text)
    (tmp_path / "甲.csv").write_text(text, encoding="utf-8")
    of_unit = () if title == "产品编号" else ("--unit", "甲-1")
    done = gyrofleet("import", "甲.csv", *of_unit, "--store", "S", "--rename", f"{title}={proposed}")
    assert done.code == 0, done.err


def test_a_remark_in_the_first_row(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    rows = "".join(f"{at + 1},{at},0.{at},{'' if at else '开始'}\n" for at in range(9))
    text = f"静态测试记录,,,\n产品,FOG,,\n序号,时间,X轴陀螺,备注\n,s,°/h,\n{rows}"
    signals, remarks = imported(gyrofleet, tmp_path / "甲.csv", text)
    assert signals["X轴陀螺"]["unit_of_measure"] == "°/h"
    assert "2 lines before the header left out" in remarks


def test_titles_that_excel_merged_are_named_by_their_place(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    text = "时间(s),陀螺(°/h),,\n" + "".join(f"{at},0.1,0.2,0.3\n" for at in range(9))
    held = refusal(gyrofleet, tmp_path / "甲.csv", text)
    assert "column 3 has no title" in held
    assert "column 4 has no title" in held


def test_numbers_in_full_width_characters_are_read(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    text = "时间（ｓ）,陀螺输出（°／ｈ）,电压(V)\n０,－０．５,−1.5\n１,０．５,1.5\n２,０．６,−2.5\n"
    signals, remarks = imported(gyrofleet, tmp_path / "甲.csv", text)
    assert signals.keys() == {"陀螺输出", "电压"}
    assert "full-width digits and minus signs of numbers are read as usual ones" in remarks
    found = gyrofleet(
        "sql", "select signal, min(value) as least from samples group by signal order by 1", "--store", "S", "--json"
    )
    assert [row["least"] for row in found.json] == [-2.5, -0.5]


def test_what_makes_cells_no_numbers_is_named(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    path = tmp_path / "甲.csv"
    assert "cells stand between '，'" in refusal(gyrofleet, path, "时间(s)，角速率(°/h)\n0，1\n1，2\n")
    held = refusal(gyrofleet, path, "时间(s),角速率\n0,0.3°/h\n1,0.4°/h\n")
    assert "numbers with their unit, as '0.3°/h' (write the unit in the title, as [°/h])" in held
    held = refusal(gyrofleet, path, '时间(s),角速率(脉冲)\n0,"1,234,603"\n1,"1,234,606"\n')
    assert "numbers whose thousands are separated, as '1,234,603'" in held


def test_time_stamps_under_a_chinese_title(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    rows = [[f"2026-11-28 08:00:{at // 10:02d}.{at % 10}", str(at % 5)] for at in range(300)]
    write(tmp_path / "甲.csv", ["时间", "角速率(°/h)"], rows)
    words = ("import", "甲.csv", "--unit", "甲-1", "--store", "S", "--json")
    assert gyrofleet(*words, "--time-zone", "Asia/Shanghai").json["files"][0]["date_known"]
    # the same rows at another time are not there twice
    moved = gyrofleet(*words, "--time-zone", "UTC")
    assert moved.code != 0
    assert "has this very file at other times" in moved.err + moved.out
    again = gyrofleet(*words, "--time-zone", "Asia/Shanghai")
    assert (again.code, again.json["files"][0]["signals"][0]["added"]) == (0, 0)


def test_a_title_without_unit_gets_advice_that_works(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    write(tmp_path / "甲.csv", ["时间(s)", "角速率(°/h)", "状态"])
    words = ("import", "甲.csv", "--unit", "甲-1", "--store", "S", "--json")
    refused = gyrofleet(*words)
    assert refused.code != 0
    advice = "状态=状态[1]"
    assert f"--rename '{advice}'" in refused.err + refused.out
    assert gyrofleet(*words, "--rename", advice).code == 0


@pytest.mark.parametrize("text", ["°/h?", "°/h，", "deg/h!", "°/√h/", "°/h§", "m/s²☃"])
def test_a_unit_with_characters_that_no_unit_has_is_none(text: str) -> None:
    with pytest.raises(UnknownUnit):
        check_unit(text)


@pytest.mark.parametrize("text", ["°/√h", "角度随机游走"])
def test_a_root_is_not_dropped(text: str) -> None:
    with pytest.raises(BadInput):
        column_unit(text, "rate")


def test_units_in_other_letters() -> None:
    assert check_unit("°／ｈ") == "°/h"
    assert check_unit("℃") == "degC"
    assert conversion("m/s²", "m/s^2") == (1.0, 0.0)
    assert result_factor("°/√h", "deg/sqrt(h)") == 1.0
    assert result_factor("°/√s", "deg/sqrt(h)") == pytest.approx(60.0)
    assert column_unit("°/S", "角速率")[0] == "deg/s" or conversion(column_unit("°/S", "角速率")[0], "deg/s")[0] == 1.0
    assert column_unit("V", "角速率") == ("V", "")
    assert "expected to be an angular rate" in column_unit("m/s", "陀螺角速率")[1]


def test_latin_text_is_not_taken_for_chinese(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    (tmp_path / "a.csv").write_bytes("time[s],rate[deg/s],Temp (°C)\n0,1,2\n1,2,3\n".encode("latin-1"))
    done = gyrofleet("import", "a.csv", "--unit", "G-1", "--store", "S")
    assert done.code != 0
    assert "not UTF-8" in done.err + done.out


@pytest.mark.parametrize(
    ("titles", "proposed"),
    [
        ("t/s,ω/°/s,T/℃", ("t/s=time[s]", "ω/°/s=ω[°/s]", "T/℃=T[degC]")),
        ("Zeit in s,Temp in °C,u V", ("Zeit in s=time[s]", "Temp in °C=Temp[°C]", "u V=u[V]")),
    ],
)
def test_units_behind_a_slash_or_in_are_proposed_and_the_proposals_work(
    titles: str, proposed: tuple[str, ...], tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    text = titles + "\n" + "".join(f"{at},0.{at},25\n" for at in range(9))
    found = refusal(gyrofleet, tmp_path / "r.csv", text)
    assert all(f"--rename '{each}'" in found for each in proposed)
    signals, _ = imported(
        gyrofleet, tmp_path / "r.csv", text, *(word for each in proposed for word in ("--rename", each))
    )
    assert len(signals) == 2


def test_a_workbook_is_refused_with_what_to_do(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    assert "in Excel, save it as CSV UTF-8" in refusal(gyrofleet, tmp_path / "r.xlsx", "PK")
