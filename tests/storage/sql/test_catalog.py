"""The views over the lake: there from the first moment, of one row for each sample, and read back in order."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from storage.log.event_log import EventLog
from storage.manifests.lake import read_manifest
from storage.recording.recorder import Recorder
from storage.sql.catalog import Catalog
from storage.sql.reading import find_signal, read_signal, stored_between
from storage.sql.views import VIEWS
from storage.store import Store
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.errors import NotFound, QueryError, StoreError
from stream.events import PowerOn, RunEnded, RunStarted, StepEnded, StepStarted, StepWords
from stream.identity import Place, event_key, sample_key
from stream.transport.bus import LocalBus

PLACE = Place("plant", "bench")
_VALUES = np.arange(2000) * 0.5 + 1
SUM = [(2100, float(_VALUES.sum() + _VALUES[:100].sum()))]
T0_NS = 1_763_683_200_000_000_000


def batch(seq: int, epoch: int, t0_ns: int, n: int = 100, **more: object) -> SampleBatch:
    counts = np.arange(seq, seq + n, dtype=np.int32)
    fields: dict[str, object] = {"counts": counts, "scale": 0.5, "offset": 1.0, **more}
    return SampleBatch("U1", "rate", "r1", UUID(int=epoch), seq, t0_ns, 10**7, "deg/s", **fields)  # type: ignore[arg-type]


@pytest.fixture
def catalog(tmp_path: Path) -> Iterator[Catalog]:
    """A store with two power-ons of one signal over several segments, a step, and times that jitter."""
    store = Store.create(tmp_path / "store")
    bus = LocalBus()
    log = EventLog(store, rotate_bytes=1000)
    key = sample_key(PLACE, "U1", "rate")
    with Recorder(store, bus, log, sync_interval_s=0.001), DurablePublisher(bus) as publisher:
        started = RunStarted(run="r1", t_ns=T0_NS, operator="李", lot="L'7", procedure="static_bias")
        publisher.send_event(event_key(PLACE), started)
        publisher.send_event(event_key(PLACE), PowerOn(run="r1", t_ns=T0_NS, unit="U1", epoch=str(UUID(int=1))))
        step = StepStarted(run="r1", t_ns=T0_NS, unit="U1", words=StepWords(step="hot", temperature_command_deg_c=60.0))
        publisher.send_event(event_key(PLACE), step)
        for i in range(20):
            publisher.send_batch(key, batch(i * 100, 1, T0_NS + i * 10**9))
            publisher.drain()
        ended = StepEnded(run="r1", t_ns=T0_NS + 20 * 10**9 - 10**7, unit="U1", step_uid=step.uid)
        publisher.send_event(event_key(PLACE), ended)
        later_ns = T0_NS + 100 * 10**9 + np.arange(100) * 10**7 + np.arange(100) % 3
        publisher.send_batch(key, batch(0, 2, int(later_ns[0]), times_ns=later_ns))
        publisher.send_event(event_key(PLACE), RunEnded(run="r1", t_ns=int(later_ns[-1])))
        publisher.drain()
    with Catalog(store) as catalog:
        assert len(catalog.parts) > 3
        yield catalog


def test_an_empty_store_has_every_view_and_no_row(tmp_path: Path) -> None:
    with Catalog(Store.create(tmp_path / "store")) as catalog:
        for view in VIEWS:
            assert catalog.rows(f"select * from {view}") == []
        with pytest.raises(NotFound, match="it holds nothing yet"):
            find_signal(catalog, "U1", "rate")


def test_one_row_for_each_sample_with_value_and_counts(catalog: Catalog) -> None:
    assert catalog.rows("select count(*), count(distinct t_ns), count(distinct epoch) from samples") == [
        (2100, 2100, 2)
    ]
    assert catalog.rows("select max(abs(value - (counts * 0.5 + 1))) from samples") == [(0.0,)]
    (row,) = catalog.rows("select samples, epochs, is_counts, scale, unit_of_measure, sample_interval_s from signals")
    assert row == (2100, 2, True, 0.5, "deg/s", 0.01)


def test_runs_and_steps_carry_what_the_documents_say(catalog: Catalog) -> None:
    (run,) = catalog.rows('select run, operator, lot, "procedure", outcome, date_known, units, samples from runs')
    assert run == ("r1", "李", "L'7", "static_bias", "completed", True, ["U1"], 2100)
    (step,) = catalog.rows("select step, temperature_command, t_start_ns, t_end_ns, room from steps")
    assert step == ("hot", 60.0, T0_NS, T0_NS + 20 * 10**9 - 10**7, None)
    assert catalog.rows(
        "select count(*) from samples x join steps s on x.run = s.run and x.t_ns between s.t_start_ns and s.t_end_ns"
    ) == [(2000,)]


def test_a_signal_is_read_back_in_the_order_of_time(catalog: Catalog) -> None:
    record = find_signal(catalog, "U1", "rate")
    batches = list(read_signal(catalog, record))
    times_ns = np.concatenate([each.time_array for each in batches])
    assert len(times_ns) == record.samples == 2100
    assert np.all(np.diff(times_ns) > 0)
    assert np.concatenate([each.value_array for each in batches])[:3].tolist() == [1.0, 1.5, 2.0]
    stored_ns, values = stored_between(catalog, "U1", "rate", "r1", int(times_ns[10]), int(times_ns[12]))
    assert stored_ns.tolist() == times_ns[10:13].tolist()
    assert values.tolist() == [6.0, 6.5, 7.0]


def test_views_held_in_memory_have_the_same_rows(catalog: Catalog) -> None:
    """Views that stand on them as well, whether they were named before or not; of chosen units only theirs."""
    before = {view: sorted(map(repr, catalog.rows(f"select * from {view}"))) for view in ("steps", "runs", "signals")}
    for view in ("signals", "steps"):
        catalog.hold(view)
    for view, rows in before.items():
        assert sorted(map(repr, catalog.rows(f"select * from {view}"))) == rows
    count = "select unit, count(*) from events group by unit order by unit nulls first"
    assert catalog.rows(count) == [(None, 2), ("U1", 3)]
    catalog.hold("events", ["U1", "it's another"])
    assert catalog.rows(count) == [("U1", 3)]
    assert catalog.rows("select count(*) from samples") == [SUM[0][:1]]


def test_a_process_without_a_file_draws_no_bar_into_its_output(catalog: Catalog) -> None:
    """As the processes of a pool, which DuckDB takes for an interactive session; the connection that defines does."""
    program = """
import sys
from pathlib import Path
from storage.sql.catalog import Catalog
from storage.store import Store
with Catalog(Store.open(Path(sys.argv[1]))) as catalog:
    print(catalog._connection.execute("select current_setting('enable_progress_bar')").fetchall())
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-P", "-c", program, str(catalog.store.folder)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "[(False,)]\n"


def test_what_is_not_there_is_listed(catalog: Catalog) -> None:
    with pytest.raises(NotFound, match=r"unit 'U2' is not in .*; it holds U1"):
        find_signal(catalog, "U2", "rate")
    with pytest.raises(NotFound, match="run 'x' of unit U1, signal rate is not in"):
        find_signal(catalog, "U1", "rate", "x")


def test_a_statement_that_fails_on_its_way_is_reported(catalog: Catalog) -> None:
    with pytest.raises(QueryError, match="Could not convert"):
        catalog.rows("select cast(unit as integer) from samples")
    assert catalog.rows("select 1") == [(1,)]


@pytest.mark.parametrize("damage", ["gone", "cut", "overwritten"])
def test_a_file_that_is_broken_when_a_statement_reads_it_is_damage_of_the_lake(catalog: Catalog, damage: str) -> None:
    path = catalog.store.lake / read_manifest(catalog.store).parts[-1].name / "events.parquet"
    content = path.read_bytes()
    broken = (
        content[:-50] if damage == "cut" else content[:4] + b"x" * (len(content) // 2) + content[len(content) // 2 :]
    )
    path.unlink() if damage == "gone" else path.write_bytes(broken)
    with pytest.raises(StoreError, match=r"cannot be read .*`gyrofleet recover`"):
        catalog.rows("from runs")


def test_a_file_that_is_broken_is_damage_of_the_lake_while_rows_stream(catalog: Catalog) -> None:
    """Batches behind the first ones, as `gyrofleet sql` reads them."""
    path = catalog.store.lake / read_manifest(catalog.store).parts[-1].name / "samples.parquet"
    reader = catalog.user_reader("from samples")
    content = path.read_bytes()
    path.write_bytes(content[:4] + b"x" * (len(content) // 2) + content[4 + len(content) // 2 :])
    with pytest.raises(StoreError, match=r"cannot be read .*`gyrofleet recover`"):
        list(catalog.guarded(reader))


def test_a_damaged_lake_is_reported_and_made_anew_from_the_log(catalog: Catalog) -> None:
    store = catalog.store
    part = store.lake / read_manifest(store).parts[0].name
    (part / "samples.parquet").write_bytes((part / "samples.parquet").read_bytes()[:-50])
    with pytest.raises(StoreError, match=r"cannot be read .*`gyrofleet recover`"):
        Catalog(store)
    (part / "samples.parquet").unlink()
    with pytest.raises(StoreError, match=r"cannot be read .*`gyrofleet recover`"):
        Catalog(store)
    shutil.rmtree(part)
    (store.lake / "notes.txt").write_text("not ours")
    (store.lake / "more").mkdir()
    with Recorder(store, LocalBus(), EventLog(store)) as recorder:
        recorder.wait_for_lake()
    with Catalog(store) as again:
        assert again.rows("select count(*), sum(value) from samples") == SUM


def test_a_damaged_segment_is_reported_and_harms_no_other(catalog: Catalog) -> None:
    store = catalog.store
    shutil.rmtree(store.lake)
    store.lake.mkdir()
    segments = sorted(store.log.glob("*.mcap"))
    content = bytearray(segments[0].read_bytes())
    content[500] ^= 0xFF  # in the first chunk; the summary, most of so small a segment, carries no samples
    segments[0].write_bytes(content)
    recorder = Recorder(store, LocalBus(), EventLog(store))
    with pytest.raises(StoreError, match=r"segment .*00000001.mcap is damaged.*restore it from a copy"):
        recorder.close()
    assert [part.name for part in read_manifest(store).parts] == [segment.stem for segment in segments[1:]]


def test_a_mistyped_name_is_answered_with_the_one_that_is_meant(catalog: Catalog) -> None:
    for statement, meant in (
        ("from smples", "samples"), ("select deg_perh(1, 'deg/s') from samples", "deg_per_h"),
        ("from clcks, samples", "clocks"),
    ):  # fmt: skip
        with pytest.raises(QueryError, match=f'Did you mean "{meant}"'):
            catalog.user_reader(statement)
