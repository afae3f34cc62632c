"""Rows that only the log has: as they will be in the lake, each once at any moment, and only where users ask."""

import shutil
import tempfile
from pathlib import Path
from uuid import UUID

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from storage.lake.builder import build_missing, builder_lock
from storage.manifests.lake import read_manifest
from storage.sql import live
from storage.sql.catalog import Catalog
from storage.sql.door import QueryLimits, SqlDoor
from storage.sql.opened import OpenedStore
from storage.sql.views import VIEWS
from storage.store import Store
from stream.batch import SampleBatch
from stream.errors import QueryError
from stream.events import (
    EstimatePoint,
    EstimatePublished,
    ExclusionAction,
    ExclusionEntered,
    PowerOn,
    RunEnded,
    RunStarted,
    StepEnded,
    StepStarted,
    StepWords,
    UnitMounted,
)
from tests.storage.conftest import START_NS, Filler
from tests.storage.interrupted_log import SEND, SIZE, STREAMS, TORN, TURNS, InterruptedLog

SECOND_NS = 10**9
COUNT = "select count(*) as n, count(distinct (unit, signal, epoch, seq)) as numbers from samples"


def asked(catalog: Catalog, sql: str) -> pa.Table:
    return catalog.user_reader(sql).read_all()


def fill(filler: Filler, part: int) -> None:
    """Samples and documents of every kind: counts, values, flags, true times, steps, estimates."""
    t0_ns = START_NS + part * 25 * SECOND_NS + 5 * 10**8
    filler.counts("rate", t0_ns, 2500)
    filler.counts("temperature", t0_ns, 25, dt_ns=SECOND_NS)
    values = filler.rng.normal(0, 1e-3, 300)
    values[::50] = np.nan
    flags = (np.arange(300) % 7 == part).astype(np.uint8) if part else None
    times_ns = t0_ns + np.arange(300) * 10**8 + np.sort(filler.rng.integers(0, 10**6, 300))
    common = (UUID(int=2), 300 * part, int(times_ns[0]), 10**8, "V")
    filler.batch(SampleBatch("U2", "voltage", "r1", *common, values=values, flags=flags))
    filler.batch(SampleBatch("U2", "angle", "r1", *common, values=values, times_ns=times_ns, irregular=True))
    if part == 0:
        filler.document(RunStarted(run="r1", t_ns=t0_ns, operator="李", procedure="static_bias"))
        filler.document(UnitMounted(run="r1", t_ns=t0_ns, unit="U1", slot="3"))
        filler.document(PowerOn(run="r1", t_ns=t0_ns, unit="U1", epoch=str(UUID(int=1))))
    step = StepStarted(run="r1", t_ns=t0_ns, unit="U1", words=StepWords(step=f"step {part}"))
    filler.document(step)
    filler.document(StepEnded(run="r1", t_ns=t0_ns + 20 * SECOND_NS, unit="U1", step_uid=step.uid))
    points = (EstimatePoint(tau_s=1.0, value=0.5 + part, lo=0.4, hi=0.6, edf=9.5, n=10),)
    filler.document(
        EstimatePublished(
            run="r1", t_ns=t0_ns, unit="U1", signal="rate", estimator="allan_deviation", unit_of_measure="deg/s",
            confidence=0.95, samples=2500, missing=0, sample_interval_s=0.01, points=points,
        )
    )  # fmt: skip


@pytest.fixture
def three(filler: Filler) -> Filler:
    """A segment in the lake, a sealed one that is not built, and an open one, and in the open one the run's end."""
    for part in range(3):
        fill(filler, part)
        if part < 2:
            filler.seal()
        if part == 0:
            filler.build()
    filler.document(RunEnded(run="r1", t_ns=START_NS + 80 * SECOND_NS))
    excluded = ExclusionAction.EXCLUDED
    at_ns = START_NS + 81 * SECOND_NS
    filler.document(ExclusionEntered(run="r1", t_ns=at_ns, action=excluded, by="Li", reason="kicked", unit="U1"))
    filler.sync()
    return filler


def test_live_rows_are_those_of_the_lake_to_the_last_bit(three: Filler) -> None:
    def rows(catalog: Catalog) -> dict[str, pa.Table]:
        sql = "select * {} from {} order by all"
        shown = {view: "exclude (live)" if view in {"signals", "runs"} else "" for view in VIEWS}
        found = {view: asked(catalog, sql.format(columns, view)) for view, columns in shown.items()}
        return found | {"adev": asked(catalog, "from adev('U1', 'rate')")}

    with Catalog(three.store, live=True) as catalog:
        before = rows(catalog)
        assert asked(catalog, "select sum(samples)::int as n, sum(live)::int as live from signals").to_pylist() == [
            {"n": 3 * 3125, "live": 2 * 3125}
        ]
    three.seal()
    three.build()
    with Catalog(three.store, live=True) as catalog:
        after = rows(catalog)
        assert asked(catalog, "select sum(samples)::int as n, sum(live)::int as live from runs").to_pylist() == [
            {"n": 3 * 3125, "live": 0}
        ]
    for view, table in before.items():
        assert table.num_rows
        # text, since a NaN equals no other
        assert str(table.to_pylist()) == str(after[view].to_pylist()), view
        assert table.schema == after[view].schema
        for column in table.column_names:
            if pa.types.is_floating(table.schema.field(column).type):
                assert table[column].combine_chunks().buffers()[1] == after[view][column].combine_chunks().buffers()[1]


def test_a_run_that_is_only_in_the_log_is_seen_while_it_runs(filler: Filler) -> None:
    filler.document(RunStarted(run="r1", t_ns=START_NS))
    filler.counts("rate", START_NS, 100)
    filler.sync()
    with Catalog(filler.store, live=True) as catalog:
        assert asked(catalog, "select run, samples, live, outcome from runs").to_pylist() == [
            {"run": "r1", "samples": 100, "live": 100, "outcome": "open"}
        ]
        assert asked(catalog, "select unit, bucket_s.n from rollup_1s as bucket_s").to_pylist() == [
            {"unit": "U1", "n": 100}
        ]


def test_only_users_statements_see_live_rows(three: Filler) -> None:
    with Catalog(three.store, live=True) as catalog:
        assert asked(catalog, COUNT).to_pylist() == [{"n": 3 * 3125, "numbers": 3 * 3125}]
        assert catalog.rows("select count(*) from internal.lake_samples") == [(3125,)]
    with Catalog(three.store) as catalog:
        assert asked(catalog, COUNT).to_pylist() == [{"n": 3125, "numbers": 3125}]


@pytest.mark.long
def test_samples_are_read_only_where_they_are_asked_for(three: Filler) -> None:
    with Catalog(three.store, live=True) as catalog:
        messages = "select count(*) as n from internal.live_messages"
        assert catalog._live is not None
        for sql, count in (("from signals", 0), ("from runs", 0), ("from events", 0), ("from samples limit 1", 8)):
            asked(catalog, sql)
            with catalog._live.cursor() as cursor:
                assert cursor.execute(messages).fetchall() == [(count,)]
                assert bool(cursor.execute("select count(*) from internal.live_rollup_1s").fetchall()[0][0]) is False
        asked(catalog, "from rollup_10s")


@pytest.mark.long
def test_a_catalogue_stays_as_it_was_and_the_next_one_shows_what_came(three: Filler) -> None:
    with Catalog(three.store, live=True) as catalog:
        assert asked(catalog, "select count(*) as n from signals").to_pylist() == [{"n": 4}]
        fill(three, 3)
        three.seal()
        three.build()
        assert asked(catalog, COUNT).to_pylist() == [{"n": 3 * 3125, "numbers": 3 * 3125}]
    with Catalog(three.store, live=True) as catalog:
        assert asked(catalog, COUNT).to_pylist() == [{"n": 4 * 3125, "numbers": 4 * 3125}]


schedules = st.lists(st.one_of(SEND, TURNS, TORN), max_size=20)


@pytest.mark.long
@given(schedules)
@settings(max_examples=6, deadline=None)
def test_whatever_happens_each_sample_is_seen_once(schedule: list[tuple[str, int]]) -> None:
    check_schedule(schedule)


@pytest.mark.long
@given(schedules)
@settings(max_examples=150, deadline=None)
def test_whatever_happens_each_sample_is_seen_once_in_many_schedules(schedule: list[tuple[str, int]]) -> None:
    check_schedule(schedule)


def check_schedule(schedule: list[tuple[str, int]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        log = InterruptedLog(Path(folder))
        log.send(0)
        log.sync()
        for moment, (name, *given_) in enumerate(schedule):
            # of parts that are older than the log it stands beside
            parts = read_manifest(log.store).parts
            log.apply(name, *given_)
            if moment % 5 == 0:
                check(log, Catalog(log.store, parts=parts, live=True))
        log.sync()
        check(log, Catalog(log.store, live=True))


def check(log: InterruptedLog, opened: Catalog) -> None:
    sql = (
        "select unit, count(*) as n, count(distinct seq) as numbers, min(seq) as first, max(seq) as last, "
        "count(distinct counts) as counts from samples group by unit"
    )
    with opened as catalog:
        found = {row.pop("unit"): row for row in asked(catalog, sql).to_pylist()}
        signals = {row["unit"]: row["samples"] for row in asked(catalog, "from signals").to_pylist()}
    for stream in STREAMS:
        unit = stream.key.split("/")[3]
        row = found.get(unit, {"n": 0, "numbers": 0, "first": 0, "last": -1})
        assert row["n"] == row["numbers"] == row["last"] + 1 == signals.get(unit, 0)
        assert row["first"] == 0
        assert row["n"] >= log.acknowledged.get(stream, 0)
        assert row["n"] % SIZE == 0
    assert set(found) == set(signals)


@pytest.mark.long
def test_segments_that_no_builder_takes_are_left_out_and_reported(
    filler: Filler, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "MOST_SAMPLES", 250)
    for part in range(6):
        filler.counts("rate", START_NS + part * SECOND_NS, 100)
        if part < 5:
            filler.seal()
    filler.sync()
    with Catalog(filler.store, live=True) as catalog:
        (note,) = catalog.prepare(COUNT)
        assert note.startswith("3 sealed segments of the log, 00000001 to 00000003, are not in the lake")
        assert "300 samples are not shown; `gyrofleet lake --once`" in note
        assert asked(catalog, "select count(*) as n, min(seq) as first from samples").to_pylist() == [
            {"n": 300, "first": 300}
        ]
    filler.build()
    with Catalog(filler.store, live=True) as catalog:
        assert catalog.prepare(COUNT) == ()
        assert asked(catalog, "select count(*) as n from samples").to_pylist() == [{"n": 600}]


def test_damage_of_the_log_is_reported_with_what_can_be_read(filler: Filler) -> None:
    for part in range(3):
        filler.counts("rate", START_NS + part * SECOND_NS, 100)
        filler.sync()
    (path,) = filler.store.log.glob("*.open")
    content = bytearray(path.read_bytes())
    content[content.index(b"zstd", content.index(b"zstd") + 4) + 60] ^= 0xFF
    path.write_bytes(content)
    with SqlDoor(filler.store) as door:
        result = door.ask("select seq // 100 as batch, count(*) as n from samples group by 1 order by 1")
        assert result.read_all().to_pylist() == [{"batch": 0, "n": 100}, {"batch": 2, "n": 100}]
        (note,) = result.notes
        assert note.startswith("segment 00000001 of the log is damaged: ")
        assert door.ask("select 1").notes == (note,)


@pytest.mark.long
def test_python_sees_live_rows_and_notes(three: Filler) -> None:
    with OpenedStore(three.store.folder) as opened:
        answer = opened.sql("select sum(live)::int as live from signals where unit = $unit", {"unit": "U2"})
        assert answer.rows() == [{"live": 1200}]
        assert answer.notes == ()


@pytest.mark.long
@pytest.mark.usefixtures("own_sandbox")
def test_live_rows_count_for_the_memory_of_a_statement(filler: Filler) -> None:
    for part in range(4):
        values, t0_ns = filler.rng.normal(0, 1, 10**6), START_NS + part * 1000 * SECOND_NS
        filler.batch(SampleBatch("U1", "rate", "r1", UUID(int=1), part * 10**6, t0_ns, 10**6, "deg/s", values=values))
    filler.sync()
    with SqlDoor(filler.store, QueryLimits(memory_bytes=24 << 20)) as door:
        with pytest.raises(QueryError, match=r"takes more memory than the 0\.0234 GiB that it may"):
            door.ask("select count(*) from samples").read_all()
        assert door.ask("select sum(samples)::int as n from signals").read_all().to_pylist() == [{"n": 4 * 10**6}]
        assert door.ask("select sum(n)::int as n from rollup_10s").read_all().to_pylist() == [{"n": 4 * 10**6}]


def test_messages_that_cannot_be_built_are_reported_before_the_lake_has_them(filler: Filler) -> None:
    filler.batch(SampleBatch("U1", "rate", "r1", UUID(int=1), 0, START_NS, 10**7, "deg/s", values=np.ones(5)))
    filler.raw(b"no batch", "gyrofleet/plant/chamber-1/U1/rate")
    filler.sync()
    sql = "select kind, document->>'$.text' as text from events"
    with Catalog(filler.store, live=True) as catalog:
        before = asked(catalog, sql).to_pylist()
    assert "cannot be brought to the lake: not a sample batch" in before[0]["text"]
    filler.seal()
    filler.build()
    with Catalog(filler.store, live=True) as catalog:
        assert asked(catalog, sql).to_pylist() == before


@pytest.mark.long
def test_a_store_without_a_log_or_a_lake_is_read(three: Filler, tmp_path: Path) -> None:
    three.release()
    copy = Store(tmp_path / "copy", three.store.identity)
    shutil.copytree(three.store.folder, copy.folder)
    shutil.rmtree(copy.log)
    with Catalog(copy, live=True) as catalog:
        assert asked(catalog, COUNT).to_pylist() == [{"n": 3125, "numbers": 3125}]
    shutil.rmtree(three.store.lake)
    three.store.lake.mkdir()
    with Catalog(three.store, live=True) as catalog:
        assert asked(catalog, COUNT).to_pylist() == [{"n": 3 * 3125, "numbers": 3 * 3125}]
    with builder_lock(three.store):
        list(build_missing(three.store))
    with Catalog(three.store, live=True) as catalog:
        assert asked(catalog, COUNT).to_pylist() == [{"n": 3 * 3125, "numbers": 3 * 3125}]
