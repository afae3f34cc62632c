"""A chamber that leaves its set-point while a step records: the run says so, and the value."""

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PROCEDURE = """
name = "own"
names = { en = "own", zh = "自编" }
source = ["GJB 2426A-2004 5.12.1.3"]

[[step]]
name = "soak"
temperature_deg_c = 30.0

[[step]]
name = "static"
position = "IRA_up"
record_s = 600.0
"""


@pytest.mark.long
def test_a_chamber_that_leaves_its_set_point_is_reported(
    gyrofleet: Callable[..., Any], kept: Any, spawn: Callable[..., subprocess.Popen[str]], bench: Any,
    state: Callable[..., dict[str, Any]], tmp_path: Path,
) -> None:  # fmt: skip
    (tmp_path / "own.toml").write_text(PROCEDURE)
    process = spawn(*bench.run(tmp_path / "own.toml"))
    state(lambda run: bool(run["open_steps"]))
    bench.tell("chamber", "TEMP:SETP 60")
    last, err = bench.ended(process)
    bench.tell("chamber", f"TEMP:SETP {bench.room_deg_c}")
    assert last["outcome"] == "completed"
    assert err.count("temperature has left its band") == 1
    notes = [
        row["text"] for row in kept.rows("select document->>'$.text' as text from events where kind = 'NoteAdded'")
    ]
    assert any("degC measured, 30 +-0.5 degC set; the record goes on" in text for text in notes)
    assert any("temperature was off by up to" in text for text in notes)
    rows = gyrofleet("metrics", "--metric", "bias", "--store", "S", "--json").json
    assert rows
    assert all("degC, 30.0 were commanded" in row["parameters"]["remark"] for row in rows)
