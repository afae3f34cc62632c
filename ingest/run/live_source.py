"""A simulated station as a live source: any stretch of its samples can be simulated again at any time."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple
from uuid import NAMESPACE_URL, UUID, uuid5

import msgspec

from ingest.simulator.chamber import TEMPERATURE_INTERVAL_NS
from ingest.simulator.gyro import (
    RATE_SIGNAL,
    TEMPERATURE_SCALE_DEG_C_PER_COUNT,
    TEMPERATURE_SIGNAL,
    GyroParameters,
    SimulatedGyro,
    demo_fleet,
)
from stream.batch import CountArray, SampleBatch

TEMPERATURE_BATCH = 10
_SAMPLES_AT_ONCE = 8192


class PowerCycle(NamedTuple):
    """One power-on of a station's units: the first is number 0; `t0_ns` is the time of the first samples."""

    number: int
    t0_ns: int


class _Signal(NamedTuple):
    name: str
    unit_of_measure: str
    scale: float
    dt_ns: int
    batch: int


def station_units(count: int, rate_hz: float) -> tuple[GyroParameters, ...]:
    """Gyros with the parameters of the demonstration's fleet, repeated.

    Examples
    --------
    >>> [gyro.unit for gyro in station_units(2, 100.0)]
    ['SIM-0001', 'SIM-0002']
    """
    models = demo_fleet()
    return tuple(
        msgspec.structs.replace(
            models[i % len(models)], unit=f"SIM-{i + 1:04d}", sample_interval_ns=max(1, round(1e9 / rate_hz))
        )
        for i in range(count)
    )


class SimulatedStation:
    """Units that deliver rate and temperature from each power-on.

    A sample is a function of the seed, the unit, the number of the power-on and the sample's number alone.

    Parameters
    ----------
    units: The units, all with the same sample interval.
    name: Distinguishes the epochs of this run from all others.
    batch: Rate samples in a batch.

    Examples
    --------
    >>> station = SimulatedStation(station_units(1, 100.0), "r1", seed=1, batch=50)
    >>> power_cycle = PowerCycle(0, 0)
    >>> everything = list(station.batches("r1", power_cycle, end_ns=2 * 10**9))
    >>> [(batch.signal, batch.seq, len(batch)) for batch in everything][2:]
    [('temperature', 0, 2), ('rate', 100, 50), ('rate', 150, 50)]
    >>> again = list(station.batches("r1", power_cycle, end_ns=2 * 10**9, first={("SIM-0001", "rate"): 100}))
    >>> again[1] == everything[3]
    True
    """

    def __init__(self, units: tuple[GyroParameters, ...], name: str, *, seed: int, batch: int) -> None:
        self.units = units
        self._name = name
        self._seed = seed
        self._rate = _Signal(
            RATE_SIGNAL, "deg/s", units[0].scale_deg_per_s_per_count, units[0].sample_interval_ns, batch
        )
        self._temperature = _Signal(
            TEMPERATURE_SIGNAL, "degC", TEMPERATURE_SCALE_DEG_C_PER_COUNT, TEMPERATURE_INTERVAL_NS, TEMPERATURE_BATCH
        )

    @property
    def dt_ns(self) -> int:
        """Interval of the rate samples."""
        return self._rate.dt_ns

    def epoch(self, power_cycle: PowerCycle, unit: str) -> UUID:
        """Epoch of a unit's samples of one power-on."""
        return uuid5(NAMESPACE_URL, f"gyrofleet:station/{self._name}/{self._seed}/{power_cycle.number}/{unit}")

    def batches(
        self, run: str, power_cycle: PowerCycle, end_ns: int, first: Mapping[tuple[str, str], int] | None = None
    ) -> Iterator[SampleBatch]:
        """Batches in the order of their last samples.

        Parameters
        ----------
        end_ns: Samples before this time.
        first: Number of the first sample of each signal, one at which a batch begins.
        """
        first = first or {}
        # the first power-on is that of the plain seed
        seed = self._seed if power_cycle.number == 0 else (self._seed << 32) + power_cycle.number
        gyros = [SimulatedGyro(parameters, seed) for parameters in self.units]
        epochs = [self.epoch(power_cycle, parameters.unit) for parameters in self.units]

        def of(signal: _Signal) -> Iterator[list[SampleBatch]]:
            """Batches of all units, for each time at which a batch is full."""
            is_rate = signal.name == RATE_SIGNAL
            wanted = [first.get((parameters.unit, signal.name), 0) for parameters in self.units]
            total = -((power_cycle.t0_ns - end_ns) // signal.dt_ns)
            block = signal.batch * max(1, _SAMPLES_AT_ONCE // signal.batch)
            for start in range(0, total, block):
                counts = [
                    (gyro.rate_counts if is_rate else gyro.temperature_counts)(min(block, total - start))
                    for gyro in gyros
                ]
                for seq in range(start, min(start + block, total), signal.batch):
                    stop = min(seq + signal.batch, total)
                    yield [
                        self._batch(i, run, epochs[i], signal, power_cycle, seq, drawn[seq - start : stop - start])
                        for i, drawn in enumerate(counts)
                        if seq >= wanted[i]
                    ]

        yield from _in_order(of(self._rate), of(self._temperature))

    def _batch(
        self, i: int, run: str, epoch: UUID, signal: _Signal, power_cycle: PowerCycle, seq: int, counts: CountArray
    ) -> SampleBatch:
        return SampleBatch(
            self.units[i].unit,
            signal.name,
            run,
            epoch,
            seq,
            power_cycle.t0_ns + seq * signal.dt_ns,
            signal.dt_ns,
            signal.unit_of_measure,
            counts=counts,
            scale=signal.scale,
        )


def _in_order(many: Iterator[list[SampleBatch]], few: Iterator[list[SampleBatch]]) -> Iterator[SampleBatch]:
    """Merge two streams of groups by the time of their last samples."""
    waiting = next(few, None)
    for group in many:
        if not group:
            continue
        while waiting is not None and (not waiting or waiting[0].last_ns < group[0].last_ns):
            yield from waiting
            waiting = next(few, None)
        yield from group
    while waiting is not None:
        yield from waiting
        waiting = next(few, None)
