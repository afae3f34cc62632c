"""Tables as other programs export them: year-first dates, lines before the header, units below the titles."""

import datetime as dt
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import BadInput

ZONE = dt.timezone(dt.timedelta(hours=8))
FIRST = dt.datetime(2026, 11, 8, 9, 5, 3, tzinfo=ZONE)


def answer(store: Path, sql: str) -> list[tuple[Any, ...]]:
    with Catalog(Store.open(store)) as catalog:
        return catalog.rows(sql)


def excel(at: dt.datetime) -> str:
    return f"{at.year}/{at.month}/{at.day} {at.hour}:{at.minute:02d}:{at.second:02d}"


def chinese(at: dt.datetime) -> str:
    half, hour = ("上午", at.hour) if at.hour < 12 else ("下午", at.hour - 12)
    return f"{at.year}年{at.month}月{at.day}日 {half}{hour or 12}:{at.minute:02d}:{at.second:02d}"


@pytest.mark.parametrize("written", [excel, chinese, lambda at: excel(at).replace("/", "-")])
@pytest.mark.parametrize(
    "first", [FIRST, FIRST.replace(hour=23, minute=59), FIRST.replace(month=1, hour=11, minute=59)]
)
@pytest.mark.in_gate("first0-excel", "first1-chinese")
def test_dates_with_the_year_first_are_read(
    run_command: Callable[..., Any], tmp_path: Path, written: Callable[[dt.datetime], str], first: dt.datetime
) -> None:
    times = [first + dt.timedelta(seconds=second) for second in range(90)]
    rows = "\n".join(f"{written(at)},{0.5 + second}" for second, at in enumerate(times))
    (tmp_path / "log.csv").write_text(f"时间,角速率(°/h)\n{rows}\n", encoding="utf-8")
    done = run_command(
        "import", "log.csv", "--unit", "U", "--time-zone", "Asia/Shanghai", "--store", "s", "--json", cwd=tmp_path
    )
    assert done.code == 0, done.err
    asked = (
        "select count(*) as n, min(epoch_ns(time)) as first, max(epoch_ns(time)) as last, sum(value) as s from samples"
    )
    (found,) = answer(tmp_path / "s", asked)
    expected = (90, round(times[0].timestamp() * 1e9), round(times[-1].timestamp() * 1e9), sum(range(90)) + 45.0)
    assert found == expected


LOGGER = """Logger 34972A, channel list 7
Operator:, Wang Li

Scan rate (Hz), 10
Time,Gyro X,Temp
(s),(deg/s),(°C)
{rows}
"""


def rows(count: int = 20) -> str:
    return "\n".join(f"{second / 10:.1f},{0.01 * second:.2f},25.5" for second in range(count))


def test_lines_before_the_header_are_left_out_and_said(run_command: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(LOGGER.format(rows=rows()), encoding="utf-8")
    done = run_command("import", "log.csv", "--unit", "U", "--store", "s", cwd=tmp_path)
    assert done.code == 0, done.err
    said = " ".join((done.out + done.err).split())
    assert "3 lines before the header left out: 'Logger 34972A, channel list 7', 'Operator:, Wang Li'" in said
    assert "units of measure are taken from the line below the titles" in said
    asked = "select signal, unit_of_measure as u, samples from signals order by signal"
    assert answer(tmp_path / "s", asked) == [("Temp", "°C", 20), ("gyro_x", "deg/s", 20)]


@pytest.mark.parametrize("below", ["", "s;mdps;;\n"], ids=["", "units"])
def test_lines_before_the_header_are_left_out_of_rows_with_words(tmp_path: Path, below: str) -> None:
    titles = "Zeit;Rate;Kommentar;step" if below else "time[s];Rate [mdps];Kommentar;step"
    rows = [f"{i / 10:.1f};{i % 7 / 8:.3f};;static".replace(".", ",") for i in range(20)]
    path = tmp_path / "log.csv"
    path.write_text(f"Messprotokoll;Kammer 3\nGeraet;X\n\n{titles}\n{below}" + "\n".join(rows))
    renames = (("Zeit", "time"), ("Kommentar", "")) if below else (("Kommentar", ""),)
    summary = TableFile(path, TableOptions(unit="U", renames=renames)).check()
    assert any("2 lines before the header left out: 'Messprotokoll;Kammer 3'" in each for each in summary.remarks)
    assert [(each.signal.lower(), each.sampling.samples) for each in summary.signals] == [("rate", 20)]


@pytest.mark.parametrize("rows", [3, 40])
@pytest.mark.parametrize("words", ["", ";rest"])
def test_a_table_before_another_one_is_no_preamble(tmp_path: Path, rows: int, words: str) -> None:
    """Of a file with two tables the first was left out as "lines before the header"."""
    first = [f"{i / 10:.1f};{i % 7}.5{words or ';x;y'}" for i in range(rows)]
    second = [f"{i / 10:.1f};{i % 5}.5;9{words}" for i in range(40)]
    titles = (
        f"Time (s);Gyro Y (deg/s){';step' if words else ';a;b'}",
        f"Time (s);Gyro X (deg/s);T (degC){words and ';step'}",
    )
    path = tmp_path / "log.csv"
    path.write_text("\n".join([titles[0], *first, titles[1], *second]))
    with pytest.raises(BadInput):
        TableFile(path, TableOptions(unit="U")).check()


def test_a_list_of_channels_before_the_header_is_left_out(tmp_path: Path) -> None:
    channels = [f"{at};{name};16;{unit}" for at, (name, unit) in enumerate([("Gyro", "deg/s"), ("T", "degC")] * 2)]
    rows = [f"{i / 10:.1f};{i % 7}.5" for i in range(20)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["Logger 7", "Channels", *channels, "time[s];rate[deg/h]", *rows]))
    summary = TableFile(path, TableOptions(unit="U")).check()
    assert [each.sampling.samples for each in summary.signals] == [20]
    assert any("6 lines before the header left out" in each for each in summary.remarks)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        # a first row that is not right is no preamble
        ("time[s],rate[deg/s]\nbad,row\n0,1\n1,2\n", "line 2"),
        # nor are titles without units replaced by a row of text
        ("Zeit,Drehrate\nfoo,bar\n0,1\n1,2\n", "Zeit"),
        ("just text\nmore text\n", "'just' has no unit"),
    ],
)
def test_what_is_no_preamble_is_refused_as_before(
    run_command: Callable[..., Any], tmp_path: Path, text: str, said: str
) -> None:
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    done = run_command("import", "log.csv", "--unit", "U", "--store", "s", cwd=tmp_path)
    assert done.code != 0
    assert said in done.err


def test_a_bad_row_has_the_line_of_the_file(run_command: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(LOGGER.format(rows=rows() + "\n2.0,x,25\n2.1,1,25"), encoding="utf-8")
    done = run_command("import", "log.csv", "--unit", "U", "--store", "s", cwd=tmp_path)
    assert done.code != 0
    assert "line 27" in done.err


def test_a_unit_that_rename_replaces_is_warned_of(run_command: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time[s],rate_x[count]\n0,131\n1,131\n", encoding="utf-8")
    words = ("--rename", "rate_x[count]=rate_x[deg/s]", "--unit", "U", "--store", "s")
    done = run_command("import", "log.csv", *words, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "taken as deg/s, as --rename says, and are not converted from count" in " ".join(
        (done.out + done.err).split()
    )


@pytest.mark.parametrize("zones", [("+08:00", ""), ("", "+08:00"), ("Z", "")], ids=["first", "second", "Z"])
@pytest.mark.in_gate("first")
def test_stamps_with_and_without_a_zone_are_not_mixed(
    run_command: Callable[..., Any], tmp_path: Path, zones: tuple[str, str]
) -> None:
    """Eight hours would lie between two rows."""
    stamps = [f"2026-03-01T12:00:{second:02d}{zones[second >= 20]}" for second in range(40)]
    text = "Timestamp,rate[deg/h]\n" + "".join(f"{each},1.5\n" for each in stamps)
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    words = ("import", "log.csv", "--unit", "U", "--store", "s")
    done = run_command(*words, cwd=tmp_path)
    assert done.code != 0
    assert "line 22" in done.err
    assert "a zone, as in the first row" in " ".join(done.err.split())
    done = run_command(*words, "--skip-bad", "--json", cwd=tmp_path)
    assert done.json["files"][0]["bad_row_count"] == 20


def test_german_titles_are_read_or_the_message_says_how(run_command: Callable[..., Any], tmp_path: Path) -> None:
    rows = "".join(f"{i / 100:.2f};{i % 7 / 8:.3f};2{i % 5},5\n".replace(".", ",") for i in range(40))

    def imported(time: str, *arguments: str) -> Any:
        (tmp_path / "log.csv").write_text(f"{time} [s];Drehrate [°/s];Temperatur [°C]\n{rows}", encoding="utf-8")
        return run_command("import", "log.csv", "--unit", "U", *arguments, "--store", "s", "--json", cwd=tmp_path)

    refused = imported("Dauer")
    assert refused.code != 0
    assert "'Dauer [s]' is not it: rename it, as with --rename 'Dauer [s]=time'" in refused.json["error"]["message"]
    (file,) = imported("Dauer", "--rename", "Dauer [s]=time", "--run", "r1").json["files"]
    assert [each["signal"] for each in file["signals"]] == ["Drehrate", "Temperatur"]
    assert any("--rename 'Temperatur [°C]=temperature'" in each for each in file["remarks"])
    renames = ("--rename", "Drehrate=rate", "--rename", "Temperatur=temperature")
    (file,) = imported("Zeit", *renames, "--run", "r2").json["files"]
    assert [(each["signal"], each["in_file"]) for each in file["signals"]] == [("rate", 40), ("temperature", 40)]


@pytest.mark.parametrize(
    ("titles", "date", "mark"),
    [("Date,Time", "%Y-%m-%d", ","), ("Datum;Uhrzeit", "%Y-%m-%d", ";"), ("日期\t时间", "%Y/%m/%d", "\t")],
)
@pytest.mark.in_gate("Datum;Uhrzeit-%Y-%m-%d-;")
def test_a_date_and_a_time_of_day_in_two_columns_are_the_time(
    run_command: Callable[..., Any], tmp_path: Path, titles: str, date: str, mark: str
) -> None:
    times = [dt.datetime(2026, 11, 20, 23, 59, 50) + dt.timedelta(milliseconds=100 * i) for i in range(200)]
    rows = [[f"{at:{date}}", f"{at:%H:%M:%S.%f}"[:-3], f"{i % 7 / 8}"] for i, at in enumerate(times)]
    if mark == ";":
        rows = [[cell.replace(".", ",") for cell in row] for row in rows]
    text = "\n".join(mark.join(each) for each in [[titles, "rate[deg/s]"], *rows])
    (tmp_path / "log.csv").write_text(f"{text}\n", encoding="utf-8")
    words = ("import", "log.csv", "--unit", "U", "--store", "s", "--json", "--time-zone", "Asia/Shanghai")
    (file,) = run_command(*words, cwd=tmp_path).json["files"]
    (signal,) = file["signals"]
    assert (signal["in_file"], signal["sample_interval_s"], signal["irregular"]) == (200, 0.1, False)
    assert "together" in file["remarks"][0]
    first, last = (dt.datetime(2026, 11, day, tzinfo=ZONE).timestamp() for day in (20, 21))
    expected = [(round((first + 86_390) * 1e9), round((last + 9.9) * 1e9))]
    assert answer(tmp_path / "s", "select min(t_ns), max(t_ns) from samples") == expected
    (tmp_path / "log.csv").write_text(text.replace(rows[50][1], "?"), encoding="utf-8")  # read line by line then
    done = run_command(*words, "--skip-bad", cwd=tmp_path).json["files"][0]
    assert (done["bad_row_count"], done["signals"][0]["in_file"]) == (1, 199)


@pytest.mark.parametrize(
    ("titles", "cells", "why"),
    [
        ("Date;Time", "05/11/2026;08:00:00", "'Date' holds '05/11/2026', with day or month first"),
        ("Time", "20.11.2026 08:00:00", "'Time' holds '20.11.2026 08:00:00', with day or month first"),
        ("Date;Time", "20.11.26;08:00:00", "'Date' holds '20.11.26', a date with two digits for the year"),
        ("Time", "23:59:59.5", "'Time' holds '23:59:59.5', a time of day without a date: write the date before it"),
        ("Date;Time", "2026-11-20;8:00:00 PM", "'Time' holds '8:00:00 PM', a time of day in twelve hours"),
    ],
)
def test_what_a_time_stamp_lacks_is_named(tmp_path: Path, titles: str, cells: str, why: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{titles};rate[deg/s]\n{cells};1\n")
    with pytest.raises(BadInput, match=re.escape(why)) as refused:
        TableFile(path, TableOptions(unit="U"))
    assert str(refused.value).count(" holds ") == 1


@pytest.mark.parametrize("first", ["", "2026-11-20"])
def test_a_row_without_its_date_is_reported(run_command: Callable[..., Any], tmp_path: Path, first: str) -> None:
    rows = [f"{first},08:00:00,1", ",08:00:01,2", *(f"2026-11-20,08:00:{s:02},3" for s in range(2, 20))]
    (tmp_path / "log.csv").write_text("\n".join(["Date,Time,rate[deg/s]", *rows]) + "\n")
    words = ("import", "log.csv", "--unit", "U", "--store", "s")
    refused = run_command(*words, cwd=tmp_path)
    assert refused.code != 0
    assert "line 3, column Date: found '', expected a date in each row" in refused.err
    (file,) = run_command(*words, "--skip-bad", "--json", cwd=tmp_path).json["files"]
    assert (file["bad_row_count"], file["signals"][0]["in_file"]) == ((2, 18) if not first else (1, 19))


def test_a_column_that_is_left_out_is_no_time_beside_a_bad_row(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time[s],note,rate[deg/s]\n0,a,1\n0.1,b,x\n0.2,c,2\n")
    summary = TableFile(path, TableOptions(unit="U", renames=(("note", ""),), skip_bad=True)).check()
    assert [(each.number, each.column) for each in summary.bad] == [(3, "rate[deg/s]")]
