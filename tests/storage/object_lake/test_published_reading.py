"""A published lake read without a copy of it: the same rows as the store's, and no more of it fetched than needed."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import gyrofleet as gf
from storage.object_lake.bucket import Bucket
from storage.object_lake.published_store import PublishedStore
from storage.sql.catalog import Catalog
from storage.sql.door import SqlDoor
from storage.sql.reading import find_signal, read_signal
from storage.store import Store
from stream.errors import QueryError, StoreError
from tests.conftest import Outcome
from tests.storage.conftest import DAY_NS, START_NS, Filler
from tests.storage.lake.exported_views import TABLES, assert_same, export
from tests.storage.object_lake.publishing import publish


@pytest.fixture
def lake(days: Filler, bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    """A published store; the cache is in a folder of the test."""
    monkeypatch.setenv("GYROFLEET_CACHE", str(tmp_path / "cache"))
    days.build()
    days.release()
    publish(days.store, bucket)
    return days.store


def test_all_views_have_the_rows_of_the_store(lake: Store, url: str, aws: str, tmp_path: Path) -> None:
    export(lake, tmp_path / "local")
    export(PublishedStore.open_url(url, aws), tmp_path / "remote")
    assert_same(tmp_path / "local", tmp_path / "remote")


@pytest.mark.long
def test_users_statements_run_in_the_sandbox_with_the_same_answers(lake: Store, url: str, aws: str) -> None:
    remote = PublishedStore.open_url(url, aws)
    with SqlDoor(lake) as local_door, SqlDoor(remote) as door:
        for table in TABLES:
            statement = f"from {table} order by all"
            assert door.ask(statement).read_all() == local_door.ask(statement).read_all(), table
        assert door.is_enforced == local_door.is_enforced
        for refused in ("from read_parquet('gyrolake://x/samples.parquet')", "from read_text('/etc/passwd')"):
            with pytest.raises(QueryError, match="refused"):
                door.ask(refused)


@pytest.mark.long
def test_a_signal_is_read_in_order_and_by_python(lake: Store, url: str, aws: str) -> None:
    found = []
    for store in (lake, PublishedStore.open_url(url, aws)):
        with Catalog(store) as catalog:
            batches = list(read_signal(catalog, find_signal(catalog, "U1", "rate")))
            found.append(np.concatenate([batch.counts for batch in batches if batch.counts is not None]))
    assert np.array_equal(found[0], found[1])
    with gf.open_store(url, endpoint_url=aws) as remote, gf.open_store(lake.folder) as local:
        assert remote.signals().equals(local.signals())
        start, stop = START_NS + DAY_NS, START_NS + 2 * DAY_NS
        day = local.samples("U1", "rate", start=start, stop=stop)
        assert remote.samples("U1", "rate", start=start, stop=stop).equals(day)
        assert day.height == 5_000
        assert remote.metrics().equals(local.metrics())


@pytest.mark.long
def test_the_commands_answer_as_with_the_store(
    lake: Store, url: str, aws: str, gyrofleet: Callable[..., Outcome]
) -> None:
    where = ("--lake", url, "--endpoint-url", aws)
    statement = "select signal, count(*), sum(value) from samples group by signal order by signal"
    assert gyrofleet("sql", statement, *where, "--json").out == gyrofleet(
        "sql", statement, "--store", lake.folder, "--json"
    ).out  # fmt: skip
    assert gyrofleet("metrics", *where, "--json").out == gyrofleet("metrics", "--store", lake.folder, "--json").out
    missing = gyrofleet("sql", "from runs", "--lake", f"{url}/none", "--endpoint-url", aws)
    assert missing.code == 1
    assert "holds no lake" in missing.err


@pytest.mark.long
def test_a_question_about_one_unit_and_time_fetches_little(
    filler: Filler, bucket: Bucket, url: str, aws: str, tmp_path: Path
) -> None:
    rng = np.random.default_rng(1)
    for number in range(2):
        for name in ("a", "b", "c", "d", "e", "f"):
            filler.rng = rng
            filler.counts(name, START_NS + number * 6000 * 10**9, 600_000)
        filler.seal()
    filler.build()
    filler.release()
    publish(filler.store, bucket)
    everything = sum(part.bytes for part in publish(filler.store, bucket).parts)
    remote = PublishedStore.open_url(url, aws, cache=tmp_path / "cache")
    with Catalog(remote) as catalog:
        sql = "select count(*), sum(counts) from samples where signal = 'c' and t_ns < $until"
        asked = {"until": START_NS + 100 * 10**9}
        answer = catalog.rows(sql, asked)
    fetched = remote.cache.fetched_bytes
    with Catalog(filler.store) as catalog:
        assert catalog.rows(sql, asked) == answer
    assert answer[0][0] == 10_000
    assert fetched < 0.4 * everything
    again = PublishedStore.open_url(url, aws, cache=tmp_path / "cache")
    with Catalog(again) as catalog:
        assert catalog.rows(sql, asked) == answer
    assert again.cache.fetched_bytes == 0


@pytest.mark.long
@pytest.mark.usefixtures("own_sandbox")
def test_the_sandboxed_process_has_neither_credentials_nor_cache(lake: Store, url: str, aws: str) -> None:
    remote = PublishedStore.open_url(url, aws)
    with SqlDoor(remote) as door:
        door.ask("from runs").read_all()
        assert door._process is not None
        process = Path("/proc") / str(door._process._process.pid)
        environment = process.joinpath("environ").read_bytes()
        assert b"AWS_" not in environment
        sockets = [str(each.readlink()) for each in process.joinpath("fd").iterdir()]
        assert sum(each.startswith("socket:") for each in sockets) == 4


@pytest.mark.long
def test_a_reader_that_opened_before_a_change_reads_on_until_the_grace_time_ends(
    lake: Store, bucket: Bucket, url: str, aws: str, tmp_path: Path
) -> None:
    from storage.lake.builder import builder_lock
    from storage.lake.compaction import compact
    from storage.lake.lake import Lake
    from tests.storage.lake.exported_views import LATER_NS

    early = PublishedStore.open_url(url, aws, cache=tmp_path / "one")
    late = PublishedStore.open_url(url, aws, cache=tmp_path / "two")
    with builder_lock(lake):
        assert list(compact(Lake(lake), now_ns=LATER_NS))
    publish(lake, bucket)
    with Catalog(early) as catalog:
        assert catalog.rows("select count(*) from samples") == [(6 * 2525,)]
    publish(lake, bucket, grace_s=0.0)
    with pytest.raises(StoreError, match=r"is missing; .*run it again"), Catalog(late) as catalog:
        catalog.rows("select count(*) from samples")


@pytest.mark.long
def test_a_reader_killed_at_any_moment_leaves_a_sound_cache(lake: Store, url: str, aws: str, tmp_path: Path) -> None:
    script = (
        "import sys; from pathlib import Path; from storage.object_lake.published_store import PublishedStore\n"
        "from storage.sql.catalog import Catalog\n"
        "store = PublishedStore.open_url(sys.argv[1], sys.argv[2], cache=Path(sys.argv[3]))\n"
        "print('begun', flush=True)\n"
        "with Catalog(store) as catalog: print(catalog.rows('select count(*), sum(counts) from samples'))"
    )
    for delay_s in (0.0, 0.05, 0.15, 0.3):
        process = subprocess.Popen(
            [sys.executable, "-c", script, url, aws, str(tmp_path / "killed")], stdout=subprocess.PIPE
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(delay_s)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
    store = PublishedStore.open_url(url, aws, cache=tmp_path / "killed")
    sql = "select count(*), sum(counts) from samples"
    with Catalog(store) as catalog, Catalog(lake) as local:
        assert catalog.rows(sql) == local.rows(sql)
