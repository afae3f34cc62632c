"""One catalogue for many threads: none is refused because another one asks, or makes views with live rows."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from storage.lake.tables import TABLES
from storage.sql.catalog import Catalog
from storage.sql.views import VIEWS
from storage.store import Store

THREADS, TURNS = 6, 40


@pytest.mark.long
def test_threads_ask_while_others_lay_live_rows_over_the_views(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "S")
    channels, events = (TABLES[name].empty_table() for name in ("channels", "events"))
    with Catalog(store) as catalog, ThreadPoolExecutor(THREADS) as threads:

        def lay(number: int) -> int:
            with catalog.overlay(f"log_{number}", channels, events, {}, ()) as over:
                return int(over.rows("select count(*) from signals")[0][0])

        def ask(number: int) -> int:
            return int(catalog.rows("select count(*) from runs where run = $run", {"run": str(number)})[0][0])

        found = [threads.submit(lay if number % 8 == 0 else ask, number) for number in range(THREADS * TURNS)]
        assert [each.result() for each in found] == [0] * len(found)


@pytest.mark.long
def test_threads_name_views_first_at_once(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "S")
    for _ in range(4):
        with Catalog(store) as catalog, ThreadPoolExecutor(THREADS) as threads:
            statements = [f"select count(*) from {view}" for view in (*VIEWS, *VIEWS)]
            assert list(threads.map(catalog.rows, statements)) == [[(0,)]] * len(statements)
