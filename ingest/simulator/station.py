"""Simulated gyros as batches of rate and temperature: any stretch of their samples, reproducible at any time."""

import heapq
from collections.abc import Iterator, Mapping
from typing import NamedTuple
from uuid import NAMESPACE_URL, UUID, uuid5

import numpy as np

from ingest.simulator.physics.draws import Seeds
from ingest.simulator.physics.environment import Environment
from ingest.simulator.physics.mounting import ChamberEnvironment, ChamberParameters
from ingest.simulator.physics.plan import Plan
from stream.batch import CountArray, SampleBatch
from stream.errors import BadInput

RATE_SIGNAL = "rate"
TEMPERATURE_SIGNAL = "temperature"
TEMPERATURE_SCALE_DEG_C_PER_COUNT = 0.01
TEMPERATURE_INTERVAL_NS = 1_000_000_000
TEMPERATURE_BATCH = 10
_SAMPLES_AT_ONCE = 524_288  # of all units
_INT32 = np.iinfo(np.int32)


class PowerCycle(NamedTuple):
    """One power-on of a station's units: the first is number 0; `t0_ns` is the time of the first samples."""

    number: int
    t0_ns: int


class PoweredUnit:
    """One power-on of a unit: rate and temperature in counts, drawn in any order and in blocks of whatever size."""

    def __init__(
        self, fleet: Plan, unit: str, power_cycle: PowerCycle = PowerCycle(0, 0),
        chamber: ChamberParameters | None = None, environment: Environment | None = None,
    ) -> None:  # fmt: skip
        chamber = chamber or ChamberParameters()
        power_on, self._t0_ns = power_cycle.number + 1, power_cycle.t0_ns
        seeds = Seeds(fleet.seed, unit, power_on, power_on)
        # rate and thermometer have environments of their own, since each takes the times in order
        felt = environment or ChamberEnvironment(chamber, seeds, self._t0_ns)
        self._read = environment or ChamberEnvironment(chamber, seeds, self._t0_ns)
        self._gyro = fleet.gyro(unit, power_on, environment=felt, start_ns=self._t0_ns)
        self._thermometer = seeds.of_power_on("thermometer")
        self._thermometer_noise_deg_c = chamber.thermometer_noise_deg_c
        self._next_reading = 0

    def rate_counts(self, n: int) -> CountArray:
        """The next `n` rate samples."""
        return self._gyro.samples(n).counts

    def temperature_counts(self, n: int) -> CountArray:
        """The next `n` temperature readings, one per second, in counts of 0.01 degC."""
        t_ns = self._t0_ns + (self._next_reading + np.arange(n, dtype=np.int64)) * TEMPERATURE_INTERVAL_NS
        self._next_reading += n
        noise = self._thermometer_noise_deg_c * self._thermometer.standard_normal(n)
        counts = np.rint((self._read.temperature_deg_c(t_ns) + noise) / TEMPERATURE_SCALE_DEG_C_PER_COUNT)
        return np.clip(counts, _INT32.min, _INT32.max).astype(np.int32)


class _Signal(NamedTuple):
    name: str
    unit_of_measure: str
    scale: float
    dt_ns: int
    batch: int


class SimulatedStation:
    """Units that send rate and temperature from a power-on on; samples that a read-out loses are sent as well.

    The samples are a function of the fleet, the unit, the number of the power-on and the sample's number alone. All
    units have the same sample interval and nominal scale. The `name` makes the epochs of this run its own.

    >>> from ingest.simulator.demo_fleet import station_fleet
    >>> station = SimulatedStation(station_fleet(1, 100.0, seed=1), "r1", batch=50)
    >>> power_cycle = PowerCycle(0, 0)
    >>> everything = list(station.batches("r1", power_cycle, end_ns=2 * 10**9))
    >>> [(batch.signal, batch.seq, len(batch)) for batch in everything][2:]
    [('temperature', 0, 2), ('rate', 100, 50), ('rate', 150, 50)]
    >>> again = list(station.batches("r1", power_cycle, end_ns=2 * 10**9, first={("SIM-0001", "rate"): 100}))
    >>> again[1] == everything[3]
    True
    """

    def __init__(
        self, fleet: Plan, name: str, *, batch: int, temperature_batch: int = TEMPERATURE_BATCH,
        chamber: ChamberParameters | None = None, environment: Environment | None = None,
    ) -> None:  # fmt: skip
        if min(batch, temperature_batch) < 1:
            raise BadInput(f"simulated station {name}: a batch holds at least one sample")
        self._fleet, self._name = fleet, name
        self._chamber, self._environment = chamber, environment
        of_all = next(iter(fleet.parameters.values()))
        self.dt_ns = of_all.sample_interval_ns  # of the rate
        self._rate = _Signal(RATE_SIGNAL, "deg/s", 1.0 / of_all.scale.counts_per_deg_per_s, self.dt_ns, batch)
        self._temperature = _Signal(
            TEMPERATURE_SIGNAL, "degC", TEMPERATURE_SCALE_DEG_C_PER_COUNT, TEMPERATURE_INTERVAL_NS, temperature_batch
        )

    def epoch(self, power_cycle: PowerCycle, unit: str) -> UUID:
        """The epoch of a unit's samples from one power-on on."""
        return uuid5(NAMESPACE_URL, f"gyrofleet:station/{self._name}/{self._fleet.seed}/{power_cycle.number}/{unit}")

    def batches(
        self, run: str, power_cycle: PowerCycle, end_ns: int, first: Mapping[tuple[str, str], int] | None = None
    ) -> Iterator[SampleBatch]:
        """Batches before `end_ns` in order of their last samples, from the batch on that begins at `first`."""
        first, names = first or {}, self._fleet.units
        units = [PoweredUnit(self._fleet, unit, power_cycle, self._chamber, self._environment) for unit in names]
        epochs = [self.epoch(power_cycle, unit) for unit in names]

        def groups(signal: _Signal) -> Iterator[list[SampleBatch]]:
            """The batches of all units that are full at the same time."""
            is_rate = signal.name == RATE_SIGNAL
            wanted = [first.get((unit, signal.name), 0) for unit in names]
            total = -((power_cycle.t0_ns - end_ns) // signal.dt_ns)
            block = signal.batch * max(1, _SAMPLES_AT_ONCE // (signal.batch * len(units)))
            for start in range(0, total, block):
                n = min(block, total - start)
                counts = [unit.rate_counts(n) if is_rate else unit.temperature_counts(n) for unit in units]
                for seq in range(start, start + n, signal.batch):
                    t0_ns, stop = power_cycle.t0_ns + seq * signal.dt_ns, min(seq + signal.batch, total)
                    group = [
                        SampleBatch(
                            unit, signal.name, run, epoch, seq, t0_ns, signal.dt_ns, signal.unit_of_measure,
                            counts=drawn[seq - start : stop - start], scale=signal.scale,
                        )
                        for unit, epoch, least, drawn in zip(names, epochs, wanted, counts, strict=True)
                        if seq >= least
                    ]  # fmt: skip
                    if group:
                        yield group

        for group in heapq.merge(groups(self._rate), groups(self._temperature), key=lambda group: group[0].last_ns):
            yield from group
