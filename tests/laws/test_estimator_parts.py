"""Laws of the parts of an estimator: neighbouring parts merge, and snapshots resume."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stream.errors import EstimatorError
from stream.estimators import snapshot as snapshot_module
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.snapshot import SNAPSHOT_VERSION, restore, take_snapshot
from tests.laws.estimator_cases import DT_NS, EVERY, FACTORIES, assert_same, fed, make, parts, rows_of, signal


@EVERY
@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=st.data())
@pytest.mark.in_gate("allan_deviation", "bias_stability_100s")
def test_parts_merge_in_any_order_to_one_pass(key: str, data: st.DataObject) -> None:
    values = signal(3000, 4)
    values[1400:1410] = np.nan
    if data.draw(st.booleans()):
        values[:200] = np.nan
    size = data.draw(st.sampled_from([7, 64, 100]))
    hole = data.draw(st.sampled_from([0, 1, 33, 5000]))
    batches = [make(values[i : i + size], i + (hole if i >= 2000 else 0)) for i in range(0, len(values), size)]
    cuts = data.draw(st.lists(st.integers(0, len(batches)), min_size=1, max_size=6))
    waiting = parts(key, batches, cuts)
    whole = fed(key, batches)
    while len(waiting) > 1:
        at = data.draw(st.integers(0, len(waiting) - 2))
        if data.draw(st.booleans()):
            waiting[at] = restore(take_snapshot(waiting[at]))
        waiting[at].merge(waiting.pop(at + 1))
    assert_same(waiting[0], whole)
    more = make(signal(3000, 5), 10_000)
    waiting[0].update(more)
    whole.update(more)
    assert_same(waiting[0], whole)


@EVERY
def test_irregular_parts_merge_to_one_pass(key: str) -> None:
    rng = np.random.default_rng(6)
    times_ns = np.cumsum(rng.integers(1, 2 * DT_NS, 4000)).astype(np.int64)
    values = signal(4000)
    batches = [make(values[i : i + 50], times_ns=times_ns[i : i + 50], irregular=True) for i in range(0, 4000, 50)]
    merged, *others = parts(key, batches, [1, 20, 21, 79])
    for other in others:
        merged.merge(other)
    assert_same(merged, fed(key, batches))


@EVERY
def test_merging_leaves_the_later_part_as_it_is(key: str) -> None:
    earlier, later, _ = parts(key, [make(signal(3000)), make(signal(3000, 2), 3000)], [1])
    before = take_snapshot(later)
    earlier.merge(later)
    later_again = restore(before)
    assert rows_of(later) == rows_of(later_again)
    assert take_snapshot(later) == before


@EVERY
def test_what_does_not_go_together_is_not_merged(key: str) -> None:
    batches = [make(signal(500, i), 500 * i) for i in range(4)]
    first, second, third, _ = parts(key, batches, [1, 2])
    before = rows_of(first)
    with pytest.raises(EstimatorError, match=r"only neighbours can be merged; begin the later part with continuation"):
        first.merge(third)
    with pytest.raises(EstimatorError, match="only neighbours can be merged"):
        first.merge(fed(key, batches[1:2]))
    stranger = FACTORIES[key]()
    stranger.update(replace(batches[1], unit="FOG-2"))
    with pytest.raises(EstimatorError, match="of unit FOG-1, signal rate in deg/s cannot be merged with that of unit"):
        first.merge(stranger)
    other = next(make() for name, make in FACTORIES.items() if name != key)
    with pytest.raises(EstimatorError, match="kind and settings must agree"):
        first.merge(other)
    assert rows_of(first) == before
    first.merge(second)
    with pytest.raises(EstimatorError, match="only neighbours"):
        first.merge(second)


@EVERY
@given(cut=st.integers(0, 40), seed=st.integers(0, 3))
@settings(max_examples=25, deadline=None)
def test_a_snapshot_in_mid_stream_goes_on_as_if_nothing_had_happened(key: str, cut: int, seed: int) -> None:
    values = signal(4000, seed)
    values[1000:1010] = np.nan
    batches = [make(values[i : i + 100], i + (500 if i >= 2000 else 0)) for i in range(0, 4000, 100)]
    interrupted = fed(key, batches[:cut])
    restored = restore(take_snapshot(interrupted))
    assert type(restored) is type(interrupted)
    assert restored.key == key
    for batch in batches[cut:]:
        restored.update(batch)
    whole = fed(key, batches)
    assert rows_of(restored) == rows_of(whole)  # to the last bit
    assert (restored.samples, restored.missing, restored.late) == (whole.samples, whole.missing, whole.late)
    assert restored.unit_of_measure == whole.unit_of_measure


@EVERY
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_a_damaged_snapshot_is_a_named_error(key: str, data: st.DataObject) -> None:
    snapshot = bytearray(take_snapshot(fed(key, [make(signal(500))])))
    at = data.draw(st.integers(0, len(snapshot) - 1))
    snapshot[at] ^= data.draw(st.integers(1, 255))
    cut = data.draw(st.integers(0, len(snapshot) - 1))
    for damaged in (bytes(snapshot), bytes(snapshot[:cut])):
        with pytest.raises(EstimatorError, match=r"damaged|no snapshot"):
            restore(damaged)


@EVERY
def test_a_snapshot_is_compact_and_independent(key: str) -> None:
    estimator = fed(key, [make(signal(6000))])
    snapshot = take_snapshot(estimator)
    assert len(snapshot) < estimator.state_bytes + 400
    before = rows_of(estimator)
    restore(snapshot).update(make(signal(100, seed=9), 6000))
    assert rows_of(estimator) == before
    assert b"stream." not in snapshot  # no name of a Python module, as pickle would have


@EVERY
def test_a_snapshot_of_a_newer_version_is_refused(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(snapshot_module, "SNAPSHOT_VERSION", 99)
    newer = take_snapshot(fed(key, [make(signal(500))]))
    monkeypatch.undo()
    with pytest.raises(EstimatorError, match=f"version 99, this gyrofleet reads up to {SNAPSHOT_VERSION}: upgrade"):
        restore(newer)


@EVERY
def test_other_settings_are_not_merged(key: str) -> None:
    one = fed(key, [make(signal(500))])
    for name, value in one.arguments.items():
        later = one.continuation()
        try:
            other = type(one)(**{**one.arguments, name: value * 2 or 1.0})
        except EstimatorError:
            continue  # twice as much is not offered
        with pytest.raises(EstimatorError, match="kind and settings must agree"):
            one.merge(other)
        one.merge(later)


def test_a_state_of_other_settings_is_refused() -> None:
    state = AllanDeviation(points_per_octave=1).export_state()
    with pytest.raises(EstimatorError, match="of another estimator"):
        AllanDeviation(points_per_octave=4).import_state(state)
