"""Short simulated runs of a fleet, of three kinds in turn: temperature cycles, rates, and rest.

One unit carries an effect that none of the others has and that nobody declares.
"""

import heapq
from collections.abc import Iterator
from typing import NamedTuple
from uuid import NAMESPACE_URL, uuid5

import numpy as np

from ingest.simulator.gyro import TEMPERATURE_SCALE_DEG_C_PER_COUNT, GyroParameters
from ingest.simulator.physics.bias import Bias
from ingest.simulator.physics.environment import PiecewiseEnvironment
from ingest.simulator.physics.gyro_model import GyroModelParameters, SimulatedGyroModel
from ingest.simulator.physics.noise import Noise
from ingest.simulator.physics.thermal import TemperatureRate, Thermal
from stream.batch import SampleBatch

RUN_S = 1800.0
TABLE = "table"
ODD_UNIT = "FOG-0235"
_KINDS = ("temperature_cycle", "rates", "temperature_cycle", "rest")
_RUNS = 9
_PAUSE_S = 5400.0
_SAMPLE_NS = 50_000_000
_SECOND_NS = 1_000_000_000
_SHUPE_DEG_PER_H_PER_DEG_C_PER_MIN = 0.25
_THERMOMETER_DEG_C = 0.02
_RATE_NOISE_DEG_PER_S = 2e-5


class CycleRun(NamedTuple):
    """One of the runs.

    Parameters
    ----------
    kind: Its procedure.
    number: From 1 on; also the number of the power-on.
    t0_ns: When it begins.
    environment: Temperature and rate about the input axis.
    """

    kind: str
    number: int
    t0_ns: int
    environment: PiecewiseEnvironment


def cycle_runs(t0_ns: int) -> tuple[CycleRun, ...]:
    """Nine runs, one after the other from `t0_ns` on, a pause between them in which the units are off.

    Examples
    --------
    >>> [run.kind for run in cycle_runs(0)][:4]
    ['temperature_cycle', 'rates', 'temperature_cycle', 'rest']
    """
    runs = []
    for number in range(1, _RUNS + 1):
        kind = _KINDS[(number - 1) % len(_KINDS)]
        start_ns = t0_ns + round((number - 1) * (RUN_S + _PAUSE_S)) * _SECOND_NS
        runs.append(CycleRun(kind, number, start_ns, _environment(kind, number, start_ns)))
    return tuple(runs)


def cycles_last_s() -> float:
    """Seconds from the beginning of the first run to the end of the last."""
    return _RUNS * (RUN_S + _PAUSE_S) - _PAUSE_S


def _environment(kind: str, number: int, origin_ns: int) -> PiecewiseEnvironment:
    if kind == "temperature_cycle":
        # two slopes, and every second cycle the other way round: neither temperature nor time goes with the slope
        way = 1.0 if number % 4 == 1 else -1.0
        times_s = [0.0, 120.0, 520.0, 720.0, 1120.0, 1320.0, 1620.0, 1800.0]
        deg_c = [25.0 + way * each for each in (0.0, 0.0, 20.0, 20.0, -10.0, -10.0, 0.0, 0.0)]
        return PiecewiseEnvironment(times_s, temperature_deg_c=deg_c, origin_ns=origin_ns)
    if kind == "rates":
        times_s, rates = [0.0], [0.0]
        for at, rate in enumerate((0.0, 10.0, -10.0, 30.0, -30.0, 60.0, -60.0, 0.0)):
            times_s += [at * 225.0 + (5.0 if at else 0.0), (at + 1) * 225.0]
            rates += [rate, rate]
        axes = [(rate, 0.0, 0.0) for rate in rates]
        return PiecewiseEnvironment(times_s, rates_deg_per_s=axes, origin_ns=origin_ns)
    return PiecewiseEnvironment([0.0], origin_ns=origin_ns)


def cycle_batches(fleet: tuple[GyroParameters, ...], run: CycleRun, name: str, seed: int) -> Iterator[SampleBatch]:
    """Batches of all units and of the rate table in one of the runs, in the order of time.

    Parameters
    ----------
    fleet: Units; noise, bias and linear temperature coefficient are taken over. `ODD_UNIT` also feels how fast the
        temperature changes.
    run: Which run.
    name: What the run is called.
    seed: Of the simulation.
    """
    sources = [_unit(parameters, run, name, seed) for parameters in fleet]
    return heapq.merge(*sources, _table(run, name, seed), key=lambda batch: batch.last_ns)


def _unit(parameters: GyroParameters, run: CycleRun, name: str, seed: int) -> Iterator[SampleBatch]:
    epoch = uuid5(NAMESPACE_URL, f"gyrofleet:simulated/{name}/{seed}/{parameters.unit}")
    model = SimulatedGyroModel(
        _model(parameters),
        seed=seed,
        unit=parameters.unit,
        power_on=run.number,
        environment=run.environment,
        start_ns=run.t0_ns,
    )
    thermometer = np.random.default_rng([seed, run.number, *parameters.unit.encode()])
    for second in range(0, round(RUN_S), 60):
        t_ns = run.t0_ns + (second + np.arange(60, dtype=np.int64)) * _SECOND_NS
        deg_c = run.environment.temperature_deg_c(t_ns) + _THERMOMETER_DEG_C * thermometer.standard_normal(60)
        counts = np.rint(deg_c / TEMPERATURE_SCALE_DEG_C_PER_COUNT).astype(np.int32)
        yield SampleBatch(
            parameters.unit, "temperature", name, epoch, second, int(t_ns[0]), _SECOND_NS, "degC",
            counts=counts, scale=TEMPERATURE_SCALE_DEG_C_PER_COUNT,
        )  # fmt: skip
        samples = model.samples(60 * _SECOND_NS // _SAMPLE_NS)
        yield SampleBatch(
            parameters.unit, "rate", name, epoch, samples.first, model.time_ns(samples.first), _SAMPLE_NS, "deg/s",
            counts=samples.counts, scale=model.scale_deg_per_s_per_count,
        )  # fmt: skip


def _model(parameters: GyroParameters) -> GyroModelParameters:
    is_odd = parameters.unit == ODD_UNIT
    rate = TemperatureRate(deg_per_h_per_deg_c_per_min=_SHUPE_DEG_PER_H_PER_DEG_C_PER_MIN) if is_odd else None
    return GyroModelParameters(
        sample_interval_ns=_SAMPLE_NS,
        bias=Bias(constant_deg_per_h=parameters.bias_deg_per_h, turn_on_deg_per_h=parameters.turn_on_bias_deg_per_h),
        thermal=Thermal(
            bias_polynomial_deg_per_h=(parameters.bias_temperature_coefficient_deg_per_h_per_deg_c,), rate=rate
        ),
        noise=Noise(
            angle_random_walk_deg_per_sqrt_h=parameters.angle_random_walk_deg_per_sqrt_h,
            bias_instability_deg_per_h=parameters.bias_instability_deg_per_h,
            rate_random_walk_deg_per_h_per_sqrt_h=parameters.rate_random_walk_deg_per_h_per_sqrt_h,
        ),
    )


def _table(run: CycleRun, name: str, seed: int) -> Iterator[SampleBatch]:
    epoch = uuid5(NAMESPACE_URL, f"gyrofleet:simulated/{name}/{seed}/{TABLE}")
    noise = np.random.default_rng([seed, run.number])
    for second in range(0, round(RUN_S), 60):
        t_ns = run.t0_ns + (second + np.arange(60, dtype=np.int64)) * _SECOND_NS
        rates = run.environment.rates_deg_per_s(t_ns)[0] + _RATE_NOISE_DEG_PER_S * noise.standard_normal(60)
        yield SampleBatch(
            TABLE, "table_rate", name, epoch, second, int(t_ns[0]), _SECOND_NS, "deg/s", values=rates
        )  # fmt: skip
