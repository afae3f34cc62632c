"""A rolling window against the same estimator fed with that window alone."""

from uuid import UUID

import numpy as np
import pytest

from stream.batch import FloatArray, SampleBatch
from stream.errors import EstimatorError
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import NoEstimate
from stream.estimators.bias_stability import BiasStability
from stream.estimators.rolling_window import RollingWindow, WindowEstimate

DT_NS = 100_000_000


def batches(values: FloatArray, size: int, first_slot: int = 0) -> list[SampleBatch]:
    return [
        SampleBatch(
            "FOG-1", "rate", "r1", UUID(int=1), i, (first_slot + i) * DT_NS, DT_NS, "deg/h", values=values[i : i + size]
        )
        for i in range(0, len(values), size)
    ]


def rolled(window: RollingWindow, given: list[SampleBatch]) -> list[WindowEstimate]:
    return [each for batch in given for each in window.update(batch)]


def alone(values: FloatArray) -> AllanDeviation:
    estimator = AllanDeviation()
    for batch in batches(values, 500):
        estimator.update(batch)
    return estimator


@pytest.mark.parametrize("size", [1, 37, 512, 20_000])
@pytest.mark.parametrize("panes", [1, 2, 5, 8])
def test_every_window_is_as_if_it_were_all(size: int, panes: int) -> None:
    values = np.random.default_rng(1).standard_normal(4160).cumsum() + 5.0
    values[1000] = 1e12  # a spike that leaves the window again
    step = 256
    found = rolled(RollingWindow(AllanDeviation, panes * step / 10, step / 10), batches(values, size))
    assert len(found) == 4160 // step - panes + 1
    for i, window in enumerate(found):
        start, stop = i * step, (i + panes) * step
        assert (window.start_ns, window.stop_ns) == (start * DT_NS, stop * DT_NS)
        assert (window.samples, window.missing) == (stop - start, 0)
        expected = alone(values[start:stop]).estimate()
        assert not isinstance(window.estimate, NoEstimate)
        assert not isinstance(expected, NoEstimate)
        # pairs on the grid of the whole signal: as many as alone, since the steps are whole blocks of 2**4
        counted = {point.tau_s: point for point in window.estimate}
        for point in expected:
            if point.tau_s <= 1.6 * 16:
                assert counted[point.tau_s].n == point.n
                assert counted[point.tau_s].value == pytest.approx(point.value, rel=1e-9)


def test_windows_inside_a_gap_are_left_out_and_those_beside_it_are_right() -> None:
    values = np.random.default_rng(2).standard_normal(2000)
    window = RollingWindow(lambda: BiasStability(1.0), 40.0, 10.0)
    found = rolled(window, batches(values[:1000], 100))
    found += rolled(window, batches(values[1000:], 100, first_slot=100_000))
    starts_s = [each.start_ns / 1e9 for each in found]
    # the first ends at 40 s, the last before the gap holds the second at 90 to 100 s alone; then from 9970 s on
    assert starts_s == [*np.arange(0.0, 100.0, 10.0), *np.arange(9970.0, 10_060.0 + 1, 10.0)[: len(starts_s) - 10]]
    for each in found:
        slots = np.arange(each.start_ns // DT_NS, each.stop_ns // DT_NS)
        held = [values[s] if s < 1000 else values[s - 99_000] for s in slots if s < 1000 or 100_000 <= s < 101_000]
        means = np.array(held).reshape(-1, 10).mean(axis=1)
        assert not isinstance(each.estimate, NoEstimate)
        assert each.samples == len(held)
        assert each.estimate[0].n == len(means)
        assert each.estimate[0].value == pytest.approx(means.std(ddof=1), rel=1e-9)


@pytest.mark.parametrize(("window_s", "step_s"), [(10.0, 3.0), (1.0, 2.0), (10.0, 0.0), (float("inf"), 1.0)])
def test_a_window_that_steps_do_not_fill_is_refused(window_s: float, step_s: float) -> None:
    with pytest.raises(EstimatorError, match="it takes a whole number of steps, 1 to 100,000"):
        RollingWindow(AllanDeviation, window_s, step_s)


def test_steps_that_cannot_be_taken_are_refused() -> None:
    for window_s, step_s in ((1e-300, 1e-300), (2e10, 2e10), (4e-10, 4e-10)):
        with pytest.raises(EstimatorError, match="steps take 1 ns to 146 years"):
            RollingWindow(AllanDeviation, window_s, step_s)
    with pytest.raises(EstimatorError, match=r"steps of 0.05 s are shorter than the sample interval of 0.1 s"):
        RollingWindow(AllanDeviation, 0.1, 0.05).update(batches(np.zeros(10), 10)[0])
