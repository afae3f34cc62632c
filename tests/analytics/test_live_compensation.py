"""Compensated samples: what the model predicts is gone, whatever pieces and whatever order the samples came in."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import pytest

from analytics.loop.live.compensating_sender import CompensatingSender
from analytics.loop.live.compensation_worker import CompensationWorker
from analytics.loop.live.epoch_compensation import compensated_epoch
from analytics.loop.live.live_compensator import LiveCompensator, Out
from analytics.loop.model.error_model import ErrorModel, ModelTerm
from analytics.loop.model.live_terms import check_live, live_part, why_not_live
from analytics.loop.model.model_registry import ModelRegistry, ModelVersion
from analytics.loop.model.model_use import InUse, Stage, activate
from analytics.loop.model.noise import NoiseCoefficients
from storage.log.event_log import EventLog
from storage.log.tail import LogTail
from storage.recording.recorder import Recorder
from storage.store import Store, WriterLock
from stream.batch import FloatArray, SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.errors import BadInput
from stream.events import (
    AnyDocument,
    CompensationStarted,
    ModelActivated,
    NoteAdded,
    PowerOn,
    RunEnded,
    RunStarted,
    StreamTotal,
)
from stream.identity import Place, event_key, sample_key
from stream.transport.bus import LocalBus
from stream.wire.batches import decode_batch

PLACE = Place("plant", "bench")
EPOCH = UUID(int=7)
T0_NS = 1_700_000_000 * 10**9
RATE_DT_NS = 100_000_000
SCALE = 2e-5
RUN_S = 1200


def version(text: str, coefficients: Sequence[float]) -> ModelVersion:
    model = ErrorModel.parse(text).fitted(coefficients, unit_of_measure="deg/h")
    return ModelVersion(
        unit="U1", signal="rate", version=0, parent=None, text=text, model=model, before=model,
        noise=NoiseCoefficients(N=0.01, B=0.0, K=0.0, turn_on=0.1), block_s=30.0, longest_s=3600.0, runs={},
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


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store.create(tmp_path / "S")


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


def test_what_the_model_predicts_is_gone_and_the_bias_stays(store: Store) -> None:
    compensator, written = live(store, "rate = bias + temperature", [100.0, 0.5])
    out = compensated(compensator, in_time(batches("rate", 100), batches("temperature", 10)), ended())
    values = samples(out) * 3600.0
    assert values.size == RUN_S * 10
    raw_step, fine_step = SCALE * 3600.0, SCALE * 360.0
    # at the ends the correction is that of the nearest block's middle, 2.5 s away, at the steepest 0.07 degC/s
    assert np.abs(values - 100.0).max() < 0.5 * raw_step + 0.5 * fine_step + 0.5 * 0.07 * 2.5
    assert values.std() < 0.5 * raw_step
    (begun,) = [what for _, what in out if isinstance(what, CompensationStarted)]
    assert (begun.model, begun.compensated) == (written.hash, "rate_compensated")
    first = next(what for _, what in out if isinstance(what, SampleBatch))
    assert first.scale == pytest.approx(SCALE / 10.0)
    assert first.epoch == compensated_epoch(EPOCH, "r1", written.hash, 0)


TEXT = "rate = bias + temperature + temperature_rate + thermal_lag(time_constant=600) + warm_up(time_constant=300)"
COEFFICIENTS = [100.0, 0.5, 2.0, 0.3, 4.0]


@pytest.mark.parametrize(
    ("cuts", "delays_s"),
    [
        ((7, 3), (0.0, 0.0)),
        ((1000, 60), (0.0, 0.0)),
        ((100, 10), (0.0, 300.0)),
        ((61, 7), (90, 0)),
        ((12_000, 10), (0.0, 1300.0)),  # as from a file, in a piece longer than the patience
    ],
)
def test_the_result_is_a_function_of_the_samples_alone(
    tmp_path: Path, cuts: tuple[int, int], delays_s: tuple[float, float]
) -> None:
    found = []
    for name, cut, delay_s in (("A", (100, 10), (0.0, 0.0)), ("B", cuts, delays_s)):
        compensator, _ = live(Store.create(tmp_path / name), TEXT, COEFFICIENTS)
        compensator.take_document(PLACE, PowerOn(run="r1", t_ns=T0_NS - 10**10, unit="U1", epoch=str(EPOCH)))
        both = in_time(batches("rate", cut[0]), batches("temperature", cut[1]), delays_s=delay_s)
        found.append(samples(compensated(compensator, both, ended())))
    assert found[0].tobytes() == found[1].tobytes()


def test_a_run_waits_for_its_last_samples(store: Store) -> None:
    compensator, _ = live(store, TEXT, COEFFICIENTS)
    *most, last = in_time(batches("rate", 100), batches("temperature", 10))
    out: list[Out] = []
    for batch in most:
        out += compensator.take(PLACE, batch)
    out += compensator.take_document(PLACE, ended())
    assert compensator.totals("r1")
    out += compensator.take(PLACE, last)
    assert samples(out).size == RUN_S * 10
    assert compensator.totals("r1") == ()


def test_a_run_that_goes_on_after_its_end_is_compensated_in_a_stream_of_its_own(store: Store) -> None:
    compensator, _ = live(store, "rate = bias + temperature", [100.0, 0.5])
    everything = list(in_time(batches("rate", 100), batches("temperature", 10)))
    half = len(everything) // 2
    end = RunEnded(run="r1", t_ns=T0_NS)
    before, after = (compensated(compensator, iter(part), end) for part in (everything[:half], everything[half:]))
    assert samples(before).size + samples(after).size == RUN_S * 10
    first, second = (next(what for _, what in out if isinstance(what, CompensationStarted)) for out in (before, after))
    assert first.compensated_epoch != second.compensated_epoch
    assert (first.first_seq, second.first_seq) == (0, samples(before).size)


def test_a_missing_channel_is_told_and_nothing_is_sent(store: Store) -> None:
    compensator, _ = live(store, "rate = bias + temperature", [100.0, 0.5])
    out = compensated(compensator, iter(batches("rate", 100)), RunEnded(run="r1", t_ns=T0_NS))
    assert not [what for _, what in out if isinstance(what, SampleBatch)]
    (note,) = [what for _, what in out if isinstance(what, NoteAdded)]
    assert "cannot do without channel temperature: nothing of it was recorded" in note.text


def test_of_several_instruments_none_is_guessed(store: Store) -> None:
    compensator, _ = live(store, "rate = bias + temperature", [100.0, 0.5])
    ends = RunEnded(run="r1", t_ns=T0_NS)
    one, other = batches("temperature", 10, unit="chamber-1"), batches("temperature", 10, unit="chamber-2")
    out = compensated(compensator, in_time(batches("rate", 100), one, other, delays_s=(0, 0, 0)), ends)
    (note,) = [what for _, what in out if isinstance(what, NoteAdded)]
    assert "several instruments give it: chamber-1, chamber-2" in note.text


def test_the_temperature_of_another_unit_is_not_taken(store: Store) -> None:
    compensator, _ = live(store, "rate = bias + temperature", [100.0, 0.5])
    compensator.take_document(PLACE, RunStarted(run="r1", t_ns=T0_NS, units=("U1", "U2")))
    others = batches("temperature", 10, unit="U2")
    out = compensated(compensator, in_time(batches("rate", 100), others), RunEnded(run="r1", t_ns=T0_NS))
    assert [type(what).__name__ for _, what in out] == ["CompensationStarted", "NoteAdded"]


def test_a_channel_that_stops_is_held(store: Store) -> None:
    compensator, _ = live(store, "rate = bias + temperature", [100.0, 0.5])
    stops_s = 300
    out: list[Out] = []
    for batch in in_time(batches("rate", 100), batches("temperature", 10, stop_s=stops_s)):
        out += compensator.take(PLACE, batch)
    values = samples(out) * 3600.0
    # ten minutes of patience, 65 s to look ahead, 30 s from one evaluation to the next
    assert values.size / 10 >= RUN_S - 600 - 65 - 30 - 10
    (note,) = [what for _, what in out if isinstance(what, NoteAdded)]
    assert "channel temperature stops at 299 s" in note.text
    t_s = np.arange(values.size) / 10.0
    expected = 100.0 + 0.5 * (temperature(t_s) - temperature(np.minimum(t_s, stops_s)))
    assert np.abs(values - expected).max() < 0.25


def test_counts_that_would_not_fit_become_values(store: Store) -> None:
    compensator, _ = live(store, "rate = bias + temperature", [100.0, 0.5])
    wide = [changed(batch, counts=np.full(len(batch), 2**30, np.int32)) for batch in batches("rate", 1000, stop_s=200)]
    out = compensated(compensator, in_time(wide, batches("temperature", 10)), RunEnded(run="r1", t_ns=T0_NS))
    first = next(what for _, what in out if isinstance(what, SampleBatch))
    assert first.counts is None
    expected = 2**30 * SCALE
    assert first.value_array[0] == pytest.approx(expected, abs=0.01)


def changed(batch: SampleBatch, **changes: Any) -> SampleBatch:
    return replace(batch, **changes)


def test_a_model_acts_from_the_next_power_on_on(store: Store) -> None:
    compensator, written = live(store, "rate = bias + temperature", [100.0, 0.5])
    first, second, *rest = in_time(batches("rate", 100), batches("temperature", 10))
    out = compensator.take(PLACE, first) + compensator.take(PLACE, second)
    off = ModelActivated(run="", t_ns=2, unit="U1", model=written.hash, version=1, signal="rate", stage="off")
    compensator.take_document(PLACE, off)
    out += compensated(compensator, iter(rest), ended())
    assert samples(out).size == RUN_S * 10
    later = [changed(batch, run="r2") for batch in batches("rate", 100, stop_s=200)]
    assert compensated(compensator, iter(later), RunEnded(run="r2", t_ns=T0_NS)) == []


def test_a_model_that_cannot_be_read_is_told_and_others_go_on(store: Store) -> None:
    compensator, written = live(store, "rate = bias + temperature", [100.0, 0.5])
    (store.folder / "models" / "U1" / f"0001-{written.hash}.json").write_text("{}")
    out = compensated(compensator, in_time(batches("rate", 100), batches("temperature", 10)), ended())
    (note,) = [what for _, what in out]
    assert isinstance(note, NoteAdded)
    assert "does not have its hash" in note.text


def test_terms_that_look_further_ahead_or_need_what_is_not_live_are_refused() -> None:
    for name in ("ageing", "table_angle_harmonic_1", "angular_acceleration", "stale_temperature"):
        assert why_not_live(ModelTerm(name)) is not None, name
    model = ErrorModel.parse("rate = bias + ageing").fitted([1.0, 2.0])
    with pytest.raises(BadInput, match="leave the term out"):
        check_live("U1", model)
    with pytest.raises(BadInput, match="nothing to compensate"):
        check_live("U1", ErrorModel.parse("rate = bias + scale_factor*input_rate").fitted([1.0, 2.0]))
    check_live("U1", ErrorModel.parse(TEXT).fitted(COEFFICIENTS))
    assert live_part(ErrorModel.parse(TEXT).fitted(COEFFICIENTS)).coefficients == tuple(COEFFICIENTS[1:])


class _Kept:
    """A sender that keeps what it is given."""

    def __init__(self) -> None:
        self.events: list[AnyDocument] = []
        self.batches: list[tuple[str, SampleBatch]] = []

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        self.batches.append((key, batch))

    def send_event(self, key: str, document: AnyDocument) -> None:
        assert key == event_key(PLACE)
        self.events.append(document)


def test_in_one_process_the_end_of_a_run_counts_what_was_compensated(store: Store) -> None:
    compensator, _ = live(store, TEXT, COEFFICIENTS)
    kept = _Kept()
    sender = CompensatingSender(kept, compensator)
    for batch in in_time(batches("rate", 100), batches("temperature", 10)):
        sender.send_batch(sample_key(PLACE, batch.unit, batch.signal), batch)
    sender.send_event(event_key(PLACE), ended())
    last = kept.events[-1]
    assert isinstance(last, RunEnded)
    totals = {each.signal: each.samples for each in last.totals}
    assert totals == {"rate": RUN_S * 10, "temperature": RUN_S, "rate_compensated": RUN_S * 10}
    assert samples([(PLACE, batch) for key, batch in kept.batches if key.endswith("_compensated")]).size == RUN_S * 10


def test_a_worker_that_is_killed_goes_on_and_nothing_is_lost_or_twice(store: Store) -> None:
    written = ModelRegistry(store).add(version(TEXT, COEFFICIENTS))
    activate(store, written, Stage.LIVE, reason="", by="Li")
    everything = list(in_time(batches("rate", 100), batches("temperature", 10)))
    expected, _ = live(Store.create(store.folder.parent / "E"), TEXT, COEFFICIENTS)
    out = compensated(expected, iter(everything), ended())
    with (
        LocalBus() as bus,
        WriterLock(store, "a test"),
        Recorder(store, bus, EventLog(store), sync_interval_s=0.01),
        DurablePublisher(bus) as source,
    ):
        for part in range(4):
            size = len(everything) // 4 + 1
            for batch in everything[part * size : (part + 1) * size]:
                source.send_batch(sample_key(PLACE, batch.unit, batch.signal), batch)
            if part == 3:
                source.send_event(event_key(PLACE), ended())
            source.drain()
            own = DurablePublisher(bus)
            worker = CompensationWorker(store, own)
            worker.look()
            if part == 3:
                own.drain()
            own.abandon()  # killed with what was not acknowledged
        again = DurablePublisher(bus)
        last = CompensationWorker(store, again)
        last.look()
        assert last.samples == 0  # the log has it all
        again.abandon()
        found = [
            decode_batch(message.payload)
            for message in LogTail(store).since({})
            if message.stream.key.endswith("_compensated")
        ]
    assert samples([(PLACE, batch) for batch in found]).tobytes() == samples(out).tobytes()


def test_what_cannot_be_compensated_is_told_once_however_often_the_worker_starts(store: Store) -> None:
    written = ModelRegistry(store).add(version(TEXT, COEFFICIENTS))
    activate(store, written, Stage.LIVE, reason="", by="Li")
    said: list[list[str]] = []
    with (
        LocalBus() as bus,
        WriterLock(store, "a test"),
        Recorder(store, bus, EventLog(store), sync_interval_s=0.01),
        DurablePublisher(bus) as source,
    ):
        for batch in batches("rate", 1000):
            source.send_batch(sample_key(PLACE, batch.unit, batch.signal), batch)
        for part in range(3):
            if part == 1:
                source.send_event(event_key(PLACE), RunEnded(run="r1", t_ns=T0_NS))
            source.drain()
            heard: list[str] = []
            with DurablePublisher(bus) as own:
                worker = CompensationWorker(store, own, on_document=lambda each: heard.append(type(each).__name__))  # noqa: B023
                worker.look()
            said.append(heard)
    assert said == [["CompensationStarted"], ["NoteAdded"], []]
