"""Warnings at the start of a run: of others that are at work or were left, and of lots that differ."""

from pathlib import Path

import pytest

from ingest.commands.run_procedure import _other_lots
from ingest.run_record import write_state
from ingest.station.run_log import STATE_FILE, StationRunState, other_unfinished
from ingest.station.units_file import UnitEntry
from stream.delivery.spool import Spool, spool_is_held


def left(spools: Path, run: str, *units: str) -> Path:
    folder = spools / run
    folder.mkdir(parents=True)
    state = StationRunState(run=run, procedure="static_bias", plan="", units=units, t0_ns=0, seen_ns=0, step=1)
    write_state(folder / STATE_FILE, state)
    return folder


def warned(spools: Path, *own: str) -> list[str]:
    return list(other_unfinished(spools, "static_bias", "r9", own))


def test_a_run_that_was_left_is_named_and_one_at_work_only_with_a_unit_of_both(tmp_path: Path) -> None:
    """A run at work on another station "was left unfinished", and could have been ended from here."""
    folder = left(tmp_path, "r1", "U1", "U2")
    (text,) = warned(tmp_path, "U7")
    assert "run r1 of U1, U2 was left unfinished at step 2" in text
    with Spool(folder):
        assert spool_is_held(folder)
        assert warned(tmp_path, "U7") == []
        (text,) = warned(tmp_path, "U2", "U7")
        assert text == "warning: run r1 is at work with U2 as well: is a unit named twice?"
    assert not spool_is_held(folder)


@pytest.mark.parametrize(
    ("given", "lots", "said"),
    [
        ("L1", ("L1", "L1"), ""), (None, ("L1", "L2"), ""), ("L1", (None, None), ""),
        ("L1TYPO", ("L1", "L1"), "--lot is L1TYPO, but in --units 2 of 2 units are of lot L1"),
        ("L1", ("L1", "L2"), "--lot is L1, but in --units 1 of 2 units are of lot L2"),
    ],
)  # fmt: skip
def test_a_lot_that_differs_from_that_of_the_units_is_named(
    given: str | None, lots: tuple[str | None, ...], said: str
) -> None:
    entries = [UnitEntry(serial=f"U{at}", lot=lot) for at, lot in enumerate(lots)]
    assert said in "".join(_other_lots(given, entries))
    assert bool(_other_lots(given, entries)) is bool(said)
