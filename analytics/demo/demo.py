"""The demonstration: eight simulated gyros through the whole path, faster than real time."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path

from analytics.demo.demo_loop import cycle_names, send_cycle, trace_fleet
from analytics.loop.unit_diagnosis import UnitsDiagnosis
from ingest.run.pipeline import EmbeddedPipeline
from ingest.simulator.demo_fleet import cycle_runs, cycles_last_s, demo_fleet
from ingest.simulator.physics.plan import Plan
from ingest.simulator.station import PowerCycle, SimulatedStation
from storage.specifications.live_limits import UnitLimits, unit_limits
from storage.specifications.specification import parse_specification
from stream.batch import SampleBatch
from stream.events import (
    AnyDocument,
    EarlyDecision,
    EstimatePublished,
    Limit,
    LimitsApplied,
    PowerOn,
    RunEnded,
    RunStarted,
    StepEnded,
    StepStarted,
    StepWords,
    StreamTotal,
    VerdictGiven,
)
from stream.identity import Place, event_key, sample_key
from stream.quantities import report_unit

PLACE = Place("simulated", "demo-station")
ESTIMATE_EVERY_S = 600.0
_BEFORE_S = 3600.0
_RATE_BATCH, _TEMPERATURE_BATCH = 1000, 60
# the simulated gyros at rest feel no Earth's rate
_AT_REST = StepWords(procedure="static_bias", position="IRA_east_west")


@dataclass
class UnitView:
    """State of one unit in the live view."""

    unit: str
    samples: int = 0
    rate_deg_per_h: float | None = None
    temperature_deg_c: float | None = None
    estimates: dict[str, EstimatePublished] = field(default_factory=dict)
    decisions: dict[Limit, EarlyDecision] = field(default_factory=dict)
    verdict: VerdictGiven | None = None


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

    def rate(self) -> float:
        """Samples a second since the beginning."""
        return self.samples / max(time.monotonic() - self.began, 1e-9)


def demo_limits() -> UnitLimits:
    """Limits of the demonstration's specification, which ships with the package.

    Examples
    --------
    >>> [limit.characteristic for limit in demo_limits().live]
    ['angle_random_walk', 'allan_deviation', 'bias_stability', 'bias_stability']
    """
    content = files("analytics.demo").joinpath("demo_limits.toml").read_bytes()
    found = unit_limits([parse_specification(content, "demo_limits.toml")], None, ["rate"])
    assert found is not None
    return found


def run_demo(
    folder: Path, *, hours: float, seed: int, on_progress: Callable[[DemoState], None] | None = None
) -> DemoState:
    """Simulate the fleet for so many hours, send it through bus, log, lake and estimators, and judge it.

    `on_progress` is called several times a second, in the caller's thread.

    Raises
    ------
    GyrofleetError: If any part of the path failed.
    """
    fleet = demo_fleet(seed)
    duration_s = hours * 3600.0
    began = datetime.now(UTC)
    t0_ns = (int(began.timestamp()) - round(duration_s)) * 10**9
    run = f"demo-{began:%Y%m%dT%H%M%SZ}"
    state = DemoState(run, duration_s, demo_limits(), {unit: UnitView(unit) for unit in fleet.units})

    def on_document(document: AnyDocument) -> None:
        if isinstance(document, EarlyDecision):
            state.units[document.unit].decisions[document.limit] = document
        elif isinstance(document, VerdictGiven):
            state.units[document.unit].verdict = document
        elif isinstance(document, EstimatePublished) and document.signal == "rate":
            state.units[document.unit].estimates[document.estimator] = document

    with EmbeddedPipeline(
        folder, "gyrofleet demo", estimate_every_s=ESTIMATE_EVERY_S, on_document=on_document
    ) as pipeline:
        events = event_key(PLACE)
        started = RunStarted(
            run=run,
            t_ns=t0_ns,
            simulated=True,
            source=f"simulated station, seed {seed}",
            units=fleet.units,
            procedure="static_bias",
            lot="DEMO-LOT-1",
        )
        pipeline.send_event(events, started)
        limits = state.limits
        pipeline.send_event(
            events, LimitsApplied(run=run, t_ns=t0_ns, revision=limits.label, limits=limits.live, planned_s=duration_s)
        )
        totals: dict[tuple[str, str], StreamTotal] = {}
        shown_at = 0.0
        end_ns = t0_ns + round(duration_s * 1e9)
        station = SimulatedStation(fleet, run, batch=_RATE_BATCH, temperature_batch=_TEMPERATURE_BATCH)
        # the short runs come before in time
        for batch in station.batches(run, PowerCycle(len(cycle_runs(0)), t0_ns), end_ns):
            if (batch.unit, batch.signal) not in totals and batch.signal == "rate":
                power_on = PowerOn(run=run, t_ns=batch.t0_ns, unit=batch.unit, epoch=str(batch.epoch))
                pipeline.send_event(events, power_on)
            pipeline.send_batch(sample_key(PLACE, batch.unit, batch.signal), batch)
            totals[batch.unit, batch.signal] = StreamTotal(
                unit=batch.unit, signal=batch.signal, epoch=str(batch.epoch), samples=batch.next_seq
            )
            _follow(state, batch, t0_ns)
            if on_progress is not None and time.monotonic() - shown_at >= 0.1:
                shown_at = time.monotonic()
                on_progress(state)
        _send_steps(pipeline, fleet.units, run, t0_ns, end_ns - station.dt_ns)
        pipeline.send_event(events, RunEnded(run=run, t_ns=end_ns, totals=tuple(totals.values())))
        state.phase = "completing the record"
        if on_progress is not None:
            on_progress(state)
        pipeline.finish()
    state.seconds = time.monotonic() - state.began
    _close_the_loop(folder, fleet, state, t0_ns, on_progress)
    state.phase = "done"
    if on_progress is not None:
        on_progress(state)
    return state


def _send_steps(pipeline: EmbeddedPipeline, units: tuple[str, ...], run: str, t0_ns: int, last_ns: int) -> None:
    """Send the step of each unit: at rest throughout the run."""
    for unit in units:
        step = StepStarted(run=run, t_ns=t0_ns, unit=unit, words=_AT_REST)
        pipeline.send_event(event_key(PLACE), step)
        pipeline.send_event(event_key(PLACE), StepEnded(run=run, t_ns=last_ns, unit=unit, step_uid=step.uid))


def _close_the_loop(
    folder: Path, fleet: Plan, state: DemoState, t0_ns: int, on_progress: Callable[[DemoState], None] | None
) -> None:
    """Nine earlier short runs with temperature cycles and rates, and the diagnosis of each unit."""

    def report(phase: str) -> None:
        state.phase = phase
        if on_progress is not None:
            on_progress(state)

    runs = cycle_runs(t0_ns - round((cycles_last_s() + _BEFORE_S) * 1e9))
    state.cycles = cycle_names(state.run, runs)
    with EmbeddedPipeline(folder, "gyrofleet demo", estimate_every_s=ESTIMATE_EVERY_S) as pipeline:
        for run, name in zip(runs, state.cycles, strict=True):
            report(f"short runs: {name}")
            state.cycle_samples += send_cycle(pipeline, PLACE, fleet, run, name)
        pipeline.finish()
    state.found = trace_fleet(folder, fleet.units, state.cycles, report)


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
