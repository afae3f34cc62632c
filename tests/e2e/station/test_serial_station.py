"""A station's serial lines as pseudo terminals: what a run says and records of what they really send."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.pty_gyros import pty_gyros, text_line

Gyrofleet = Callable[..., Any]
Kept = Any


@pytest.mark.long
def test_a_wrong_interval_of_a_layout_is_named_and_its_samples_are_on_no_grid(
    gyrofleet: Gyrofleet, kept: Kept, store: Path, tmp_path: Path
) -> None:
    with pty_gyros(tmp_path, {"G1": 0.01, "G2": 0.02, "G3": 0.001}, 100.0) as station:
        done = gyrofleet(
            "run", tmp_path / "hold.toml", "--station", station, "--units", tmp_path / "units.csv", "--store", store,
            "--yes", "--run", "r",
        )  # fmt: skip
    assert done.code == 0, done.err
    assert "every sample is recorded" in done.out
    notes = kept.rows(
        "select unit, document->>'$.text' as text from events where kind = 'NoteAdded' order by unit nulls first, t_ns"
    )
    noted = [each for each in notes if "interval_s" in each["text"]]
    assert [each["unit"] for each in noted] == ["G2", "G3", "G3"]
    for each in noted[:2]:
        assert f"interval_s in {each['unit']}.toml is 0.0" in each["text"]
        assert "write interval_s = 0.01 there and measure again" in each["text"]
        assert each["text"] in " ".join(done.err.split())
    assert "samples; its interval_s is wrong, see the warning" in noted[2]["text"]
    others = " ".join(each["text"] for each in notes).replace(" 0 frames lost", "")
    assert "wiring" not in others
    assert "lost" not in others
    signals = kept.rows("select unit, irregular from signals order by unit")
    assert [(each["unit"], each["irregular"]) for each in signals] == [("G1", False), ("G2", True), ("G3", True)]
    [beyond] = kept.rows("select count(*) as n from samples where t_ns > (select max(t_ns) from events)")
    assert beyond["n"] == 0


@pytest.mark.long
def test_lines_of_text_are_no_silence(gyrofleet: Gyrofleet, kept: Kept, store: Path, tmp_path: Path) -> None:
    with pty_gyros(tmp_path, {"G1": 0.01}, 100.0, text_line) as station:
        done = gyrofleet(
            "run", tmp_path / "hold.toml", "--station", station, "--units", tmp_path / "units.csv", "--store", store,
            "--yes", "--run", "r", "--set", "record_s=12",
        )  # fmt: skip
    assert done.code == 0, done.err
    notes = " | ".join(row["text"] for row in kept.rows(
        "select document->>'$.text' as text from events where kind = 'NoteAdded' order by t_ns"
    ))  # fmt: skip
    assert "s and none made a frame of G1.toml: check sync, length and checksum there, and baud = 115200" in notes
    assert "no sample came; what came made no frame: check its layout and baud" in notes
    assert "wiring" not in notes
    assert "come again" not in notes
