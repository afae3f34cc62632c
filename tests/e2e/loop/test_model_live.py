"""The loop closed on live data: found, promoted, compensated, watched, rolled back; and a process that is killed."""

import json
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
from click.testing import CliRunner

from analytics.commands.closed_loop.model import model
from analytics.demo.demo import DECLARED_MODEL, send_cycle
from analytics.loop.live.compensation_worker import CompensatingSender
from analytics.loop.live.live_compensator import LiveCompensator
from analytics.loop.live.residual_watch import watch_store
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.model.model_registry import ModelRegistry, ModelVersion
from analytics.loop.model.model_use import Stage, activate, read_uses
from analytics.loop.model_promotion import promotion_warnings
from ingest.run.pipeline import EmbeddedPipeline
from ingest.simulator import demo_fleet
from ingest.simulator.physics.bias import Bias
from ingest.simulator.physics.gyro import GyroParameters
from ingest.simulator.physics.noise import Noise
from ingest.simulator.physics.plan import Plan
from ingest.simulator.physics.thermal import Thermal
from storage.check.verify import verify
from storage.log.tail import LogTail
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.events import AnyDocument, ModelActivated, ResidualWatched, RunEnded, RunStarted, StreamTotal
from stream.identity import Place, event_key, sample_key
from stream.security.actor import Actor
from stream.transport.zenoh_bus import ZenohBus
from stream.wire.batches import decode_batch

PLACE = Place("plant", "bench")
UNIT = demo_fleet.ODD_UNIT
DAY_NS = 86_400 * 10**9
T0_NS = 1_700_000_000 * 10**9
GYRO = GyroParameters(
    noise=Noise(
        angle_random_walk_deg_per_sqrt_h=0.004,
        bias_instability_deg_per_h=0.02,
        rate_random_walk_deg_per_h_per_sqrt_h=0.005,
    ),
    bias=Bias(constant_deg_per_h=1.0, turn_on_deg_per_h=0.02),
    thermal=Thermal(bias_polynomial_deg_per_h=(0.01,)),
    sample_interval_ns=50_000_000,
)


class _Compensated(EmbeddedPipeline):
    """The whole path in one process, with compensation on the way in."""

    def __init__(self, folder: Path) -> None:
        store = Store.create(folder)
        super().__init__(folder, "a test")
        self._way = CompensatingSender(_Plain(self), LiveCompensator(ModelRegistry(store), read_uses(store)))

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        self._way.send_batch(key, batch)

    def send_event(self, key: str, document: AnyDocument) -> None:
        self._way.send_event(key, document)


class _Plain:
    """The way into a pipeline behind the compensation."""

    def __init__(self, pipeline: EmbeddedPipeline) -> None:
        self._pipeline = pipeline

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        EmbeddedPipeline.send_batch(self._pipeline, key, batch)

    def send_event(self, key: str, document: AnyDocument) -> None:
        EmbeddedPipeline.send_event(self._pipeline, key, document)


def measure(folder: Path, day: int, runs: int) -> list[str]:
    """Send runs of a day, the first of which is a temperature cycle, through the whole path."""
    names = []
    with _Compensated(folder) as pipeline:
        for run in demo_fleet.cycle_runs(T0_NS + day * DAY_NS)[:runs]:
            names.append(f"day-{day}-{run.number}")
            send_cycle(pipeline, PLACE, Plan(day + 1, {UNIT: GYRO}), run, names[-1])
        pipeline.finish()
    return names


def test_found_promoted_compensated_and_rolled_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "S"
    measure(folder, 0, 9)
    store = Store.open(folder)
    done = CliRunner().invoke(
        model, ["promote", "--store", str(folder), "--unit", UNIT, "--model", DECLARED_MODEL, "--by", "Li", "--json"]
    )
    assert done.exit_code == 0, done.output
    reported = json.loads(done.stdout)
    version = ModelRegistry(store).version(UNIT, reported["version"])
    assert (version.verdict == "confounded") == bool(version.confounded) == bool(reported["warnings"])
    assert "temperature_rate" in version.added
    assert version.is_confirmed
    assert len(version.runs) == 9

    # the effect is there: the compensated signal is steadier, and the watch agrees
    (run,) = measure(folder, 2, 1)
    with Catalog(store) as catalog:
        sql = (
            "select signal, value from estimates where run = $run and unit = $unit and final and tau_s > 400 "
            "and estimator = 'allan_deviation' and tau_s < 500"
        )
        allan = dict(catalog.rows(sql, {"run": run, "unit": UNIT}))
        counted = dict(
            catalog.rows(
                "select signal, samples from signals where run = $run and unit = $unit", {"run": run, "unit": UNIT}
            )
        )
    # 0.25 deg/h/(degC/min) by 3 degC/min in the ramps; beside it the noise, whose deviation at 400 s is near 0.02 deg/h
    assert allan["rate"] > 0.5
    assert allan["rate_compensated"] < 0.2 * allan["rate"]
    assert counted["rate_compensated"] == counted["rate"] == 36_000
    found, _ = verify(store)
    assert found.is_sound, found.findings
    (watched,) = watch_store(store)
    assert isinstance(watched, ResidualWatched)
    assert watched.gain is not None
    assert watched.gain > 100.0
    assert not watched.is_refused
    assert watch_store(store) == []

    # the effect has gone: the model is refused, and the next run is not compensated any more
    monkeypatch.setattr(demo_fleet, "ODD_UNIT", "none")
    measure(folder, 4, 1)
    refused, off = watch_store(store)
    assert isinstance(refused, ResidualWatched)
    assert refused.is_refused
    assert isinstance(off, ModelActivated)
    assert (off.stage, off.version) == ("off", 1)
    assert "residual watch refuses it" in off.reason
    assert read_uses(store)[UNIT, "rate"].activations == ()
    warnings = promotion_warnings(store, ModelRegistry(store).version(UNIT, 1))
    assert sum("the watch of its residual took it off" in each for each in warnings) == 1
    (run,) = measure(folder, 6, 1)
    with Catalog(store) as catalog:
        assert (
            catalog.rows("select signal from signals where run = $run and ends_with(signal, 'd')", {"run": run}) == []
        )


RATE_DT_NS, SCALE = 100_000_000, 2e-5
RUN_S = 600
EPOCH = UUID(int=7)


def batches() -> Iterator[SampleBatch]:
    for second in range(0, RUN_S, 10):
        t_s = second + np.arange(10)
        deg_c = 25.0 + 5.0 * np.sin(2.0 * np.pi * t_s / 300.0)
        t0_ns = T0_NS + second * 10**9
        yield SampleBatch("U1", "temperature", "r1", EPOCH, second, t0_ns, 10**9, "degC", values=deg_c)
        counts = np.full(100, round(100.0 / 3600.0 / SCALE), np.int32)
        yield SampleBatch(
            "U1", "rate", "r1", EPOCH, second * 10, t0_ns, RATE_DT_NS, "deg/s", counts=counts, scale=SCALE
        )


def compensated(store: Store) -> list[SampleBatch]:
    messages = LogTail(store).since({})
    return [decode_batch(each.payload) for each in messages if each.stream.key.endswith("rate_compensated")]


def until(seen: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + 60.0
    while not seen():
        assert time.monotonic() < end, what
        time.sleep(0.2)


@pytest.mark.long
def test_a_killed_process_goes_on_and_nothing_is_lost_or_twice(
    tmp_path: Path, spawn: Callable[..., subprocess.Popen[str]], endpoint: str
) -> None:
    store = Store.create(tmp_path / "S")
    fitted = ErrorModel.parse("rate = bias + temperature").fitted([100.0, 0.5], unit_of_measure="deg/h")
    version = ModelRegistry(store).add(
        ModelVersion(
            unit="U1", signal="rate", version=0, parent=None, text=str(fitted), model=fitted, before=fitted,
            noise=ModelNoise(N=0.01, B=0.0, K=0.0, turn_on=0.1), block_s=30.0, longest_s=3600.0, runs={},
            training_runs=(), verdict="nothing_missing", added=(), holdout=None, made_ns=1, by="Li",
        )
    )  # fmt: skip
    activate(store, version, Stage.LIVE, reason="", by=Actor("Li"))
    recorder = spawn("record", "--store", "S", "--listen", endpoint, "--json")
    assert recorder.stdout is not None
    assert "recording" in recorder.stdout.readline()
    first = spawn("compensate", "--store", "S")
    with ZenohBus(connect=[endpoint]) as bus, DurablePublisher(bus) as source:
        source.send_event(event_key(PLACE), RunStarted(run="r1", t_ns=T0_NS, units=("U1",)))
        everything = list(batches())
        for batch in everything[:80]:
            source.send_batch(sample_key(PLACE, batch.unit, batch.signal), batch)
        until(lambda: bool(compensated(store)), "nothing was compensated")
        first.kill()
        first.wait()
        spawn("compensate", "--store", "S")
        for batch in everything[80:]:
            source.send_batch(sample_key(PLACE, batch.unit, batch.signal), batch)
        totals = tuple(
            StreamTotal(unit="U1", signal=name, epoch=str(EPOCH), samples=samples)
            for name, samples in (("rate", RUN_S * 10), ("temperature", RUN_S))
        )
        source.send_event(event_key(PLACE), RunEnded(run="r1", t_ns=T0_NS + RUN_S * 10**9, totals=totals))
        until(lambda: sum(map(len, compensated(store))) >= RUN_S * 10, "not all was compensated")
    recorder.send_signal(signal.SIGINT)
    recorder.wait(timeout=30)
    found = compensated(store)
    assert np.array_equal(np.concatenate([np.arange(each.seq, each.next_seq) for each in found]), np.arange(RUN_S * 10))
    deg_per_h = np.concatenate([each.value_array for each in found]) * 3600.0
    t_s = np.arange(deg_per_h.size) / 10.0
    expected = 100.0 - 0.5 * 5.0 * np.sin(2.0 * np.pi * t_s / 300.0)
    assert np.abs(deg_per_h - expected).max() < 0.5 * SCALE * 3600.0 + 0.5 * 0.5 * 5.0 * 2.0 * np.pi / 300.0 * 5.0
