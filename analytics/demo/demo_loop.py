"""The second part of the demonstration: nine short runs, and a diagnosis of the units' error model."""

from collections.abc import Callable
from pathlib import Path

from analytics.loop.unit_diagnosis import UnitsDiagnosis, diagnose_units
from analytics.loop.unit_reduction import Question
from ingest.run.pipeline import EmbeddedPipeline
from ingest.simulator.demo_fleet import RUN_S, CycleRun, cycle_batches
from ingest.simulator.physics.plan import Plan
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.events import PowerOn, RunEnded, RunStarted, StreamTotal
from stream.identity import Place, event_key, sample_key

DECLARED_MODEL = "rate = bias + scale_factor*input_rate + temperature"


def cycle_names(run: str, runs: tuple[CycleRun, ...]) -> tuple[str, ...]:
    """Names of the short runs that belong to the demonstration's `run`.

    Examples
    --------
    >>> from ingest.simulator.demo_fleet import cycle_runs
    >>> cycle_names("demo-1", cycle_runs(0))[0]
    'demo-1-temperature_cycle-1'
    """
    return tuple(f"{run}-{each.kind}-{each.number}" for each in runs)


def send_cycle(pipeline: EmbeddedPipeline, place: Place, fleet: Plan, run: CycleRun, name: str) -> int:
    """Send one of the short runs; the number of its samples.

    Raises
    ------
    GyrofleetError: If any part of the path failed.
    """
    events = event_key(place)
    pipeline.send_event(
        events,
        RunStarted(
            run=name,
            t_ns=run.t0_ns,
            simulated=True,
            source=f"simulated station, seed {fleet.seed}",
            units=fleet.units,
            procedure=run.kind,
            lot="DEMO-LOT-1",
        ),
    )
    totals: dict[tuple[str, str], StreamTotal] = {}
    for batch in cycle_batches(fleet, run, name):
        if (batch.unit, "rate") not in totals and batch.signal == "rate":
            pipeline.send_event(events, PowerOn(run=name, t_ns=batch.t0_ns, unit=batch.unit, epoch=str(batch.epoch)))
        pipeline.send_batch(sample_key(place, batch.unit, batch.signal), batch)
        totals[batch.unit, batch.signal] = StreamTotal(
            unit=batch.unit, signal=batch.signal, epoch=str(batch.epoch), samples=batch.next_seq
        )
    end_ns = run.t0_ns + round(RUN_S * 1e9)
    pipeline.send_event(events, RunEnded(run=name, t_ns=end_ns, totals=tuple(totals.values())))
    return sum(each.samples for each in totals.values())


def trace_fleet(
    folder: Path, units: tuple[str, ...], runs: tuple[str, ...], report: Callable[[str], None] = lambda _: None
) -> UnitsDiagnosis:
    """Trace every unit's residual over the short runs in the store.

    Raises
    ------
    GyrofleetError: If none can be traced.
    """
    with Catalog(Store.open(folder)) as catalog:
        return diagnose_units(catalog, units, Question(model=DECLARED_MODEL, runs=runs), on_progress=report)
