"""What tasks compute from their slices of a store is what one process computes from the whole, to the last bit."""

import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from analytics.cluster import diagnosis_tasks
from analytics.cluster.diagnosis_tasks import ClusterTracing, ReadTask, local_reading
from analytics.cluster.metric_tasks import RecordsTask, ValuesTask
from analytics.cluster.store_slice import sliced
from analytics.loop.blocks.step_channels import position_numbers
from analytics.loop.unit_diagnosis import UnitsDiagnosis, trace_units
from analytics.loop.unit_reduction import Question, read_units, reduce_units, units_with
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import StoreError
from tests.analytics.cluster.sequential import Sequential, nobody
from tests.analytics.cluster.several_units import SOME, UNITS, computed, fill
from tests.analytics.conftest import SECOND_NS, START_NS

QUESTION = Question("rate = bias", block_s=None)


@pytest.fixture
def filled(tested: Any) -> Any:
    fill(tested)
    tested.catalog().close()
    return tested


def folders(tmp_path: Path) -> tuple[Path, Path]:
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    return here, there


@pytest.mark.in_gate("some")
@pytest.mark.parametrize("wanted", [SOME, ()], ids=["some", "every"])
def test_metrics_of_slices_are_those_of_the_whole(filled: Any, tmp_path: Path, wanted: tuple[str, ...]) -> None:
    here, there = folders(tmp_path)
    engine = Sequential()
    steps, metrics = computed(filled.store, here, None, wanted)
    of_slices = computed(filled.store, there, engine, wanted)
    assert metrics.num_rows > 20
    assert {*UNITS, "FOG-9"} == set(metrics["unit"].to_pylist())
    assert steps.equals(of_slices[0])
    assert metrics.equals(of_slices[1])
    assert [path.read_bytes() for path in sorted(here.rglob("*.sha256"))] == [
        path.read_bytes() for path in sorted(there.rglob("*.sha256"))
    ]  # what is kept is the same file
    # one unit a task, with the chamber and the supply of its runs in view, and no other unit
    records, values = ([task for task in engine.tasks if isinstance(task, kind)] for kind in (RecordsTask, ValuesTask))
    assert sorted(task.of.units for task in records) == sorted((unit,) for unit in UNITS)
    assert sorted(task.of.units for task in values) == sorted((unit,) for unit in (*UNITS, "FOG-9"))
    assert {task.of.seen for task in records} == {tuple(sorted((unit, "chamber", "PSU-1"))) for unit in UNITS}


@pytest.mark.long
def test_only_what_changed_is_computed_and_only_its_parts_are_opened(filled: Any, tmp_path: Path) -> None:
    here, there = folders(tmp_path)
    computed(filled.store, there, Sequential(), ["bias"])
    again = Sequential()
    computed(filled.store, there, again, ["bias"])
    assert again.tasks == []
    run, t_ns = "later", START_NS + 10**15
    filled.run(run, t_ns=t_ns, procedure="static_bias")
    with_rate = pa.array([5.0, 6.0, 7.0] * 20).to_numpy()
    filled.step(run, UNITS[0], with_rate, t0_ns=t_ns, dt_ns=SECOND_NS, position="IRA_up")
    filled.catalog().close()
    changed = Sequential()
    found = computed(filled.store, there, changed, ["bias"])
    assert [(type(task), task.of.units) for task in changed.tasks] == [
        (RecordsTask, UNITS[:1]), (ValuesTask, UNITS[:1]),
    ]  # fmt: skip
    (newest,) = (task.of.parts for task in changed.tasks if isinstance(task, RecordsTask))
    with Catalog(filled.store) as catalog:
        assert [part.name for part in newest] == [catalog.parts[-1].name]
        assert len(catalog.parts) == 2
    whole = computed(filled.store, here, None, ["bias"])
    assert set(found[1]["metric"].to_pylist()) == {"bias"}
    assert whole[0].equals(found[0])
    assert whole[1].equals(found[1])


@pytest.mark.long
def test_some_metrics_are_computed_alone(filled: Any, tmp_path: Path) -> None:
    here, there = folders(tmp_path)
    (_, whole), (_, found) = (
        computed(filled.store, here, None, ["bias"]),
        computed(filled.store, there, Sequential(), ["bias"]),
    )
    assert set(found["metric"].to_pylist()) == {"bias"}
    assert whole.equals(found)


def traced(store: Store, engine: Sequential | None = None) -> UnitsDiagnosis:
    tracing = None if engine is None else ClusterTracing(engine, nobody, nobody)
    with Catalog(store) as catalog:
        units = units_with(catalog, "rate")
        read = reduce_units(catalog, units, QUESTION, read=None if tracing is None else tracing.read)
    return trace_units(read, QUESTION, is_pooled=True, spread=None if tracing is None else tracing.spread)


@pytest.mark.long
def test_a_fleet_is_diagnosed_by_slices_as_by_the_whole(filled: Any) -> None:
    engine = Sequential()
    whole, found = traced(filled.store), traced(filled.store, engine)
    assert whole.fleet is not None
    assert found.fleet is not None
    assert whole.fleet.document() == found.fleet.document()
    assert list(whole.units) == list(found.units) == sorted(UNITS)
    for unit in UNITS:
        one, other = (each.units[unit].data.runs for each in (whole, found))
        for run, same in zip(one, other, strict=True):
            assert run.t0_ns == same.t0_ns
            assert run.value.tobytes() == same.value.tobytes()
            assert {name: each.mean.tobytes() for name, each in run.channels.items()} == {
                name: each.mean.tobytes() for name, each in same.channels.items()
            }
    assert sorted(task.of.units for task in engine.tasks if isinstance(task, ReadTask)) == [(u,) for u in sorted(UNITS)]


@pytest.mark.long
def test_processes_read_what_one_process_reads(filled: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    reports: list[str] = []
    assert local_reading(filled.store, 7, 2, reports.append) is read_units
    assert local_reading(filled.store, 100, 1, reports.append) is read_units
    assert not reports
    monkeypatch.setattr(diagnosis_tasks, "_FEWEST_UNITS", 2)
    question = replace(QUESTION, block_s=30.0)
    with Catalog(filled.store) as catalog:
        units = units_with(catalog, "rate")
        positions = position_numbers(catalog)
        one = read_units(catalog, units, question, positions, nobody_listens)
        several = local_reading(filled.store, len(units), 2, reports.append)(
            catalog, units, question, positions, nobody_listens
        )
    assert reports[0] == f"reading {len(units)} units by 2 processes"
    assert reports[-1] == f"reading: {len(units)} of {len(units)} units"
    assert list(one.units) == list(several.units) == sorted(UNITS)
    assert {unit: str(error) for unit, error in one.errors.items()} == {u: str(e) for u, e in several.errors.items()}
    for unit, read in one.units.items():
        for run, same in zip(read.runs, several.units[unit].runs, strict=True):
            assert run.value.tobytes() == same.value.tobytes()
            assert run.white_variance.tobytes() == same.white_variance.tobytes()


def nobody_listens(_: str) -> None:
    """Progress that nobody reads."""


def test_units_are_in_one_slice_each_and_the_largest_come_first(filled: Any) -> None:
    filled.run("long", t_ns=START_NS + 10**15)
    many = pa.array([1.0] * 40_000).to_numpy()
    filled.step("long", UNITS[1], many, t0_ns=START_NS + 10**15)
    with filled.catalog() as catalog:
        units = [*UNITS, "FOG-9"]
        slices = sliced(catalog, units, 1, rounds=2)
        assert slices[0].units == (UNITS[1],)  # the unit with most of the samples is alone, and begins first
        assert Counter(unit for each in slices for unit in each.units) == Counter(units)
        assert max(len(each.units) for each in sliced(catalog, units, 1, most=2, rounds=1)) == 2


def test_a_task_refuses_another_store_at_the_same_path(filled: Any) -> None:
    with Catalog(filled.store) as catalog:
        (part,) = sliced(catalog, UNITS[:1], 1, rounds=1)
    moved = filled.store.folder.rename(filled.store.folder.with_name("moved"))
    with pytest.raises(StoreError, match="there is no such folder"):
        part.open()
    Store.create(filled.store.folder)
    with pytest.raises(StoreError, match="is another store"):
        part.open()
    shutil.rmtree(filled.store.folder)
    moved.rename(filled.store.folder)
    part.open().close()
