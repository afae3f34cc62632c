"""Names of signals mean the same in SQL and in Python: instruments, outputs of gyros, axes."""

from itertools import product
from pathlib import Path

from ingest.importing.tested_units import is_instrument_name, is_output_name
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.channel_names import signal_axis

BEFORE = ("", "x", "Y轴", "z_", "table", "motor", "光纤", "ref", "cmd", "转台", "γ", "rate_", "电机",
          "Soll-", "Tisch", "目標", "モータ", "target_")  # fmt: skip
MIDDLE = ("rate", "gyro", "gyr", "陀螺", "陀螺仪", "角速率", "陀螺输出", "omega", "ω", "w", "速度", "speed", "转速",
          "回転数", "Drehrate", "角速度")  # fmt: skip
AFTER = ("", "x", "_y", "(Z)", "X轴", "1", "_raw", "_x_filtered", "y方向", "-x", "数值", "_table", "_s", "_true", "_5s")


def _has_axis(text: str) -> bool:
    return not {*"xyz"}.isdisjoint(text.lower())


def test_a_name_means_the_same_in_sql_and_in_python(tmp_path: Path) -> None:
    """Of one axis or none; thousands of names."""
    parts = [each for each in product(BEFORE, MIDDLE, AFTER) if not all(map(_has_axis, each[::2]))]
    names = sorted({"".join(each) for each in parts} | {"_".join(each) for each in parts if all(each)})
    asked = "select n, is_instrument_name(n), is_output_name(n), named_axis_of(n) from (select unnest($names) as n)"
    with Catalog(Store.create(tmp_path)) as catalog:
        catalog.fill(["unit_metrics"])
        rows = catalog.rows(asked, {"names": names})
    assert len(rows) == len(names) > 1500
    for name, is_instrument, is_output, axis in rows:
        own = signal_axis(name)
        assert (is_instrument, is_output) == (is_instrument_name(name), is_output_name(name)), name
        assert axis == (own and own.upper()), name
