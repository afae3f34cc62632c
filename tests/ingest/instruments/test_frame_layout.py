"""Files of frame layouts: one that makes no sense is refused with its file and place."""

from pathlib import Path

import pytest

from ingest.serial.frame_layout import load_layout
from stream.errors import BadInput


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ('sync = "AA 5"', "sync is 'AA 5'"),
        ('sync = ""', "sync is ''"),
        ("length = 11", "length is 11, but its parts need 12"),
        ("interval_s = 0.0", "interval_s is 0"),
        ('byte_order = "middle"', r"\$\.byte_order"),
        ('counter = {at = 2, type = "u8", modulus = 300}', "modulus is more"),
        ('checksum = {kind = "crc16-modbus", at = -1}', "reaches beyond"),
        ('checksum = {kind = "md5"}', r"\$\.checksum\.kind"),
        ("lenght = 12", "lenght"),
    ],
)
def test_a_layout_that_makes_no_sense_names_its_file_and_place(tmp_path: Path, change: str, complaint: str) -> None:
    parts = {
        "sync": 'sync = "AA 55"',
        "length": "length = 12",
        "interval_s": "interval_s = 0.005",
        "byte_order": 'byte_order = "little"',
        "counter": 'counter = {at = 2, type = "u8"}',
        "checksum": 'checksum = {kind = "crc16-modbus", at = -2, start = 2}',
        "fields": 'fields = [{signal = "rate", at = 3, type = "i32"}, {signal = "t", at = 7, type = "i24"}]',
    }
    path = tmp_path / "gyro.toml"
    path.write_text("\n".join(parts.values()))
    assert load_layout(path).length == 12
    parts[change.split(" ")[0]] = change
    path.write_text("\n".join(parts.values()))
    with pytest.raises(BadInput, match=rf"gyro\.toml: .*{complaint}"):
        load_layout(path)
    with pytest.raises(BadInput, match=r"none\.toml"):
        load_layout(tmp_path / "none.toml")
