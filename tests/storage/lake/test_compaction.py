"""Compaction and rebuild change no row, whenever they are killed."""

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from storage.check.verify_lake import lake_problems
from storage.lake import compaction, tables
from storage.lake.builder import builder_lock
from storage.lake.compaction import compact, due
from storage.lake.lake import Lake
from storage.lake.rebuild import rebuild
from storage.lake.tables import SAMPLES_FILE
from storage.manifests.lake import Manifest, left_aside, read_manifest
from storage.manifests.part import Part, PartFile
from storage.sql.catalog import Catalog
from storage.sql.reading import find_signal, read_signal
from storage.store import Store
from stream.errors import StoreError
from stream.events import EstimatePoint, EstimatePublished, NoteAdded
from tests.conftest import Outcome
from tests.storage.conftest import DAY_NS, START_NS, Filler
from tests.storage.lake.exported_views import LATER_NS, assert_same, export


@pytest.fixture
def documented(days: Filler) -> Filler:
    return add_documents(days)


def add_documents(days: Filler) -> Filler:
    """Notes, and one estimate three times, in three segments."""
    point = EstimatePoint(tau_s=1.0, value=1.0, lo=0.5, hi=2.0, edf=3.0, n=4)
    estimate = EstimatePublished(
        run="r1",
        t_ns=START_NS,
        unit="U1",
        signal="rate",
        estimator="allan_deviation",
        unit_of_measure="deg/h",
        confidence=0.95,
        samples=9,
        missing=0,
        sample_interval_s=0.01,
        points=(point,),
    )
    for i in range(3):
        days.document(NoteAdded(run="r1", t_ns=START_NS + i, text=f"note {i}"))
        days.document(estimate)  # the same one in three segments
        days.seal()
    return days


def test_a_finished_day_becomes_one_part_with_the_same_rows(documented: Filler, tmp_path: Path) -> None:
    documented.build()
    store = documented.store
    export(store, tmp_path / "before")
    with Catalog(store) as catalog:
        assert catalog.rows("select count(*) from estimates") == [(1,)]
        assert catalog.rows("select count(*) from rollup_1s where signal = 'rate'") == [(303,)]
        assert catalog.rows("select sum(n) from rollup_1s where signal = 'rate'") == [(30_000,)]
    with builder_lock(store):
        assert [each.parts for each in compact(Lake(store), now_ns=LATER_NS)] == [7, 4, 4]
        assert list(compact(Lake(store), now_ns=LATER_NS)) == []
    assert [part.day for part in read_manifest(store).parts] == ["2025-11-21", "2025-11-22", "2025-11-23"]
    export(store, tmp_path / "after")
    assert_same(tmp_path / "before", tmp_path / "after")
    assert list(lake_problems(store)) == []
    assert (store.lake / "00000001").is_dir()
    with builder_lock(store):
        assert Lake(store).purge(grace_s=3600) == []
        assert len(Lake(store).purge(grace_s=0)) == 15
    assert not (store.lake / "00000001").exists()
    export(store, tmp_path / "purged")
    assert_same(tmp_path / "before", tmp_path / "purged")


def test_parts_of_an_earlier_version_whose_columns_may_be_null_are_joined_with_newer_ones(
    days: Filler, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    missing = Lake(days.store).missing()
    with monkeypatch.context() as earlier, builder_lock(days.store):
        earlier.setattr(tables, "_REQUIRED", {})
        list(Lake(days.store).bring(missing[: len(missing) // 2], {}))
    days.build()
    nullable = [
        pq.read_schema(days.store.lake / part.name / SAMPLES_FILE).field("seq").nullable
        for part in read_manifest(days.store).parts
    ]
    assert set(nullable) == {True, False}
    export(days.store, tmp_path / "before")
    with builder_lock(days.store):
        assert len(list(compact(Lake(days.store), now_ns=LATER_NS))) == 3
    export(days.store, tmp_path / "after")
    assert_same(tmp_path / "before", tmp_path / "after")
    assert list(lake_problems(days.store)) == []


def test_rollups_are_those_of_the_samples(days: Filler) -> None:
    days.build()
    with Catalog(days.store) as catalog:
        for seconds in (1, 10):
            rows = catalog.rows(
                f"with x as (select signal, t_ns // {seconds * 10**9} as bucket, count(*) as n, avg(value) as mean, "
                f"stddev(value) as sd, min(value) as lo, max(value) as hi from samples group by all) "
                f"select r.n - x.n, r.mean - x.mean, r.stddev - x.sd, r.lo - x.lo, r.hi - x.hi "
                f"from rollup_{seconds}s r full join x "
                f"on r.signal = x.signal and r.t_ns // {seconds * 10**9} = x.bucket where r.n > 1"
            )
            assert rows
            assert np.abs(np.array(rows, float)).max() < 1e-9


@pytest.mark.long
def test_a_segment_that_comes_late_is_put_with_its_day(days: Filler, tmp_path: Path) -> None:
    store = days.store
    late = store.log / "00000002.mcap"
    held_back = tmp_path / "held back"
    late.rename(held_back)
    days.build()
    with builder_lock(store):
        list(compact(Lake(store), now_ns=LATER_NS))
    held_back.rename(late)
    days.build()
    with builder_lock(store):
        list(compact(Lake(store), now_ns=LATER_NS))
    with Catalog(store) as catalog:
        record = find_signal(catalog, "U1", "rate")
        seq = np.concatenate([each.seq + np.arange(len(each)) for each in read_signal(catalog, record)])
        assert np.array_equal(seq, np.arange(30_000))
        assert catalog.rows("select sum(n), count(*), count(distinct t_ns) from rollup_1s where signal = 'rate'") == [
            (30_000, 303, 303)
        ]


def test_many_small_parts_of_a_day_that_goes_on_become_few() -> None:
    def small(number: int) -> Part:
        file = {"channels.parquet": PartFile(1000, 10, "")}
        name = f"{number:08d}"
        return Part(name=name, segments=(name,), files=file, samples=10, arrival_first_ns=START_NS, arrival_last_ns=1)

    manifest = Manifest(parts=tuple(small(i) for i in range(200)))
    assert [len(group) for group in due(manifest, START_NS + 3600 * 10**9)] == [64, 64, 64]
    assert list(due(Manifest(parts=manifest.parts[:63]), START_NS)) == []
    finished = [len(group) for group in due(manifest, LATER_NS)]
    assert sum(finished) == 200
    assert max(finished) <= 64


def test_a_damaged_part_is_passed_over(days: Filler) -> None:
    days.build()
    store = days.store
    path = store.lake / "00000006" / "samples.parquet"
    content = bytearray(path.read_bytes())
    content[2000] ^= 0x10
    path.write_bytes(content)
    with builder_lock(store), pytest.raises(StoreError, match=r"cannot be read .*gyrofleet recover"):
        list(compact(Lake(store), now_ns=LATER_NS))
    assert [len(part.segments) for part in read_manifest(store).parts] == [4, 1, 1, 1, 1, 4]


@pytest.mark.parametrize("steps", [("hull",), ("write_part", "hull", "part_writers")], ids=["one", "every"])
@pytest.mark.in_gate("one")
def test_compaction_killed_at_every_step_leaves_a_sound_lake(
    days: Filler, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, steps: tuple[str, ...]
) -> None:
    """A kill is an exception that nothing catches: what is on disk then is what a killed process leaves."""
    days.build()
    store = days.store
    export(store, tmp_path / "before")

    class Killed(BaseException):
        pass

    def die(*_: object, **__: object) -> None:
        raise Killed

    for number, name in enumerate(steps):
        with monkeypatch.context() as patched, builder_lock(store), pytest.raises(Killed):
            patched.setattr(compaction, name, die)
            list(compact(Lake(store), now_ns=LATER_NS))
        export(store, tmp_path / f"killed {number}")
        assert_same(tmp_path / "before", tmp_path / f"killed {number}")
    with monkeypatch.context() as patched, builder_lock(store), pytest.raises(Killed):
        patched.setattr(Lake, "commit", die)  # renamed, and not yet in the manifest
        list(compact(Lake(store), now_ns=LATER_NS))
    with builder_lock(store):
        assert len(list(compact(Lake(store), now_ns=LATER_NS))) == 3
    export(store, tmp_path / "after")
    assert_same(tmp_path / "before", tmp_path / "after")
    assert list(lake_problems(store)) == []


@pytest.mark.long
def test_a_rebuilt_lake_has_the_same_rows(documented: Filler, tmp_path: Path) -> None:
    documented.build()
    store = documented.store
    export(store, tmp_path / "before")
    shutil.copytree(store.lake, tmp_path / "lake")
    with builder_lock(store):
        assert [done for done, _ in rebuild(store)] == list(range(1, 16))
    assert left_aside(store) == []
    export(store, tmp_path / "after")
    assert_same(tmp_path / "before", tmp_path / "after")
    assert len(read_manifest(store).parts) == 3


@pytest.mark.long
def test_a_rebuild_never_gives_up_what_the_log_does_not_give(days: Filler) -> None:
    days.build()
    store = days.store
    (store.log / "00000003.mcap").rename(store.folder / "away")
    with builder_lock(store), pytest.raises(StoreError, match=r"1 segments that the log no longer gives: 00000003"):
        list(rebuild(store))
    assert len(read_manifest(store).segments) == 12
    with builder_lock(store):
        list(rebuild(store, force=True))
    assert len(read_manifest(store).segments) == 11
    (aside,) = left_aside(store)
    assert (aside / "00000003").is_dir()


@pytest.mark.long
@pytest.mark.parametrize("kills", [1, pytest.param(5, marks=pytest.mark.long)])
@pytest.mark.parametrize("command", [("lake", "--once", "--grace-s", "0"), ("rebuild",)])
def test_a_killed_builder_goes_on_and_gives_the_same_rows(
    days: Filler,
    tmp_path: Path,
    command: tuple[str, ...],
    kills: int,
    command_line: Callable[..., list[str]],
    gyrofleet: Callable[..., Outcome],
) -> None:
    """Real processes, killed at moments all over what they do."""
    for i in range(12, 60):
        t0_ns = START_NS + i * DAY_NS // 16
        days.counts("rate", t0_ns, 2500)
        days.seal()
    days.release()
    store, reference = days.store, Store.create(tmp_path / "reference")
    shutil.copytree(store.log, reference.log, dirs_exist_ok=True)
    assert gyrofleet("lake", "--once", "--store", reference.folder).code == 0
    export(reference, tmp_path / "before")
    rng = np.random.default_rng(7)
    if command[0] == "rebuild":
        assert gyrofleet("lake", "--once", "--store", store.folder).code == 0
    for _ in range(kills):
        process = subprocess.Popen(
            command_line(*command, "--store", store.folder, "--json"), stdout=subprocess.PIPE, text=True, cwd=tmp_path
        )
        time.sleep(float(rng.uniform(0.4, 2.5)))
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
        if command[0] == "rebuild" and (store.lake / "manifest.json").exists():
            export(store, tmp_path / "killed")
            assert_same(tmp_path / "before", tmp_path / "killed")
            shutil.rmtree(tmp_path / "killed")
    assert gyrofleet(*command, "--store", store.folder).code == 0
    export(store, tmp_path / "after")
    assert_same(tmp_path / "before", tmp_path / "after")
    assert list(lake_problems(store)) == []
