"""The demonstration: eight simulated gyros through the whole path, and a diagnosis of their error models."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path

from analytics.loop.unit_diagnosis import UnitsDiagnosis, diagnose_units
from analytics.loop.unit_reduction import Question
from ingest.run.pipeline import EmbeddedPipeline
from ingest.simulator.demo_fleet import RUN_S, CycleRun, cycle_batches, cycle_runs, cycles_last_s, demo_fleet
from ingest.simulator.physics.plan import Plan
from ingest.simulator.station import PowerCycle, SimulatedStation
from storage.specifications.live_limits import UnitLimits, unit_limits
from storage.specifications.specification import parse_specification
from storage.sql.catalog import Catalog
from storage.store import Store
from stream import events
from stream.batch import SampleBatch
from stream.identity import Place, event_key, sample_key
from stream.quantities import report_unit

PLACE = Place("simulated", "demo-station")
DECLARED_MODEL = "rate = bias + scale_factor*input_rate + temperature"
_NAME, _LOT = "gyrofleet demo", "DEMO-LOT-1"
ESTIMATE_EVERY_S = 600.0
_BEFORE_S = 3600.0
_RATE_BATCH, _TEMPERATURE_BATCH = 1000, 60
# the simulated gyros at rest feel no Earth's rate
_AT_REST = events.StepWords(procedure="static_bias", position="IRA_east_west")


@dataclass
class UnitView:
    """State of one unit in the live view."""

    unit: str
    samples: int = 0
    rate_deg_per_h: float | None = None
    temperature_deg_c: float | None = None
    estimates: dict[str, events.EstimatePublished] = field(default_factory=dict)
    decisions: dict[events.Limit, events.EarlyDecision] = field(default_factory=dict)
    verdict: events.VerdictGiven | None = None


@dataclass
class DemoState:
    """Progress of the demonstration; written by the pipeline's threads, read by the live view."""

    run: str
    duration_s: float
    limits: UnitLimits
    units: dict[str, UnitView]
    began: float = field(default_factory=time.monotonic)
    simulated_s: float = 0.0
    samples: int = 0
    seconds: float = 0.0
    phase: str = "running"
    cycles: tuple[str, ...] = ()
    cycle_samples: int = 0
    found: UnitsDiagnosis | None = None


def demo_limits() -> UnitLimits:
    """Limits of the demonstration's specification, which ships with the package."""
    content = files("analytics.demo").joinpath("demo_limits.toml").read_bytes()
    found = unit_limits([parse_specification(content, "demo_limits.toml")], None, ["rate"])
    assert found is not None
    return found


def run_demo(
    folder: Path, *, hours: float, seed: int, on_progress: Callable[[DemoState], object] = lambda _: None
) -> DemoState:
    """Simulate the fleet for so many hours, send it through bus, log, lake and estimators, and judge it.

    `on_progress` is called several times a second, in the caller's thread. Raises GyrofleetError if any part of the
    path failed.
    """
    fleet = demo_fleet(seed)
    duration_s = hours * 3600.0
    began = datetime.now(UTC)
    t0_ns = (int(began.timestamp()) - round(duration_s)) * 10**9
    run = f"demo-{began:%Y%m%dT%H%M%SZ}"
    limits = demo_limits()
    state = DemoState(run, duration_s, limits, {unit: UnitView(unit) for unit in fleet.units})
    shown_at = 0.0

    def on_document(document: events.AnyDocument) -> None:
        if isinstance(document, events.EarlyDecision):
            state.units[document.unit].decisions[document.limit] = document
        elif isinstance(document, events.VerdictGiven):
            state.units[document.unit].verdict = document
        elif isinstance(document, events.EstimatePublished) and document.signal == "rate":
            state.units[document.unit].estimates[document.estimator] = document

    def on_batch(batch: SampleBatch) -> None:
        nonlocal shown_at
        _follow(state, batch, t0_ns)
        if time.monotonic() - shown_at >= 0.1:
            shown_at = time.monotonic()
            on_progress(state)

    def report(phase: str) -> None:
        state.phase = phase
        on_progress(state)

    with EmbeddedPipeline(folder, _NAME, estimate_every_s=ESTIMATE_EVERY_S, on_document=on_document) as pipeline:
        applied = events.LimitsApplied(
            run=run, t_ns=t0_ns, revision=limits.label, limits=limits.live, planned_s=duration_s
        )
        end_ns = t0_ns + round(duration_s * 1e9)
        station = SimulatedStation(fleet, run, batch=_RATE_BATCH, temperature_batch=_TEMPERATURE_BATCH)
        # the short runs come before in time
        batches = station.batches(run, PowerCycle(len(cycle_runs(0)), t0_ns), end_ns)
        steps = _steps(fleet.units, run, t0_ns, end_ns - station.dt_ns)
        first = (_started(fleet, run, t0_ns, "static_bias"), applied)
        _send_run(pipeline, PLACE, first, batches, steps, end_ns, on_batch)
        report("completing the record")
        pipeline.finish()
    state.seconds = time.monotonic() - state.began
    _close_the_loop(folder, fleet, state, t0_ns, report)
    report("done")
    return state


def _started(fleet: Plan, run: str, t_ns: int, procedure: str) -> events.RunStarted:
    source, units = f"simulated station, seed {fleet.seed}", fleet.units
    return events.RunStarted(
        run=run, t_ns=t_ns, simulated=True, source=source, units=units, procedure=procedure, lot=_LOT
    )


def _steps(units: tuple[str, ...], run: str, t0_ns: int, last_ns: int) -> Iterator[events.AnyDocument]:
    """The step of each unit: at rest throughout the run."""
    for unit in units:
        step = events.StepStarted(run=run, t_ns=t0_ns, unit=unit, words=_AT_REST)
        yield step
        yield events.StepEnded(run=run, t_ns=last_ns, unit=unit, step_uid=step.uid)


def _send_run(
    pipeline: EmbeddedPipeline, place: Place, first: Sequence[events.AnyDocument], batches: Iterable[SampleBatch],
    last: Iterable[events.AnyDocument], end_ns: int, on_batch: Callable[[SampleBatch], None] = lambda _: None,
) -> int:  # fmt: skip
    """Send the documents that begin a run, its samples, those that follow them, and its end; the number of samples."""
    key, run = event_key(place), first[0].run
    for document in first:
        pipeline.send_event(key, document)
    totals: dict[tuple[str, str], events.StreamTotal] = {}
    for batch in batches:
        unit, signal, epoch = batch.unit, batch.signal, str(batch.epoch)
        if (unit, signal) not in totals and signal == "rate":
            pipeline.send_event(key, events.PowerOn(run=run, t_ns=batch.t0_ns, unit=unit, epoch=epoch))
        pipeline.send_batch(sample_key(place, unit, signal), batch)
        totals[unit, signal] = events.StreamTotal(unit=unit, signal=signal, epoch=epoch, samples=batch.next_seq)
        on_batch(batch)
    for document in (*last, events.RunEnded(run=run, t_ns=end_ns, totals=tuple(totals.values()))):
        pipeline.send_event(key, document)
    return sum(each.samples for each in totals.values())


def _close_the_loop(folder: Path, fleet: Plan, state: DemoState, t0_ns: int, report: Callable[[str], None]) -> None:
    """Nine earlier short runs with temperature cycles and rates, and the diagnosis of each unit."""
    runs = cycle_runs(t0_ns - round((cycles_last_s() + _BEFORE_S) * 1e9))
    state.cycles = tuple(f"{state.run}-{each.kind}-{each.number}" for each in runs)
    with EmbeddedPipeline(folder, _NAME, estimate_every_s=RUN_S) as pipeline:  # of each run, at its end
        for run, name in zip(runs, state.cycles, strict=True):
            report(f"short runs: {name}")
            state.cycle_samples += send_cycle(pipeline, PLACE, fleet, run, name)
        pipeline.finish()
    question = Question(model=DECLARED_MODEL, runs=state.cycles)
    with Catalog(Store.open(folder)) as catalog:
        state.found = diagnose_units(catalog, fleet.units, question, on_progress=report)


def send_cycle(pipeline: EmbeddedPipeline, place: Place, fleet: Plan, run: CycleRun, name: str) -> int:
    """Send one of the short runs; the number of its samples."""
    first = [_started(fleet, name, run.t0_ns, run.kind)]
    end_ns = run.t0_ns + round(RUN_S * 1e9)
    return _send_run(pipeline, place, first, cycle_batches(fleet, run, name), (), end_ns)


def _follow(state: DemoState, batch: SampleBatch, t0_ns: int) -> None:
    view = state.units[batch.unit]
    state.samples += len(batch)
    view.samples += len(batch)
    state.simulated_s = (batch.last_ns - t0_ns) / 1e9
    mean = float(batch.value_array.mean())
    if batch.signal == "rate":
        view.rate_deg_per_h = mean * report_unit(batch.unit_of_measure)[1]
    else:
        view.temperature_deg_c = mean
