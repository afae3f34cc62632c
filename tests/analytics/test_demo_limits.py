"""The demonstration's fleet is judged as it was planted."""

from analytics.demo.demo import demo_limits
from ingest.simulator.gyro import GyroParameters, demo_fleet, unit_batches
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.bias_stability import BiasStability
from stream.events import EstimatePublished, LimitsApplied, RunEnded, Verdict
from stream.worker.limit_checks import estimator_key, unit_verdicts

HOURS = 6


def simulated_estimates(gyro: GyroParameters) -> list[EstimatePublished]:
    estimators = [AllanDeviation(), BiasStability(10.0), BiasStability(100.0)]
    batches = unit_batches(gyro, run="r1", duration_s=HOURS * 3600, seed=1, rate_batch=100_000)
    for batch in batches:
        for estimator in estimators:
            if batch.signal == "rate":
                estimator.update(batch)
    estimates = []
    for estimator in estimators:
        points = estimator.estimate()
        assert isinstance(points, tuple)
        estimates.append(
            EstimatePublished(
                run="r1",
                t_ns=0,
                unit=gyro.unit,
                signal="rate",
                estimator=estimator.key,
                unit_of_measure=estimator.unit_of_measure,
                confidence=0.95,
                samples=estimator.samples,
                missing=0,
                sample_interval_s=0.005,
                points=points,
            )
        )
    return estimates


def test_the_demo_fleet_is_judged_as_planted() -> None:
    limits = demo_limits()
    assert [estimator_key(limit) for limit in limits.live] == [
        "allan_deviation",
        "allan_deviation",
        "bias_stability_10s",
        "bias_stability_100s",
    ]
    final = [estimate for gyro in demo_fleet() for estimate in simulated_estimates(gyro)]
    applied = LimitsApplied(run="r1", t_ns=0, revision=limits.label, limits=limits.live)
    verdicts = {each.unit: each for each in unit_verdicts(RunEnded(run="r1", t_ns=0), [applied], final)}
    assert set(verdicts) == {gyro.unit for gyro in demo_fleet()}
    marginal, worse, drifting = (verdicts.pop(unit) for unit in ("FOG-0238", "FOG-0234", "FOG-0236"))
    assert {unit: given.verdict for unit, given in verdicts.items()} == dict.fromkeys(verdicts, Verdict.PASS)
    assert [check.verdict for check in worse.checks[:3]] == [Verdict.FAIL] * 3
    assert [check.verdict for check in drifting.checks] == [*[Verdict.PASS] * 3, Verdict.FAIL]
    assert [check.verdict for check in marginal.checks] == [Verdict.PASS, Verdict.MARGINAL, Verdict.PASS, Verdict.PASS]
