"""Compensated samples: what the model predicts is gone, whatever pieces and whatever order the samples came in."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.loop.live.epoch_compensation import compensated_epoch
from analytics.loop.live.live_compensator import Out
from analytics.loop.model.error_model import ErrorModel, ModelTerm
from analytics.loop.model.live_terms import check_live, live_part, why_not_live
from storage.store import Store
from stream.batch import SampleBatch
from stream.errors import BadInput
from stream.events import CompensationStarted, ModelActivated, NoteAdded, PowerOn, RunEnded, RunStarted
from tests.live_runs import (
    COEFFICIENTS,
    EPOCH,
    PLACE,
    RUN_S,
    SCALE,
    T0_NS,
    TEXT,
    batches,
    compensated,
    ended,
    in_time,
    live,
    samples,
    temperature,
)


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


@pytest.mark.long
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
    assert "needs channel temperature: no reading was recorded" in note.text


def test_of_several_instruments_none_is_guessed(store: Store) -> None:
    compensator, _ = live(store, "rate = bias + temperature", [100.0, 0.5])
    ends = RunEnded(run="r1", t_ns=T0_NS)
    one, other = batches("temperature", 10, unit="chamber-1"), batches("temperature", 10, unit="chamber-2")
    out = compensated(compensator, in_time(batches("rate", 100), one, other, delays_s=(0, 0, 0)), ends)
    (note,) = [what for _, what in out if isinstance(what, NoteAdded)]
    assert "several instruments record it: chamber-1, chamber-2" in note.text


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
    assert "last reading of channel temperature from now on: it stops at 299 s" in note.text
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
    assert "does not match its hash" in note.text


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
