"""Files of units: every way they come, and every mistake with its line."""

import io
import re
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ingest.station.units_file import UnitEntry, assigned, mounted_documents, parse_units, read_units
from stream.errors import BadInput
from stream.events import decode_event, encode_event

TABLE = (
    "serial,slot,lot,operator,fixture,firmware,product,备注\nFOG-1,A1,L7,李工,F-3,1.2.0,FOG-70,红色\nFOG-2,A2,,,,,,\n"
)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "gb18030", "utf-16"])
@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_table_is_the_same_in_every_encoding(tmp_path: Path, encoding: str, delimiter: str, end: str) -> None:
    path = tmp_path / "units.csv"
    path.write_bytes(TABLE.replace(",", delimiter).replace("\n", end).encode(encoding))
    assert read_units(path).entries == (
        UnitEntry(
            serial="FOG-1", slot="A1", lot="L7", operator="李工", fixture="F-3", firmware="1.2.0", product="FOG-70",
            details={"备注": "红色"}, line=2,
        ),
        UnitEntry(serial="FOG-2", slot="A2", line=3),
    )  # fmt: skip


serials = st.lists(st.text("ABF019-", min_size=1, max_size=12), min_size=1, max_size=12, unique=True)


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(serials, st.data())
def test_scanned_serials_come_back_in_order_and_empty_lines_are_counted(
    scanned: list[str], data: st.DataObject
) -> None:
    lines: list[str] = []
    for serial in scanned:
        lines += data.draw(st.lists(st.sampled_from(["", "  "]), max_size=2))
        lines.append(data.draw(st.sampled_from([serial, f" {serial} ", f"{serial}\r"])))
    found = parse_units(("\n".join(lines) + "\n").encode(), "scan")
    assert [entry.serial for entry in found.entries] == scanned
    assert found.empty_lines == len(lines) - len(scanned)
    assert [lines[entry.line - 1].strip() for entry in found.entries] == scanned


def test_serials_come_from_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"FOG-1\r\n\r\nFOG-2\r\n")))
    found = read_units("-")
    assert ([entry.serial for entry in found.entries], found.empty_lines) == (["FOG-1", "FOG-2"], 1)


def test_all_mistakes_are_told_with_their_lines_and_nothing_is_taken() -> None:
    text = "serial,slot\nFOG-1,A1\n\nFOG-1,A2\nFOG 3,A3\n,A4\nFOG-5,A1\nFOG-6,Z9\nFOG-7,A7,x\n"
    with pytest.raises(BadInput) as caught:
        parse_units(text.encode(), "units.csv", ["A1", "A2", "A3", "A4", "A7"])
    reported = str(caught.value)
    assert re.findall(r"line \d: ", reported) == [f"line {line}: " for line in range(4, 10)]
    for problem in (
        "units units.csv: ",
        "line 4: unit FOG-1 is on line 2 already",
        "line 5: unit 'FOG 3' cannot be used as a name",
        "line 6: no serial",
        "line 7: slot A1 is taken by FOG-1 on line 2",
        "line 8: slot 'Z9' is none of the station's: A1, A2",
        "line 9: 3 columns, the titles name 2",
    ):
        assert problem in reported


@pytest.mark.parametrize(
    ("content", "reported"),
    [
        (b"", "it is empty"),
        (b"\n \n", "it is empty"),
        (b"serial,slot\n", "no unit below"),
        (b"gyro,slot\nFOG-1,A1\n", "line 1: no title 'serial' among 'gyro', 'slot'"),
        (b"serial,lot,Lot\nFOG-1,1,2\n", "two columns are named 'lot'"),
        (b"serial,,x\nFOG-1,1,2\n", "column 2 has the title ''"),
        (b"\xff\x00\x81", "neither UTF-8 nor GB 18030"),
        (b"FOG-1\x00\n", "neither UTF-8 nor GB 18030"),
        (b'serial,lot\nFOG-1,"open\n', "line 2: unexpected end of data"),
        (b"FOG-1\nFOG-2,A2\n", "line 2: 2 columns without titles"),
        (b"FOG-1\nFOG-1\n", "line 2: unit FOG-1 is on line 1 already"),
        (b"a/b\n", "line 1: unit 'a/b' cannot be used"),
    ],
)
def test_what_is_no_list_of_units_is_refused(content: bytes, reported: str) -> None:
    with pytest.raises(BadInput, match=f"units scan.*{reported}"):
        parse_units(content, "scan")


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"none\.csv cannot be read: No such file"):
        read_units(tmp_path / "none.csv")


def test_slots_are_given_in_the_order_of_scanning() -> None:
    entries = parse_units(b"serial,slot\nFOG-1,\nFOG-2,1\nFOG-3,\n", "u").entries
    assert [entry.slot for entry in assigned(entries, ["1", "2", "3"])] == ["2", "1", "3"]
    with pytest.raises(BadInput, match="2 units have no slot, and 1 of the station's 2 slots are free"):
        assigned(entries, ["1", "2"])


def test_the_documents_say_what_the_file_says_and_are_the_same_again() -> None:
    entries = parse_units(TABLE.encode(), "u").entries
    first, second = mounted_documents(entries, "r1", 7)
    assert (first.unit, first.run, first.t_ns, first.slot, first.lot) == ("FOG-1", "r1", 7, "A1", "L7")
    assert (first.operator, first.fixture, first.firmware, first.product) == ("李工", "F-3", "1.2.0", "FOG-70")
    assert first.details == {"备注": "红色"}
    assert (second.lot, second.details) == (None, {})
    assert mounted_documents(entries, "r1", 7) == (first, second)
    others = (*mounted_documents(entries, "r1", 8), *mounted_documents(entries, "r2", 7), first, second)
    assert len({each.uid for each in others}) == 6
    assert decode_event(encode_event(first, "e", 0)).document == first
