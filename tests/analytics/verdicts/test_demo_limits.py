"""The demonstration's fleet is judged as it was planted."""

from analytics.demo.demo import demo_limits
from ingest.simulator.demo_fleet import demo_fleet
from ingest.simulator.physics.plan import Plan
from ingest.simulator.station import PowerCycle, SimulatedStation
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.bias_stability import BiasStability
from stream.events import EstimatePublished, LimitsApplied, RunEnded, Verdict
from stream.worker.limit_checks import estimator_key, unit_verdicts

HOURS = 6


def simulated_estimates(unit: str) -> list[EstimatePublished]:
    estimators = [AllanDeviation(), BiasStability(10.0), BiasStability(100.0)]
    alone = Plan(1, {unit: demo_fleet(1).parameters[unit]})
    station = SimulatedStation(alone, "r1", batch=100_000, temperature_batch=60)
    for batch in station.batches("r1", PowerCycle(0, 0), round(HOURS * 3600e9)):
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
                unit=unit,
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
    final = [estimate for unit in demo_fleet(1).units for estimate in simulated_estimates(unit)]
    applied = LimitsApplied(run="r1", t_ns=0, revision=limits.label, limits=limits.live)
    verdicts = {each.unit: each for each in unit_verdicts(RunEnded(run="r1", t_ns=0), [applied], final)}
    assert set(verdicts) == set(demo_fleet(1).units)
    marginal, worse, drifting = (verdicts.pop(unit) for unit in ("FOG-0238", "FOG-0234", "FOG-0236"))
    assert {unit: given.verdict for unit, given in verdicts.items()} == dict.fromkeys(verdicts, Verdict.PASS)
    assert [check.verdict for check in worse.checks[:3]] == [Verdict.FAIL] * 3
    assert [check.verdict for check in drifting.checks] == [*[Verdict.PASS] * 3, Verdict.FAIL]
    assert [check.verdict for check in marginal.checks] == [Verdict.PASS, Verdict.MARGINAL, Verdict.PASS, Verdict.PASS]
