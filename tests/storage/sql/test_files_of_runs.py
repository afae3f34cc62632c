"""A statement that says which runs it needs opens the files of the lake that have them, and no others."""

from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from storage.log.event_log import EventLog
from storage.recording.recorder import Recorder
from storage.sql.catalog import Catalog
from storage.sql.reading import stored_between
from storage.store import Store
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.errors import StoreError
from stream.identity import Place, sample_key
from stream.transport.bus import LocalBus

PLACE = Place("plant", "bench")
SECOND_NS = 10**9
RUNS = ("r1", "r2", "r3")
TABLES = ("samples", "rollup_1s", "rollup_10s")


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Three runs, each in parts of its own; run `r2` has two signals."""
    store = Store.create(tmp_path / "store")
    bus = LocalBus()
    log = EventLog(store, rotate_bytes=1)
    with Recorder(store, bus, log, sync_interval_s=0.001), DurablePublisher(bus) as publisher:
        for number, run in enumerate(RUNS):
            for signal in ("rate", "temperature")[: 2 if run == "r2" else 1]:
                for seq in range(0, 100, 50):
                    begin_ns = number * 1000 * SECOND_NS + seq * SECOND_NS // 5
                    values = np.arange(seq, seq + 50, dtype=np.float64) + 1000.0 * number
                    sent = SampleBatch(
                        "U1", signal, run, UUID(int=number + 1), seq, begin_ns, SECOND_NS // 5, "deg/h", values=values
                    )
                    publisher.send_batch(sample_key(PLACE, "U1", signal), sent)
                    publisher.drain()
    return store


def damage_other_runs(catalog: Catalog, run: str) -> int:
    """Damage the files of samples and rollups that have no row of a run, but those by which the tables are defined."""
    own, first = set(catalog.paths_of([run])), f"/{catalog.parts[0].name}/"
    others = [Path(path) for path in catalog.paths_of(RUNS) if path not in own and first not in path]
    for path in others:
        path.write_bytes(b"damaged" * 100)
    return len(others)


@pytest.mark.long
@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("run", RUNS)
def test_rows_of_a_run_are_those_of_the_view(store: Store, run: str, table: str) -> None:
    with Catalog(store) as catalog:
        asked = {"run": run}
        whole = catalog.rows(f"from {table} where run = $run order by all", asked)
        paths = {"paths": catalog.paths_of([run]), **asked}
        assert catalog.rows(f"from internal.{table}_in($paths) where run = $run order by all", paths) == whole
        assert len(whole) > 1


@pytest.mark.long
@pytest.mark.parametrize("table", TABLES)
def test_damage_of_other_runs_is_not_met(store: Store, table: str) -> None:
    with Catalog(store) as catalog:
        sql = f"select count(*) from internal.{table}_in($paths) where run = $run"
        asked = {"run": "r2", "paths": catalog.paths_of(["r2"])}
        before = catalog.rows(sql, asked)
        assert damage_other_runs(catalog, "r2") >= 6
        assert catalog.rows(sql, asked) == before
        column = "value" if table == "samples" else "mean"
        with pytest.raises(StoreError):  # the view does open them
            catalog.rows(f"select sum({column}) from {table} where run = 'r2'")


@pytest.mark.parametrize("table", TABLES)
def test_a_flipped_byte_in_a_page_is_not_taken_in(store: Store, table: str) -> None:
    """DuckDB checks no page."""
    asked = f"from internal.{table}_in($paths)"
    with Catalog(store) as catalog:
        (path, *_) = (
            Path(each) for each in catalog.checked_paths_of(["r2"], asked) if Path(each).stat().st_size > 1500
        )
    content = bytearray(path.read_bytes())
    content[200] ^= 1
    path.write_bytes(content)
    with Catalog(store) as catalog, pytest.raises(StoreError, match=r"does not match its hash.*gyrofleet recover"):
        catalog.checked_paths_of(["r2"], asked)


def test_samples_between_two_times_open_the_run_s_files(store: Store) -> None:
    with Catalog(store) as catalog:
        first_ns = 2000 * SECOND_NS
        times_ns, values = stored_between(catalog, "U1", "rate", "r3", first_ns, first_ns + 5 * SECOND_NS)
        assert damage_other_runs(catalog, "r3") >= 6
        again = stored_between(catalog, "U1", "rate", "r3", first_ns, first_ns + 5 * SECOND_NS)
    assert again[1].tolist() == values.tolist() == (2000.0 + np.arange(26)).tolist()
    assert again[0].tolist() == times_ns.tolist()


def test_a_run_that_is_not_in_the_store_has_no_files(store: Store) -> None:
    with Catalog(store) as catalog:
        assert catalog.paths_of(["r9"]) == []
        assert catalog.rows("select * from internal.samples_in($paths) where run = 'r9'", {"paths": []}) == []


def test_several_runs_have_the_files_of_each(store: Store) -> None:
    with Catalog(store) as catalog:
        both = set(catalog.paths_of(["r1", "r3"]))
        assert both == set(catalog.paths_of(["r1"])) | set(catalog.paths_of(["r3"]))
        assert both.isdisjoint(catalog.paths_of(["r2"]))
