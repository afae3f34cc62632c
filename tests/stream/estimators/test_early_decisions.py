"""Early decisions of a worker: at which averaging times, and that they survive a restart."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from stream.estimators.bias_stability import BiasStability
from stream.events import EarlyDecision, EstimatePublished, LimitsApplied
from stream.worker.early_decisions import EarlyDecisions
from tests.allan_definition import overlapping_allan_variance
from tests.stream.worker_runs import LIMITS, STARTS, VALUES, batch, run


def test_early_decisions_are_given_and_survive(tmp_path: Path) -> None:
    found, _ = run(tmp_path / "c", [STARTS[:60], STARTS[60:]])
    looks = [each for each in found if isinstance(each, EarlyDecision)]
    by_limit = {limit: [each for each in looks if each.limit == limit] for limit in LIMITS}
    # white noise of 3600 deg/h at 100 Hz: averages of 1 s spread by 360, three times the limit: FAIL before the end
    failing = by_limit[LIMITS[0]]
    assert [each.outcome for each in failing][-1] == "FAIL"
    assert {each.rule for each in failing if each.outcome == "FAIL"} == {"curtailed"}
    first_fail = min(each.t_ns for each in failing if each.outcome == "FAIL")
    assert first_fail < 600e9
    # at 2.56 and 3 s it is 225 and 208, far below 5000; an angle random walk of 6 is far above 1
    assert {(each.outcome, each.rule) for limit in LIMITS[1:3] for each in by_limit[limit]} == {("PASS", "bounds")}
    assert [(each.outcome, each.rule) for each in by_limit[LIMITS[5]]][-1][0] == "FAIL"
    assert {each.reason for each in by_limit[LIMITS[4]]} == {
        "no early decision: the estimator has no averaging time of 0.05 s, but 0.04 s, 0.08 s; judged at the end"
    }
    assert max(each.looked_at_fraction for each in failing) < 1.0
    # a limit that is kept is decided when the planned test has ended, with its last sample
    kept = by_limit[LIMITS[3]]
    assert {each.outcome for each in kept if each.t_ns < max(each.t_ns for each in kept)} == {"UNDECIDED"}
    assert [(each.outcome, each.rule) for each in kept][-1] == ("PASS", "finished")


@pytest.mark.parametrize("samples", [6.25, 6.5, 9.37, 40.1])
def test_uneven_means_raise_the_deviation_by_less_than_three_thousandths(samples: float) -> None:
    """White noise: the variance of a mean over 16 blocks is the mean of 1/n over them, by 16."""
    edges = np.ceil(np.arange(17 * 50) * samples)
    counts = np.diff(edges).reshape(-1, 1)[: 16 * 49].reshape(49, 16)
    found = np.mean(np.sum(1.0 / counts, axis=1) / 256)
    assert 0.0 <= np.sqrt(found * 16 * samples) - 1.0 < 0.003


def test_a_decision_stands_when_its_signal_goes_on_from_a_checkpoint() -> None:
    decisions = EarlyDecisions("rate")
    decisions.apply(LimitsApplied(run="r1", t_ns=0, revision="R", limits=LIMITS[:1], planned_s=600.0))
    stability = BiasStability(1.0)
    for start in STARTS[:100]:
        stability.update(batch(start))
    points = stability.estimate()
    assert isinstance(points, tuple)
    document = EstimatePublished(
        run="r1", t_ns=0, unit="U1", signal="rate", estimator=stability.key, unit_of_measure="deg/h", confidence=0.95,
        samples=50_000, missing=0, sample_interval_s=0.01, points=points,
    )  # fmt: skip
    (look,) = decisions.look(500.0, {stability.key: document})
    assert look[1].outcome.value == "FAIL"
    again = EarlyDecisions.from_state("rate", msgspec.msgpack.decode(msgspec.msgpack.encode(decisions.export_state())))
    assert again.look(510.0, {}) == [look]


def test_a_deviation_between_the_octaves_is_that_of_its_averaging_time() -> None:
    decisions = EarlyDecisions("rate")
    decisions.apply(LimitsApplied(run="r1", t_ns=0, revision="R", limits=LIMITS[2:3], planned_s=600.0))
    for start in STARTS:
        decisions.update(batch(start))
    points = decisions._exact[0].allan.estimate()
    assert isinstance(points, tuple)
    (point,) = [each for each in points if abs(each.tau_s - 3.0) < 1e-9]
    expected = 3600.0 * np.sqrt(overlapping_allan_variance(VALUES, 300))
    # full overlap and sixteenths share all but 0.5 % of their information; the last, unfinished block is left out
    assert point.value == pytest.approx(expected, rel=4 * np.sqrt(0.005 / (2 * point.edf)) + 1e-3)
