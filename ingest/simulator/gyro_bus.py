"""Simulated gyros on a CAN bus, in a process of their own: what acts on them comes from that of the instruments."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ingest.simulator.bench import SimulatedBench
from ingest.simulator.physics.gyro_model import SimulatedGyroModel
from ingest.simulator.physics.mounting import TableEnvironment
from ingest.simulator.physics.plan import Plan
from ingest.simulator.scpi.supply import SimulatedSupply
from ingest.simulator.station_files import FIRST_ID
from ingest.simulator.world import World

_TICK_S = 0.005


@dataclass
class _Gyro:
    unit: str
    arbitration_id: int
    power_ons: int = 0
    model: SimulatedGyroModel | None = None


class GyroBus:
    """Sends the samples of a fleet as CAN frames, each as soon as its moment has passed.

    Parameters
    ----------
    plan: The fleet.
    environment: What acts on it.
    supply: Powers it: who has no power sends nothing, and each switching on is a power-on.
    send: Given the frames of a tick, each an arbitration id and 8 bytes, in the order of their moments.
    on_power: Given every power-on and its seconds so far, as it begins and when it has ended.
    power_ons: How often each unit has been powered on before.

    Notes
    -----
    A frame has the counts of the rate (int32), the temperature in 0.01 degC (int16) and the sample's number (uint16).
    """

    def __init__(
        self,
        plan: Plan,
        environment: TableEnvironment,
        supply: SimulatedSupply,
        send: Callable[[Sequence[tuple[int, bytes]]], None],
        on_power: Callable[[SimulatedGyroModel, float], None] | None = None,
        power_ons: Mapping[str, int] | None = None,
    ) -> None:
        power_ons = power_ons or {}
        self._plan = plan
        self._environment = environment
        self._supply = supply
        self._send = send
        self._on_power = on_power
        self._gyros = [_Gyro(unit, FIRST_ID + i, power_ons.get(unit, 0)) for i, unit in enumerate(plan.units)]
        self._done_ns = 0
        self.frames = 0

    def advance(self, now_ns: int) -> None:
        """Send everything up to a moment."""
        for start_ns, end_ns, on in self._powered(now_ns):
            if on:
                self._sample(start_ns, end_ns)
            else:
                self.end(start_ns)
        self._done_ns = now_ns

    def end(self, t_ns: int | None = None) -> None:
        """Every power-on ends at a moment, or where it stands."""
        for gyro in self._gyros:
            if gyro.model is not None:
                self._tell(gyro.model, ((self._done_ns if t_ns is None else t_ns) - gyro.model.start_ns) / 1e9)
                gyro.model = None

    def _tell(self, model: SimulatedGyroModel, duration_s: float) -> None:
        if self._on_power is not None:
            self._on_power(model, duration_s)

    def _powered(self, now_ns: int) -> list[tuple[int, int, bool]]:
        """Stretches from where it stands up to now, and whether there was power."""
        course = self._supply.course
        assert course is not None
        _, stretches = course.since(self._done_ns)
        borders = [max(stretch.start_ns, self._done_ns) for stretch in stretches if stretch.start_ns <= now_ns]
        ends = [*borders[1:], now_ns]
        on = [bool(stretch.state.on) and stretch.state.set_v > 0.0 for stretch in stretches[: len(borders)]]
        return [each for each in zip(borders, ends, on, strict=True) if each[0] < each[1]]

    def _sample(self, start_ns: int, end_ns: int) -> None:
        times: list[npt.NDArray[np.int64]] = []
        ids: list[npt.NDArray[np.uint32]] = []
        rows: list[npt.NDArray[np.uint8]] = []
        for gyro in self._gyros:
            if gyro.model is None:
                gyro.power_ons += 1
                gyro.model = self._plan.gyro(
                    gyro.unit, gyro.power_ons, environment=self._environment, start_ns=start_ns
                )
                self._tell(gyro.model, 0.0)
            due = gyro.model.due(end_ns)
            if due <= 0:
                continue
            samples = gyro.model.samples(due)
            number = samples.first + np.arange(due, dtype=np.int64)
            t_ns = gyro.model.start_ns + number * gyro.model.parameters.sample_interval_ns
            times.append(t_ns[samples.present])
            ids.append(np.full(int(samples.present.sum()), gyro.arbitration_id, np.uint32))
            temperature = self._environment.temperature_deg_c(t_ns)
            rows.append(_payload(samples.counts, temperature, number)[samples.present])
        if not times:
            return
        order = np.argsort(np.concatenate(times), kind="stable")
        all_ids, all_rows = np.concatenate(ids)[order].tolist(), np.concatenate(rows)[order]
        data = all_rows.tobytes()
        self._send([(each, data[8 * i : 8 * i + 8]) for i, each in enumerate(all_ids)])
        self.frames += len(all_ids)


def _payload(
    counts: npt.NDArray[np.int32], temperature_deg_c: npt.NDArray[np.float64], number: npt.NDArray[np.int64]
) -> npt.NDArray[np.uint8]:
    rows = np.zeros(len(counts), np.dtype([("rate", "<i4"), ("temperature", "<i2"), ("counter", "<u2")]))
    rows["rate"] = counts
    rows["temperature"] = np.clip(np.rint(temperature_deg_c * 100.0), -32768, 32767)
    rows["counter"] = number % 65536
    return rows.view(np.uint8).reshape(len(counts), 8)


def play(
    plan: Plan,
    world: World,
    bench: SimulatedBench,
    latitude_deg: float,
    position: str,
    bus: Any,
    is_over: Callable[[], bool],
    on_power: Callable[[SimulatedGyroModel, float], None] | None = None,
    power_ons: Mapping[str, int] | None = None,
) -> int:
    """Play a fleet until it is over; how many frames were sent.

    Parameters
    ----------
    plan: The fleet.
    world: Lets the bench, which is a copy, follow the instruments.
    bench: What acts on the gyros.
    latitude_deg, position: Where the table stands, and how the gyros stand on it.
    bus: Where to send.
    is_over: Asked at every tick.
    on_power, power_ons: See `GyroBus`.

    Raises
    ------
    InstrumentError: If the instruments' process has ended.
    """
    import can

    def send(frames: Sequence[tuple[int, bytes]]) -> None:
        for arbitration_id, data in frames:
            bus.send(can.Message(arbitration_id=arbitration_id, data=data, is_extended_id=False, check=False))

    environment = bench.environment(latitude_deg, position)
    gyros = GyroBus(plan, environment, bench.supply, send, on_power, power_ons)
    try:
        while not is_over():
            gyros.advance(world.look())
            time.sleep(_TICK_S)
    finally:
        gyros.end()
    return gyros.frames
