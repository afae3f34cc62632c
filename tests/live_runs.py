"""Runs of a live signal with an error model, as batches and documents."""

from collections.abc import Iterator, Sequence
from uuid import UUID

import numpy as np

from analytics.loop.live.live_compensator import LiveCompensator, Out
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.model.model_registry import ModelRegistry, ModelVersion
from analytics.loop.model.model_use import InUse
from storage.store import Store
from stream.batch import FloatArray, SampleBatch
from stream.events import AnyDocument, ModelActivated, RunEnded, StreamTotal
from stream.identity import Place

PLACE = Place("plant", "bench")
EPOCH = UUID(int=7)
T0_NS = 1_700_000_000 * 10**9
RATE_DT_NS = 100_000_000
SCALE = 2e-5
RUN_S = 1200
TEXT = "rate = bias + temperature + temperature_rate + thermal_lag(time_constant=600) + warm_up(time_constant=300)"
COEFFICIENTS = [100.0, 0.5, 2.0, 0.3, 4.0]


def version(text: str, coefficients: Sequence[float]) -> ModelVersion:
    model = ErrorModel.parse(text).fitted(coefficients, unit_of_measure="deg/h")
    return ModelVersion(
        unit="U1", signal="rate", version=0, parent=None, text=text, model=model, before=model,
        noise=ModelNoise(N=0.01, B=0.0, K=0.0, turn_on=0.1), block_s=30.0, longest_s=3600.0, runs={},
        training_runs=(), verdict="effect_found", added=(), holdout=None, made_ns=1, by="Li",
    )  # fmt: skip


def temperature(t_s: FloatArray) -> FloatArray:
    return np.asarray(25.0 + 10.0 * np.sin(2.0 * np.pi * t_s / 900.0))


def batches(signal: str, cut: int, *, stop_s: float = RUN_S, unit: str = "U1", run: str = "r1") -> list[SampleBatch]:
    """A signal of the run in batches of `cut` samples."""
    dt_ns = RATE_DT_NS if signal == "rate" else 10**9
    n = round(stop_s * 1e9 / dt_ns)
    t_s = np.arange(n) * dt_ns / 1e9
    if signal == "rate":
        deg_per_h = 100.0 + 0.5 * (temperature(t_s) - 25.0)
        counts, scale = np.rint(deg_per_h / 3600.0 / SCALE).astype(np.int32), SCALE
    else:
        counts, scale = np.rint(temperature(t_s) / 1e-3).astype(np.int32), 1e-3
    unit_of_measure = "deg/s" if signal == "rate" else "degC"
    return [
        SampleBatch(
            unit, signal, run, EPOCH, at, T0_NS + at * dt_ns, dt_ns, unit_of_measure,
            counts=counts[at : at + cut], scale=scale,
        )
        for at in range(0, n, cut)
    ]  # fmt: skip


def ended(run: str = "r1") -> RunEnded:
    totals = tuple(
        StreamTotal(unit="U1", signal=signal, epoch=str(EPOCH), samples=sum(map(len, batches(signal, 1000))))
        for signal in ("rate", "temperature")
    )
    return RunEnded(run=run, t_ns=T0_NS + RUN_S * 10**9, totals=totals)


def live(store: Store, text: str, coefficients: Sequence[float]) -> tuple[LiveCompensator, ModelVersion]:
    registry = ModelRegistry(store)
    written = registry.add(version(text, coefficients))
    document = ModelActivated(run="", t_ns=1, unit="U1", model=written.hash, version=1, signal="rate")
    return LiveCompensator(registry, {("U1", "rate"): InUse(live=document)}), written


def in_time(*signals: list[SampleBatch], delays_s: Sequence[float] = (0.0, 0.0)) -> Iterator[SampleBatch]:
    late = [
        (batch.last_ns + round(delay_s * 1e9), number, batch)
        for number, (signal, delay_s) in enumerate(zip(signals, delays_s, strict=True))
        for batch in signal
    ]
    yield from (batch for _, _, batch in sorted(late, key=lambda each: each[:2]))


def compensated(compensator: LiveCompensator, what: Iterator[SampleBatch], end: AnyDocument) -> list[Out]:
    out: list[Out] = []
    for batch in what:
        out += compensator.take(PLACE, batch)
    return out + compensator.take_document(PLACE, end)


def samples(out: Sequence[Out]) -> FloatArray:
    found = [what for _, what in out if isinstance(what, SampleBatch)]
    seqs = np.concatenate([np.arange(each.seq, each.next_seq) for each in found])
    assert np.array_equal(seqs, np.arange(seqs.size))  # nothing lost, nothing twice
    return np.concatenate([each.value_array for each in found])
