"""A fleet on a standalone Spark cluster against one process: ``python -m tests.bench.spark_scaling MODE``.

`scaling` writes a lake of units that stand still for `--hours` a day at 10 Hz, by default one, and times their step
records (from the lake's means of seconds) in one process with one thread, and on one and two workers of one core with
100 units a task: strong scaling on all units, weak scaling on half of them on one worker, and the overhead of tasks, by
the clock and in seconds of the processor. `fleet` takes
2,000 units over 30 days from their kept step records to metrics and verdicts. `diagnose` traces a fleet of such a lake,
each unit alone and all pooled, by the processes of the command and on the cluster. All compare the results with those
of one machine, to the last bit; with `--kill` a worker is killed in the middle.
"""

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from analytics.cluster.diagnosis_tasks import ClusterTracing, local_reading
from analytics.cluster.engine import Engine
from analytics.cluster.metric_tasks import ClusterComputation
from analytics.cluster.spark import SparkEngine
from analytics.evaluation.kept_metrics import unit_metrics
from analytics.loop.tracing.fleet import FleetDiagnosis
from analytics.loop.tracing.processors import processors
from analytics.loop.unit_diagnosis import trace_units
from analytics.loop.unit_reduction import Question, reduce_units
from analytics.specifications.verdicts import Verdicts, verdicts_of
from analytics.step_records.step_table import records_of, run_fingerprints
from storage.lake.builder import builder_lock
from storage.lake.channel_buffer import ChannelBuffer
from storage.lake.segment_content import channel_id
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import SampleBatch
from stream.events import (
    AnyDocument,
    PowerOn,
    RunStarted,
    SpecificationAction,
    SpecificationEntered,
    StepEnded,
    StepStarted,
    StepWords,
    UnitMounted,
)
from stream.identity import sample_key
from stream.wire.batches import encode_batch, read_raw_batch
from tests.bench.fleet_lake import DAY_NS, HOUR_S, PLACE, SECOND_NS, START_NS, Fleet, epoch_of, put_part, unit_names
from tests.bench.fleet_metrics import machine
from tests.bench.spark_cluster import StandaloneCluster

RATE_HZ = 10
_TURNS = 3  # in turn with one process; the quickest counts
SPECIFICATION = 'revision = "A"\n[[limit]]\nmetric = "bias"\nlower = -2.0\nupper = 2.0\nunit_of_measure = "deg/h"\n'
Progress = Callable[[int, int], None]


def write_days(folder: Path, units: int, days: int, hours: float) -> Store:
    """Units that stand still for some hours a day; a part for each day, as after its compaction."""
    store, rng = Store.create(folder), np.random.default_rng(3)
    dt_ns, n = SECOND_NS // RATE_HZ, round(hours * HOUR_S) * RATE_HZ
    for day in range(days):
        run, t0_ns = f"day-{day:02d}", START_NS + day * DAY_NS
        documents: list[AnyDocument] = [RunStarted(run=run, t_ns=t0_ns, procedure="static_bias")]
        buffers = []
        warm = 25.0 + 5.0 * np.sin(np.arange(n) / 6000.0 + day)
        for number, unit in enumerate(unit_names(units)):
            epoch = epoch_of(run, number)
            begun = StepStarted(
                run=run, t_ns=t0_ns, unit=unit, words=StepWords(procedure="static_bias", position="IRA_up")
            )
            documents += [
                UnitMounted(run=run, t_ns=t0_ns, unit=unit, product="FOG-70", lot=f"lot-{number // 50}"),
                PowerOn(run=run, t_ns=t0_ns, unit=unit, epoch=str(epoch)),
                begun,
                StepEnded(run=run, t_ns=t0_ns + (n - 1) * dt_ns, unit=unit, step_uid=begun.uid),
            ]
            rate = rng.normal(0.0, 3.0, n) + 1e-2 * (warm - 25.0) ** 2
            for signal, values, measure in (("rate", rate, "deg/h"), ("temperature", warm[::RATE_HZ], "degC")):
                each_ns = dt_ns if signal == "rate" else SECOND_NS
                counts = np.round(values * 1e3).astype(np.int32)
                batch = SampleBatch(unit, signal, run, epoch, 0, t0_ns, each_ns, measure, counts=counts, scale=1e-3)
                buffer = ChannelBuffer(channel_id(sample_key(PLACE, unit, signal), batch), PLACE, batch)
                buffer.add(read_raw_batch(encode_batch(batch)), batch.last_ns + 10**6)
                buffers.append(buffer)
        with builder_lock(store):
            put_part(store, day + 1, documents, gathered=buffers)
    return store


def ignore(_done: int, _total: int) -> None:
    """Progress that nobody reads."""


def say(text: str) -> None:
    """Progress of long work."""
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    begin = time.perf_counter()
    found = work()
    return time.perf_counter() - begin, found


def processor_timed(work: Callable[[], Any], processor_s: Callable[[], float]) -> tuple[float, float, Any]:
    used_s = processor_s()
    took_s, found = timed(work)
    return took_s, processor_s() - used_s, found


@contextmanager
def on_workers(
    folder: Path, workers: int, kills: bool = False
) -> Iterator[tuple[Engine, Progress, dict[str, int], StandaloneCluster]]:
    """An engine; its progress, which kills a worker at a third of the work if that is asked for; when it was killed."""
    killed: dict[str, int] = {}
    started = StandaloneCluster(folder / f"cluster-{workers}-{time.monotonic_ns()}", workers)
    with started as cluster, SparkEngine(cluster.engine) as engine:

        def progress(done: int, total: int) -> None:
            if kills and not killed and total // 3 <= done < total:
                killed["worker_killed_after_units"] = done
                cluster.kill_worker()

        yield engine, progress, killed, cluster


def records(store: Store, engine: Engine | None, progress: Progress, units: int | None = None) -> pa.Table:
    """Step records of all runs, of the first units if so many are given; in one process with one thread."""
    chosen = None if units is None else unit_names(units)
    with Catalog(store, units=chosen, threads=1) as catalog:
        prints = run_fingerprints(catalog)
        if engine is None:
            found = records_of(catalog, list(prints), prints, None)
        else:
            found = ClusterComputation(engine, progress).records(catalog, list(prints), prints, None)
        return found.sort_by([(name, "ascending") for name in ("run", "unit", "signal", "index")]).combine_chunks()


def scaling(folder: Path, units: int, days: int, kills: bool, hours: float) -> dict[str, Any]:
    written_s, store = timed(lambda: write_days(folder / "days", units, days, hours))
    half = units // 2
    one, one_half = records(store, None, ignore), records(store, None, ignore, half)
    sizes = {"units": units, "days": days, "hours_a_day": hours, "step_records": one.num_rows}
    found: dict[str, Any] = {**sizes, "written_s": written_s}

    def take(name: str, work: Callable[[], pa.Table], processor_s: Callable[[], float], expected: pa.Table) -> None:
        """Time work; the least of all turns counts."""
        took_s, used_s, table = processor_timed(work, processor_s)
        found[f"{name}_s"] = min(took_s, found.get(f"{name}_s", took_s))
        found[f"{name}_processor_s"] = min(used_s, found.get(f"{name}_processor_s", used_s))
        found[f"{name}_same_bits"] = table.equals(expected) and found.get(f"{name}_same_bits", True)

    for workers in (1, 2):
        with on_workers(folder, workers) as (engine, progress, _, cluster):
            records(store, engine, progress)  # starts the Python of each executor
            here, there = partial(records, store, None, ignore), partial(records, store, engine, progress)
            for _ in range(_TURNS):
                take("one_process", here, time.process_time, one)
                take(f"workers_{workers}", there, cluster.processor_s, one)
                if workers == 1:
                    take("one_process_half", partial(here, half), time.process_time, one_half)
                    take("weak_half_on_1", partial(there, half), cluster.processor_s, one_half)
    found["strong_speedup"] = found["workers_1_s"] / found["workers_2_s"]
    found["weak_efficiency"] = found["weak_half_on_1_s"] / found["workers_2_s"]
    found["overhead_of_tasks"] = found["workers_1_s"] / found["one_process_s"] - 1.0
    found["overhead_in_processor_time"] = found["workers_1_processor_s"] / found["one_process_processor_s"] - 1.0
    if kills:
        with on_workers(folder, 2, kills=True) as (engine, progress, killed, _):
            records(store, engine, ignore)
            table = records(store, engine, progress)
            found |= killed | {"killed_same_bits": table.equals(one)}
    return found


def judged(store: Store, kept: Path, engine: Engine | None, progress: Progress) -> tuple[pa.Table, Verdicts]:
    """Metrics and verdicts; what is kept goes to a folder."""
    with Catalog(store, kept=kept) as catalog, catalog.suspended_layers():
        unit_metrics(catalog, computation=None if engine is None else ClusterComputation(engine, progress))
        metrics = catalog.stored("unit_metrics")
    with Catalog(store, kept=kept, frozen=True) as catalog:
        return metrics, verdicts_of(catalog)


def fleet(folder: Path, units: int, days: int, kills: bool, _hours: float) -> dict[str, Any]:
    """Metrics and verdicts from the kept step records, which are copied for each try."""
    made = Fleet(folder / "fleet", units, days)
    written_s, _ = timed(made.write)
    entered = SpecificationEntered(
        run="",
        t_ns=START_NS,
        action=SpecificationAction.ADDED,
        name="FOG-70",
        revision="A",
        by="Li",
        content=SPECIFICATION,
    )
    with builder_lock(made.store):
        put_specification(made.store, entered, days + 2)
    kept = made.store.folder / "metrics"
    answers, found = {}, {"units": units, "days": days, "written_s": written_s}
    for name in ("one", "two"):
        (folder / name).mkdir()
        shutil.copytree(kept, folder / name / "metrics", ignore=shutil.ignore_patterns("unit_metrics*"))
    found["one_process_s"], answers["one"] = timed(lambda: judged(made.store, folder / "one", None, ignore))
    with on_workers(folder, 2, kills) as (engine, progress, killed, _):
        found["workers_2_s"], answers["two"] = timed(lambda: judged(made.store, folder / "two", engine, progress))
        found |= killed
    metrics, verdicts = answers["one"]
    found |= {
        "metric_rows": metrics.num_rows, "verdict_rows": len(verdicts.verdicts),
        "metrics_same_bits": metrics.equals(answers["two"][0]), "verdicts_same_bits": verdicts == answers["two"][1],
    }  # fmt: skip
    return found


def put_specification(store: Store, document: SpecificationEntered, number: int) -> None:
    """A part with a document, and a channel of a unit that nobody tests."""
    batch = SampleBatch(
        "none", "rate", "none", epoch_of("none", 0), 0, START_NS, SECOND_NS, "deg/h", values=np.zeros(1)
    )
    buffer = ChannelBuffer(channel_id(sample_key(PLACE, "none", "rate"), batch), PLACE, batch)
    buffer.add(read_raw_batch(encode_batch(batch)), batch.last_ns)
    put_part(store, number, [document], gathered=[buffer])


def traced(store: Store, engine: Engine | None, progress: Progress) -> FleetDiagnosis | None:
    """As `gyrofleet diagnose --fleet`, with an engine or by the processes of this machine."""
    question = Question("rate = bias + temperature")
    tracing = None if engine is None else ClusterTracing(engine, ignore, progress)
    with Catalog(store) as catalog:
        units = [unit for (unit,) in catalog.rows("select distinct unit from signals where signal = 'rate' order by 1")]
        read = local_reading(store, len(units), processors(), say) if tracing is None else tracing.read
        found = reduce_units(catalog, units, question, read=read)
    spread = None if tracing is None else tracing.spread
    return trace_units(found, question, is_pooled=True, processes=processors(), spread=spread).fleet


def diagnose(folder: Path, units: int, days: int, kills: bool, hours: float) -> dict[str, Any]:
    """Each unit alone and all pooled, here and on the cluster."""
    written_s, store = timed(lambda: write_days(folder / "days", units, days, hours))
    sizes = {"units": units, "days": days, "hours_a_day": hours, "written_s": written_s}
    here_s, here = timed(lambda: traced(store, None, ignore))
    found: dict[str, Any] = sizes | {"processes": processors(), "processes_s": here_s}
    print(found, flush=True)  # the cluster takes as long again
    with on_workers(folder, 2, kills) as (engine, progress, killed, _):
        found["workers_2_s"], there = timed(lambda: traced(store, engine, progress))
        found |= killed
    assert here is not None
    assert there is not None
    return found | {
        "verdict": here.verdict.value, "named_alone": sum(map(bool, (each.effects for each in here.units.values()))),
        "same_bits": here.document() == there.document(),
    }  # fmt: skip


MODES = {"scaling": (scaling, 200, 5), "fleet": (fleet, 2000, 30), "diagnose": (diagnose, 8, 6)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mode", nargs="?", choices=sorted(MODES), default="scaling")
    parser.add_argument("--units", type=int, help="by default 200 (scaling), 2000 (fleet), 8 (diagnose)")
    parser.add_argument("--days", type=int, help="by default 5, 30, 6")
    parser.add_argument("--hours", type=float, default=1.0, help="a day, of scaling and diagnose")
    parser.add_argument("--kill", action="store_true", help="kill a worker in the middle")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    run, units, days = MODES[options.mode]
    print(machine(), flush=True)
    folder = Path(tempfile.mkdtemp(prefix="gyrofleet-spark-"))
    try:
        found = run(folder, options.units or units, options.days or days, options.kill, options.hours)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    if options.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        print(f"{name:28} {value:.4g}" if isinstance(value, float) else f"{name:28} {value}", flush=True)


if __name__ == "__main__":
    main()
