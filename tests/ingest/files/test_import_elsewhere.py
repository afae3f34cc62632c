"""Imports to a recorder in another process give the answers that a local import gives, by what its own store has."""

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from ingest.importing.file_sending import CheckedFile, FileImport
from ingest.importing.importer import import_files
from ingest.run.run_path import Destination, path_to
from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from storage.log.event_log import EventLog
from storage.recording.client import HeldClaim, RecorderClient, is_recorded
from storage.recording.knowledge import CatalogKnowledge
from storage.recording.recorder import Recorder
from storage.sql.catalog import Catalog
from storage.store import Store, WriterLock
from stream.delivery.spool import Spool
from stream.errors import BadInput, DeliveryError, StoreError
from stream.identity import Place
from stream.transport.bus import LocalBus
from stream.transport.zenoh_bus import ZenohBus
from stream.wire.requests import MOST_ROWS

PLACE = Place("local", "files")


def table(path: Path, first: int, n: int, add: float = 0.0) -> Path:
    i = np.arange(first, first + n)
    pl.DataFrame({"time[s]": i * 0.01, "rate[deg/s]": np.sin(i) + add}).write_parquet(path)
    return path


def imported(path: Path, folder: Path, connect: str | None) -> FileImport:
    file = TableFile(path, TableOptions(unit="U1", run="r1"))
    checked = CheckedFile(path, file, file.check(), 0.0)
    (result,) = import_files([checked], folder, PLACE, connect=connect)
    return result


@contextmanager
def recording(folder: Path, endpoint: str) -> Iterator[Recorder]:
    store = Store.create(folder)
    with (
        WriterLock(store, "gyrofleet record", endpoint),
        ZenohBus(listen=[endpoint]) as bus,
        Recorder(store, bus, EventLog(store), sync_interval_s=0.02) as recorder,
    ):
        yield recorder


def moments(folder: Path) -> tuple[int, int]:
    """Samples, and different moments of them."""
    with Catalog(Store.open(folder)) as catalog:
        ((samples, different),) = catalog.rows("select count(*), count(distinct t_ns) from samples")
    return int(samples), int(different)


@pytest.mark.in_gate("other-127.0.0.1")
@pytest.mark.parametrize("named", ["localhost", "127.0.0.1"])
@pytest.mark.parametrize("where", ["store", "other", "missing"])
def test_a_recorder_by_any_name_and_with_any_store_gives_the_same_answer(
    tmp_path: Path, endpoint: str, named: str, where: str
) -> None:
    connect = endpoint.replace("127.0.0.1", named)
    folder = tmp_path / where
    if where == "other":
        Store.create(folder)
    with recording(tmp_path / "store", endpoint):
        first = imported(table(tmp_path / "a.parquet", 0, 3000), folder, connect)
        more = imported(table(tmp_path / "b.parquet", 2000, 3000), folder, connect)  # a third of it is there already
        with pytest.raises(BadInput, match="with other values"):
            imported(table(tmp_path / "c.parquet", 4000, 3000, add=1.0), folder, connect)
        again = imported(tmp_path / "b.parquet", folder, connect)
    counts = [(each.added, each.signals[0].already_stored, each.signals[0].in_lake) for each in (first, more, again)]
    assert counts == [(3000, 0, 3000), (2000, 1000, 5000), (0, 3000, 5000)]
    assert moments(tmp_path / "store") == (5000, 5000)
    assert where == "missing" or (folder / "store.json").exists()
    assert not (tmp_path / "missing").exists()


@pytest.mark.long
def test_two_imports_at_once_take_turns(tmp_path: Path, endpoint: str) -> None:
    paths = [table(tmp_path / f"{number}.parquet", 1000 * number, 3000) for number in range(3)]
    results: list[FileImport | Exception] = []

    def one(path: Path) -> None:
        until = time.monotonic() + 60.0
        while True:
            try:
                results.append(imported(path, tmp_path / "elsewhere", endpoint))
                return
            except StoreError as error:
                if "by another source (import of " not in str(error) or time.monotonic() > until:
                    results.append(error)
                    return

    with recording(tmp_path / "store", endpoint):
        threads = [threading.Thread(target=one, args=(path,)) for path in paths]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert [type(each) for each in results] == [FileImport] * 3
    assert sum(each.added for each in results if isinstance(each, FileImport)) == 5000
    assert moments(tmp_path / "store") == (5000, 5000)


@pytest.mark.long
def test_a_claim_is_for_one_source_and_ends_with_it(tmp_path: Path) -> None:
    bus = LocalBus()
    store = Store.create(tmp_path)
    lost: list[str] = []
    with Recorder(store, bus, EventLog(store), sync_interval_s=0.01):
        client = RecorderClient(bus, wanted="another")
        assert client.store == store.identity
        owners = [("U1", "r1"), ("U2", "r1")]
        with HeldClaim(client, owners, "gyrofleet run r1", on_loss=lost.append):
            time.sleep(4.0)  # longer than a lease
            with pytest.raises(StoreError, match=r"unit U2, run r1 is being sent .* \(gyrofleet run r1 on "):
                HeldClaim(client, [("U2", "r1")], "import")
            with HeldClaim(client, [("U2", "r2")], "import"):
                pass
        with HeldClaim(client, owners, "import"):
            pass
    assert lost == []
    with pytest.raises(DeliveryError, match="no recorder has answered"):
        RecorderClient(LocalBus(), patience_s=0.1)


@pytest.mark.long
def test_a_far_recorder_knows_what_its_lake_knows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    imported(table(tmp_path / "a.parquet", 0, 2500), tmp_path / "store", None)
    monkeypatch.setattr("stream.wire.requests.MOST_ROWS", 1000)
    assert MOST_ROWS > 1000
    store, bus = Store.open(tmp_path / "store"), LocalBus()
    with Recorder(store, bus, EventLog(store)), Catalog(store) as catalog:
        far, here = RecorderClient(bus), CatalogKnowledge(catalog)
        assert far.signals(["r1"]) == here.signals(["r1"])
        assert far.runs(["r1", "r2"]) == here.runs(["r1", "r2"])
        asked = ("U1", "rate", "r1", 0, 20 * 10**9)
        for found, expected in zip(far.samples(*asked), here.samples(*asked), strict=True):
            np.testing.assert_array_equal(found, expected)
        assert len(far.samples(*asked)[0]) == 2001
        with pytest.raises(StoreError, match="the recorder cannot answer"):
            monkeypatch.setattr(CatalogKnowledge, "runs", lambda *_: 1 / 0)
            far.runs(["r1"])


@pytest.mark.long
def test_two_runs_of_one_unit_at_once_are_not_one(tmp_path: Path, endpoint: str) -> None:
    with recording(tmp_path / "store", endpoint), ZenohBus(connect=[endpoint]) as bus, ExitStack() as stack:
        a, b = (Destination(tmp_path / name, endpoint, tmp_path) for name in "ab")
        first, second = (stack.enter_context(Spool(tmp_path / name)) for name in ("first", "second"))
        with path_to(a, "night", bus, first, units=["U1"]):
            with (
                pytest.raises(StoreError, match=r"unit U1, run night is being sent .*gyrofleet run night on"),
                path_to(b, "night", bus, second, units=["U1", "U2"]),
            ):
                pass
            with path_to(b, "night", bus, second, units=["U2"]):
                pass
        with path_to(b, "night", bus, second, units=["U1"]):
            pass


def test_a_store_is_known_by_its_recorder_and_not_by_its_address(tmp_path: Path, endpoint: str) -> None:
    Store.create(tmp_path / "other")
    named = endpoint.replace("127.0.0.1", "localhost")
    with recording(tmp_path / "store", endpoint), ZenohBus(connect=[named]) as bus:
        assert is_recorded(bus, tmp_path / "store", named)
        assert not is_recorded(bus, tmp_path / "other", endpoint)
        assert not is_recorded(bus, tmp_path / "missing", endpoint)


@pytest.mark.long
def test_files_in_the_log_that_are_not_the_stores_keep_no_import_waiting(
    tmp_path: Path, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("storage.recording.recorder._SETTLE_S", 10.0)
    with recording(tmp_path / "store", endpoint):
        imported(table(tmp_path / "a.parquet", 0, 3000), tmp_path / "store", endpoint)
        (segment, *_) = sorted((tmp_path / "store" / "log").glob("*.mcap"))
        (tmp_path / "store" / "log" / "00000001 (copy).mcap").write_bytes(segment.read_bytes())
        assert imported(table(tmp_path / "b.parquet", 3000, 500), tmp_path / "store", endpoint).added == 500
    assert moments(tmp_path / "store") == (3500, 3500)
