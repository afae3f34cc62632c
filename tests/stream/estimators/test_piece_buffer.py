"""Documents are a function of the samples: not of how they were cut into batches, nor of stops in between."""

from collections.abc import Iterator
from typing import NamedTuple
from uuid import UUID

import msgspec
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stream.batch import SampleBatch
from stream.estimators.base import default_estimators
from stream.events import (
    AnyDocument,
    EstimatePublished,
    Limit,
    LimitsApplied,
    RunEnded,
    SpectralLinesFound,
    encode_event,
)
from stream.identity import Place, event_key, sample_key
from stream.wire.batches import encode_batch, read_wire_batch
from stream.worker.estimation import Estimation
from stream.worker.piece_buffer import PIECE_SAMPLES, PieceBuffer
from stream.worker.signal_analysis import SignalAnalysis, SignalState, new_estimators
from tests.stream.examples import examples

DT_NS = 10**7
PLACE = Place("plant", "bench")
NOISE = np.random.default_rng(7).integers(-200, 200, 20_000).astype(np.int32)
LIMITS = LimitsApplied(
    run="r1",
    t_ns=0,
    revision="R",
    planned_s=60.0,
    limits=(
        Limit(characteristic="bias_stability", signal="rate", tau_s=1.0, upper=100.0, unit_of_measure="deg/h"),
        Limit(characteristic="allan_deviation", signal="rate", tau_s=3.0, upper=5000.0, unit_of_measure="deg/h"),
    ),
)


class Stretch(NamedTuple):
    """Samples that share what a batch has of them."""

    epoch: int
    seq: int
    dt_ns: int
    times_ns: npt.NDArray[np.int64]
    counts: npt.NDArray[np.int32]
    is_counts: bool
    irregular: bool

    def batch(self, start: int, stop: int, *, written_out: bool) -> SampleBatch:
        times = self.times_ns[start:stop]
        is_exact = np.array_equal(times, times[0] + self.dt_ns * np.arange(len(times)))
        values = np.where(self.counts[start:stop] == 13, np.nan, self.counts[start:stop] * 0.5)
        return SampleBatch(
            "U1",
            "rate",
            "r1",
            UUID(int=self.epoch),
            self.seq + start,
            int(times[0]),
            self.dt_ns,
            "deg/s",
            counts=self.counts[start:stop] if self.is_counts else None,
            values=None if self.is_counts else values,
            times_ns=times if written_out or not is_exact else None,
            irregular=self.irregular,
            scale=0.25,
            offset=1.0,
        )


@st.composite
def signals(draw: st.DrawFn) -> list[Stretch]:
    """A signal with gaps, jumps of the clock, jitter, new epochs, lost samples, and another interval or form."""
    stretches = []
    t_ns, seq, epoch, at = draw(st.integers(-(10**12), 10**18)), 0, 1, 0
    irregular = draw(st.booleans()) and draw(st.booleans())
    for _ in range(draw(st.integers(1, 4))):
        n = draw(st.integers(1, 3000))
        dt_ns = DT_NS + draw(st.sampled_from([0, 0, 0, 5000, 10**7]))
        steps = np.full(n, dt_ns)
        if draw(st.booleans()):
            steps += np.random.default_rng(draw(st.integers(0, 99))).integers(-(dt_ns // 8), dt_ns // 8, n)
        for _ in range(draw(st.integers(0, 2))):
            steps[draw(st.integers(0, n - 1))] = draw(st.sampled_from([3 * dt_ns, 10**10, -3 * dt_ns, 0]))
        times = t_ns + np.cumsum(steps)
        t_ns = int(times[-1])
        if draw(st.booleans()):
            epoch, seq = epoch + 1, draw(st.sampled_from([0, 17]))
        else:
            seq += draw(st.sampled_from([0, 0, 0, 100]))
        counts = NOISE[at : at + n]
        stretches.append(Stretch(epoch, seq, dt_ns, times, counts, draw(st.booleans()), irregular))
        seq, at = seq + n, at + n
    return stretches


def cut(data: st.DataObject, stretch: Stretch) -> Iterator[SampleBatch]:
    n = len(stretch.counts)
    most = data.draw(st.sampled_from([1, 10, 100, 700, 5000]))
    at = 0
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    while at < n:
        stop = min(n, at + int(rng.integers(1, most + 1)))
        yield stretch.batch(at, stop, written_out=bool(rng.integers(0, 3) == 0))
        at = stop


def documents(
    signal: list[Stretch], data: st.DataObject, every_ns: int, *, stops: bool
) -> tuple[dict[str, bytes], list[AnyDocument]]:
    estimators = {key: make for key, make in default_estimators().items() if key != "bias_stability_100s"}
    analysis = SignalAnalysis(PLACE, ("U1", "rate", "r1"), every_ns, new_estimators(estimators))
    analysis.apply_limits(LIMITS)
    found: list[AnyDocument] = []
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    for stretch in signal:
        for batch in cut(data, stretch):
            found += [document for _, document in analysis.take(read_wire_batch(encode_batch(batch)))]
            if stops and rng.integers(0, 20) == 0:
                packed = msgspec.msgpack.encode(analysis.export_state())
                analysis = SignalAnalysis.from_state(msgspec.msgpack.decode(packed, type=SignalState))
    found += [document for _, document in analysis.finish()]
    by_uid = {document.uid: msgspec.json.encode(document) for document in found}
    assert len(by_uid) == len(found), "two documents of one identity"
    return by_uid, found


@examples(4, 12, signals(), st.data())
def test_documents_do_not_depend_on_how_batches_were_cut(signal: list[Stretch], data: st.DataObject) -> None:
    every_ns = data.draw(st.sampled_from([7 * 10**9 + 1, 20 * 10**9]))
    once, _ = documents(signal, data, every_ns, stops=False)
    assert documents(signal, data, every_ns, stops=True)[0] == once
    is_refused = max(stretch.dt_ns for stretch in signal) > 1.001 * min(stretch.dt_ns for stretch in signal)
    is_long = sum(len(stretch.counts) for stretch in signal) > 300
    assert any(b'"points":[{' in document for document in once.values()) or is_refused or not is_long


@pytest.mark.long
@given(signals(), st.data())
@settings(max_examples=30, deadline=None)
def test_pieces_hold_every_sample_once_in_order_and_end_where_documents_are_due(
    signal: list[Stretch], data: st.DataObject
) -> None:
    every_ns = 3 * 10**9
    buffer = PieceBuffer(("U1", "rate", "r1"), every_ns)
    pieces = []
    for stretch in signal:
        for batch in cut(data, stretch):
            pieces += buffer.take(read_wire_batch(encode_batch(batch)))
            if data.draw(st.booleans()) if len(pieces) < 3 else False:
                packed = msgspec.msgpack.encode(buffer)
                buffer = msgspec.msgpack.decode(packed, type=PieceBuffer)
    pieces += buffer.rest()
    assert not buffer.rest()
    times = np.concatenate([stretch.times_ns for stretch in signal])
    values = np.concatenate([stretch.batch(0, len(stretch.counts), written_out=True).value_array for stretch in signal])
    np.testing.assert_array_equal(np.concatenate([piece.batch.time_array for piece in pieces]), times)
    np.testing.assert_array_equal(np.concatenate([piece.batch.value_array for piece in pieces]), values)
    assert max(len(piece.batch) for piece in pieces) <= PIECE_SAMPLES
    assert [piece.last_ns for piece in pieces] == [int(piece.batch.time_array.max()) for piece in pieces]
    expected, due = [], int(times[0]) + every_ns
    for t_ns in times.tolist():
        if t_ns >= due:
            expected.append(t_ns)
            due += ((t_ns - due) // every_ns + 1) * every_ns
    assert [int(piece.batch.time_array[-1]) for piece in pieces if piece.is_due] == expected


def test_a_slow_signal_is_estimated_when_it_is_due_not_when_a_piece_is_full() -> None:
    analysis = SignalAnalysis(PLACE, ("U1", "rate", "r1"), 60 * 10**9, new_estimators(default_estimators()))
    found: list[AnyDocument] = []
    for i in range(200):
        values = NOISE[i : i + 1].astype(np.float64)
        batch = SampleBatch("U1", "rate", "r1", UUID(int=1), i, i * 10**9, 10**9, "deg/s", values=values)
        found += [document for _, document in analysis.take(read_wire_batch(encode_batch(batch)))]
    allan = [each for each in found if isinstance(each, EstimatePublished) and each.estimator == "allan_deviation"]
    assert [(each.t_ns, each.samples) for each in allan] == [(k * 60 * 10**9, 60 * k + 1) for k in (1, 2, 3)]
    assert {each.every_ns for each in allan} == {60 * 10**9}


def test_the_spectrum_can_be_left_out_and_changes_nothing_else() -> None:
    said: list[list[AnyDocument]] = []
    for spectrum in (True, False):
        documents: list[AnyDocument] = []
        said.append(documents)

        def publish(_key: str, document: AnyDocument, to: list[AnyDocument] = documents) -> None:
            to.append(document)

        estimation = Estimation(10**9, default_estimators(), publish, spectrum=spectrum)
        values = np.random.default_rng(1).normal(size=20_000)
        batch = SampleBatch("U1", "rate", "r1", UUID(int=1), 0, 0, 10**6, "deg/h", values=values)
        estimation.take(sample_key(PLACE, "U1", "rate"), encode_batch(batch))
        estimation.take(event_key(PLACE), encode_event(RunEnded(run="r1", t_ns=20 * 10**9), "e", 0))
    whole, without = said
    assert sum(isinstance(document, SpectralLinesFound) for document in whole) == 1
    assert without == [document for document in whole if not isinstance(document, SpectralLinesFound)]
