"""The floor of imported files: the run of a station that was measured last, whatever was imported last."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from analytics.first_floor import fill_floor
from analytics.floor import Floor
from analytics.serve.live.floor_rows import FloorRows
from storage.manifests.lake import read_manifest
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.events import RunEnded, RunStarted
from tests.analytics.serve.test_floor import PLACE, S, floor_of, state


def imported(run: str, begin_s: int, *, date_known: bool = True) -> RunStarted:
    return RunStarted(run=run, t_ns=begin_s * S, units=("U1",), source="file a.csv", date_known=date_known)


def test_a_file_that_is_older_than_what_the_station_shows_is_not_on_the_floor() -> None:
    floor = floor_of(imported("new", 900), RunEnded(run="new", t_ns=950 * S), imported("old", 100))
    for run, t_ns in (("new", 950 * S), ("old", 150 * S)):
        floor.sampled(PLACE, "U1", run, t_ns, 5_000 * S)
    assert set(floor.runs) == {"new"}
    assert state(FloorRows(), floor, "U1")["last_s"] == 950, "measured, not imported, then"
    floor.take(PLACE, imported("newer", 1000), 6_000 * S)
    assert set(floor.runs) == {"newer"}
    floor.take(PLACE, RunEnded(run="newer", t_ns=1000 * S), 6_000 * S)
    floor.take(PLACE, imported("undated", 0, date_known=False), 6_001 * S)
    floor.sampled(PLACE, "U1", "undated", 7 * S, 6_001 * S)
    assert state(FloorRows(), floor, "U1")["last_s"] == 6_001


def test_the_floor_of_imported_files_has_the_last_that_was_measured(
    run_command: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "a.csv").write_text("time[s],rate[deg/h]\n" + "".join(f"{at},{at / 8}\n" for at in range(100)))
    for run, hour in (("late", 11), ("early", 9)):
        begun = f"2026-03-01T{hour:02}:00:00Z"
        words = ("--unit", "U", "--run", run, "--start", begun, "--station", "bench-1", "--store", "s")
        done = run_command("import", "a.csv", *words, cwd=tmp_path)
        assert done.code == 0, done.err
    floor = Floor()
    store = Store.open(tmp_path / "s")
    with Catalog(store, parts=read_manifest(store).parts) as catalog:
        fill_floor(floor, catalog)
    assert set(floor.runs) == {"late"}
    begin = datetime(2026, 3, 1, 11, tzinfo=UTC)
    assert state(FloorRows(), floor, "U")["last_s"] == int(begin.timestamp()) + 99
