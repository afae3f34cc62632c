"""Corrections of a station and of units by an import: the audit has who made them, and the values before and now."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

KINDS = {"StationStated", "UnitMounted"}


def test_corrections_have_a_person_and_both_values(run_command: Callable[..., Any], tmp_path: Path) -> None:
    def ask(*words: str) -> Any:
        done = run_command(*words, "--store", "s", "--json", cwd=tmp_path)
        assert done.code == 0, done.out + done.err
        return done.json

    values = np.random.default_rng(2).normal(5, 1, 99)
    (tmp_path / "a.csv").write_text("time[s],rate[deg/h]\n" + "".join(f"{i},{v:.5f}\n" for i, v in enumerate(values)))
    for name, text in (("wrong", "U,P2,L9"), ("right", "U,P1,L9")):
        (tmp_path / f"{name}.csv").write_text(f"serial,product,lot\n{text}\n")
    again = ("import", "a.csv", "--unit", "U", "--start", "2026-11-02T08:00:00Z", "--by", "Li Wei", "--latitude")
    ask(*again, "39.9", "--units", "wrong.csv")
    ask(*again, "31.2", "--units", "right.csv", "--restate")
    ask(*again, "31.2", "--units", "right.csv", "--by", "Zhao")  # nothing new
    rows = ask("audit", "--unit", "U")
    found = [(row["kind"], row["by"], row["identity"], row["changes"]) for row in rows if row["kind"] in KINDS]
    assert found[:1] == [("UnitMounted", "Li Wei", "unauthenticated", {})]
    assert sorted(found[1:]) == [
        ("StationStated", "Li Wei", "unauthenticated", {"latitude_deg": ["39.9", "31.2"]}),
        ("UnitMounted", "Li Wei", "unauthenticated", {"product": ["P2", "P1"]}),
    ]
    shown = run_command("audit", "--unit", "U", "--csv", "audit.csv", "--store", "s", "--lang", "zh", cwd=tmp_path)
    assert shown.code == 0
    text = (tmp_path / "audit.csv").read_text(encoding="utf-8-sig")
    assert "latitude_deg 39.9 -> 31.2" in text
    assert "product P2 -> P1" in text
