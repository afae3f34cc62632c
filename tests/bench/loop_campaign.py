"""A simulated test campaign of one gyro: fifteen runs in five types of test, with planted effects, as blocks.

    campaign = Campaign(seed=1)
    size = campaign.coefficients_for("warm_up", {"time_constant": 2000.0}, z=10.0)
    runs = campaign.runs([Planted("warm_up", size, {"time_constant": 2000.0})], misspecified="heavy_tails")

Effects are planted by their `simulate` at instants of two seconds and then averaged; the noise is made in
`loop_noise`, the channels in `loop_drives`. The last third of the runs holds one of each type: the held-out set.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from analytics.loop.blocks.run_blocks import HARMONICS, Channel, RunBlocks
from analytics.loop.effects.base import Shape
from analytics.loop.effects.registry import effect
from stream.batch import FloatArray, IntArray
from tests.bench.loop_drives import TYPES, UNITS, drive
from tests.bench.loop_noise import MISSPECIFIED, DenseWhitener, Noise, synthesise

__all__ = ["MISSPECIFIED", "TYPES", "Campaign", "DenseWhitener", "Noise", "Planted"]

DECLARED_MODEL = "bias + scale_factor*input_rate + temperature"
BIAS_DEG_PER_H, SCALE_FACTOR, PER_DEG_C = 0.5, 3600.36, 0.012
_NS_PER_DAY = 86_400 * 10**9
_FIRST_DAY_NS = 20_000 * _NS_PER_DAY


@dataclass(frozen=True)
class Planted:
    """An effect at work on the gyro: its name, one coefficient for each column, and its shape."""

    effect: str
    coefficients: Sequence[float]
    shape: Shape = field(default_factory=dict)
    only_runs: tuple[int, ...] = ()
    """Numbers of the runs in which it is at work; empty: in all."""


class Campaign:
    """Runs of one gyro whose channels are made once, and that can be read with any effects and noise.

    Parameters
    ----------
    seed : int
    runs : int
        Their types follow one another in the order of `types`.
    types : sequence of str
        Of `TYPES`.
    duration_s, block_s, step_s : float
        Of a run, a block, and between the instants at which effects and noise are made.
    noise : Noise
        As declared.
    missing : float
        Share of the blocks that is lost, in stretches.
    unit : str
    """

    def __init__(
        self,
        seed: int,
        *,
        runs: int = 15,
        types: Sequence[str] = TYPES,
        duration_s: float = 21600.0,
        block_s: float = 30.0,
        step_s: float = 2.0,
        noise: Noise | None = None,
        missing: float = 0.0,
        unit: str = "FOG-0231",
    ) -> None:
        self.seed, self.block_s, self.step_s, self.unit = seed, block_s, step_s, unit
        self.noise = noise or Noise()
        rng = np.random.default_rng((seed, 1))
        self.drives = [drive(types[k % len(types)], k, rng, duration_s, step_s) for k in range(runs)]
        self.names = [f"{number:02d}-{each.kind}" for number, each in enumerate(self.drives)]
        blocks = round(duration_s / block_s)
        self.slots = [_slots(blocks, missing, rng) for _ in range(runs)]

    @property
    def training(self) -> list[int]:
        """Numbers of the runs that are no held-out set: the first two thirds."""
        return list(range(len(self.drives) - len(self.drives) // 3))

    def runs(
        self,
        planted: Sequence[Planted] = (),
        *,
        misspecified: str = "",
        channels: Sequence[str] | None = None,
        noise_seed: int | None = None,
        noiseless: bool = False,
    ) -> list[RunBlocks]:
        """The runs as they are read.

        Parameters
        ----------
        planted : sequence of Planted
            At work beside bias, scale factor and linear temperature.
        misspecified : str
            One of `MISSPECIFIED`, or none: how the noise departs from what is declared.
        channels : sequence of str, optional
            Those that are recorded; by default all but ``position``, which says the same as the gravity channels.
        noise_seed : int, optional
            The same channels with other noise; by default that of the campaign.
        noiseless : bool
            Whether the gyro has no noise at all.
        """
        seed = self.seed if noise_seed is None else noise_seed
        rng = np.random.default_rng((seed, 2))
        rates = [each.true["table_rate"] for each in self.drives]
        noise = synthesise(rates, self.step_s, self.noise, misspecified, rng)
        found = []
        for number, each in enumerate(self.drives):
            working = [one for one in planted if not one.only_runs or number in one.only_runs]
            read = dict(each.read)
            for one in working:
                read = dict(effect(one.effect).recorded(each.time_s, read))
            signal = BIAS_DEG_PER_H + SCALE_FACTOR * read["input_rate"] + PER_DEG_C * (read["temperature"] - 25.0)
            for one in working:
                signal = signal + self._at_work(one, number)
            if not noiseless:
                signal = signal + noise[number]
            kept = {name: read[name] for name in channels or read if channels or name != "position"}
            turning = SCALE_FACTOR * read["input_rate"]
            found.append(self._reduced(number, signal, self._scatter(number, signal - turning), kept))
        return found

    def added(self, planted: Planted) -> list[FloatArray]:
        """What an effect adds to each block of each run, in deg/h."""
        return [self._block_means(number, self._at_work(planted, number)) for number in range(len(self.drives))]

    def coefficients_for(
        self,
        name: str,
        shape: Shape,
        z: float,
        *,
        direction: Sequence[float] | None = None,
        declared: Callable[[RunBlocks], FloatArray] | None = None,
        whiten: Callable[[FloatArray], FloatArray] | None = None,
        only_runs: tuple[int, ...] = (),
    ) -> list[float]:
        """Coefficients at which the ideal fit finds the effect with significance `z` in the training runs.

        Ideal is generalised least squares that knows the shape, the direction and the noise.

        Parameters
        ----------
        direction : sequence of float, optional
            The proportions of several coefficients; alike by default.
        declared : callable, optional
            Columns of the declared model of a run; bias, input rate and temperature by default.
        whiten : callable, optional
            From the stacked columns of the training runs to white ones; by the covariance of the campaign's noise.
        """
        wanted = effect(name)
        proportions = np.ones(len(wanted.columns(shape))) if direction is None else np.asarray(direction, float)
        clean = self.runs(noiseless=True)
        training = [clean[number] for number in self.training]
        known = np.concatenate([(declared or _declared_columns)(run) for run in training])
        added = self.added(Planted(name, list(proportions), shape, only_runs))
        column = np.concatenate([added[number] for number in self.training])
        if whiten is None:
            whiten = DenseWhitener([self.slots[number] for number in self.training], self.block_s, self.noise)
        white = whiten(np.column_stack([known, column]))
        basis, _ = np.linalg.qr(white[:, :-1] / np.linalg.norm(white[:, :-1], axis=0))
        left = white[:, -1] - basis @ (basis.T @ white[:, -1])
        information = float(np.linalg.norm(left))
        if not information > 1e-9 * float(np.linalg.norm(white[:, -1])):
            raise ValueError(f"{name} {dict(shape)} leaves no trace in the training runs beside the declared model")
        return [float(each) for each in proportions * (z / information)]

    def _at_work(self, planted: Planted, number: int) -> FloatArray:
        each = self.drives[number]
        if "run" in planted.shape and planted.shape["run"] != self.names[number]:
            return np.zeros(each.time_s.size)
        if planted.only_runs and number not in planted.only_runs:
            return np.zeros(each.time_s.size)
        return effect(planted.effect).simulate(each.time_s, each.true, planted.coefficients, planted.shape)

    def _reduced(
        self, number: int, signal: FloatArray, scatter: FloatArray, read: Mapping[str, FloatArray]
    ) -> RunBlocks:
        slot, each = self.slots[number], self.drives[number]
        samples = round(self.block_s / self.step_s)
        return RunBlocks(
            unit=self.unit,
            run=self.names[number],
            signal="rate",
            slot=slot,
            block_s=self.block_s,
            t0_ns=_FIRST_DAY_NS + round(each.day * _NS_PER_DAY),
            value=self._block_means(number, signal),
            n=np.full(slot.size, samples),
            white_variance=scatter,
            unit_of_measure="deg/h",
            channels={name: self._channel(number, name, values) for name, values in read.items()},
        )

    def _channel(self, number: int, name: str, values: FloatArray) -> Channel:
        blocks = self._blocks(number, values)
        phasors = None
        if name == "table_angle":
            turning = np.exp(1j * np.deg2rad(blocks))
            phasors = np.stack([(turning**k).mean(axis=1) for k in range(1, HARMONICS + 1)])
        return Channel(blocks.mean(axis=1), blocks.std(axis=1), UNITS[name], phasors)

    def _block_means(self, number: int, values: FloatArray) -> FloatArray:
        return np.asarray(self._blocks(number, values).mean(axis=1))

    def _scatter(self, number: int, values: FloatArray) -> FloatArray:
        """White variance of block means from successive differences, which slow changes leave alone."""
        steps = np.diff(self._blocks(number, values), axis=1)
        return np.asarray((steps**2).mean(axis=1) / 2.0 / (steps.shape[1] + 1))

    def _blocks(self, number: int, values: FloatArray) -> FloatArray:
        return np.asarray(values.reshape(-1, round(self.block_s / self.step_s))[self.slots[number]])


def _declared_columns(run: RunBlocks) -> FloatArray:
    return np.column_stack([np.ones(len(run)), run.mean("input_rate"), run.mean("temperature") - 25.0])


def _slots(blocks: int, missing: float, rng: np.random.Generator) -> IntArray:
    is_kept = np.ones(blocks, bool)
    while is_kept.mean() > 1.0 - missing:
        first = int(rng.integers(blocks))
        is_kept[first : first + int(rng.integers(1, 60))] = False
    return np.flatnonzero(is_kept)
