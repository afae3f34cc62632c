"""A CAN database that cannot be read says which, where, and what to do."""

from pathlib import Path

import pytest

from ingest.can.database import load_database
from stream.errors import BadInput

GOOD = (
    'VERSION ""\nNS_ :\nBS_:\nBU_: Gyro\nBO_ 291 GYRO: 8 Gyro\n'
    ' SG_ Rate : 7|24@0- (0.0001,0) [0|0] "deg/s" Vector__XXX\n'
)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.dbc", GOOD.replace("7|24", "7|xx"), r"a\.dbc: line 6: .*mark >>!<<.*; mend that, or export it again"),
        ("b.dbc", "time,rate\n0,1\n", r"b\.dbc: line 1: cannot be read"),
        ("c.dbc", GOOD + 'BA_ "Cycle" BO_ 291 10;\n', r"\(it uses Cycle, which it does not define\)"),
        ("d.csv", GOOD, r"got 'csv'\); give a CAN database \(\.dbc\)"),
        ("e.kcd", "<x>", r"e\.kcd: line 1: cannot be read .*KCD"),
    ],
)
def test_a_wrong_database_is_told_with_its_place(tmp_path: Path, name: str, text: str, said: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(BadInput, match=said):
        load_database(path)


def test_a_good_one_is_read(tmp_path: Path) -> None:
    path = tmp_path / "gyro.dbc"
    path.write_text(GOOD)
    assert [message.name for message in load_database(path)] == ["GYRO"]
