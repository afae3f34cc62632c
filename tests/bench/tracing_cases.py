"""What the trace of a residual is tried on: campaigns with nothing, one or two effects, and designs that hide them.

Planted effects get the size at which the ideal fit sees them with significance z in the training runs.
"""

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import EffectKind, Role, Shape
from analytics.loop.effects.registry import effect, effects
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from stream.batch import FloatArray
from tests.bench.loop_campaign import DECLARED_MODEL, MISSPECIFIED, Campaign, DenseWhitener, Planted
from tests.bench.loop_noise import EXCESSIVE

DECLARED = ModelNoise(N=0.005, B=0.01, K=0.006, turn_on=0.05)
MODEL = ErrorModel.parse(f"rate = {DECLARED_MODEL}")
SIZES = (6.0, 10.0, 20.0)
TWO_EFFECTS_Z, DESIGN_Z = 12.0, 14.0
ROWS = ("null", "excess", "planted", "two", "ramp", "once", "outside", "removed")
_NULL, _PLANTED, _TWO, _DESIGN = 1000, 2000, 3000, 4000  # first seeds
_WITHOUT_ENVIRONMENT = ("static", "temperature", "rate", "positions")
_ONCE = (*_WITHOUT_ENVIRONMENT, "environment", *_WITHOUT_ENVIRONMENT * 3)
_IN_RAMPS = ("temperature_squared", "temperature_rate", "thermal_lag", "warm_up", "drift_in_run")
_IN_ENVIRONMENT = ("magnetic_o", "supply_voltage_squared", "vibration", "magnetic_i")
_REMOVED = ("gravity_o", "temperature_squared", "scale_factor_cubic", "magnetic_i")

OUTSIDE: Mapping[str, tuple[tuple[str, ...], Callable[[RunBlocks], FloatArray]]] = {
    "wave of temperature": (("temperature",), lambda run: np.sin(2.0 * np.pi * run.mean("temperature") / 30.0)),
    "resonance of vibration": (("vibration",), lambda run: np.exp(-0.5 * ((run.mean("vibration") - 0.9) / 0.15) ** 2)),
    "peak of supply": (
        ("supply_voltage",),
        lambda run: np.exp(-0.5 * ((run.mean("supply_voltage") - 12.4) / 0.2) ** 2),
    ),
    "ripple of rate": (("input_rate", "table_rate"), lambda run: np.sin(2.0 * np.pi * run.mean("input_rate") / 13.0)),
}
"""Effects that the library has no name for, by the channels that drive them."""


@dataclass(frozen=True)
class Case:
    """One campaign to be traced.

    Parameters
    ----------
    row : str
        One of `ROWS`.
    name : str
        What is special: an effect, two with ``+`` between, a misspecification of the noise.
    z : float
        Ideal significance of each effect; 0 where nothing is planted.
    seed : int
    """

    row: str
    name: str
    z: float
    seed: int

    @property
    def key(self) -> str:
        """What tells it from all others."""
        return f"{self.row}/{self.name}/{self.z:g}/{self.seed}"

    @property
    def noise_seed(self) -> int:
        """Noise of its own: cases of one seed share their channels only, so that their outcomes are independent."""
        return zlib.crc32(self.key.encode())


@dataclass(frozen=True)
class Built:
    """A campaign ready to be traced, with the truth."""

    campaign: Campaign
    runs: list[RunBlocks]
    planted: tuple[Planted, ...]


def cases(
    row: str, count: int, sizes: Sequence[float] = SIZES, only: Sequence[str] = (), *, first: int = 0
) -> list[Case]:
    """`count` cases of each kind of a row, from seed number `first` on, all kinds with one seed after the other."""
    numbers = range(first, first + count)
    return [case for number in numbers for case in _of_seed(row, number, sizes) if not only or case.name in only]


def _of_seed(row: str, number: int, sizes: Sequence[float]) -> Iterator[Case]:
    if row in ("null", "excess"):
        noises = MISSPECIFIED if row == "null" else EXCESSIVE
        yield from (Case(row, name, 0.0, _NULL + number) for name in noises)
    elif row == "planted":
        yield from (Case(row, name, z, _PLANTED + number) for z in sizes for name in plantable())
    elif row == "two":
        yield from (Case(row, _pair(seed), TWO_EFFECTS_Z, seed) for seed in (_TWO + 3 * number + k for k in range(3)))
    else:
        names = {"ramp": _IN_RAMPS, "once": _IN_ENVIRONMENT, "outside": tuple(OUTSIDE), "removed": _REMOVED}[row]
        yield from (Case(row, name, DESIGN_Z, _DESIGN + number) for name in names)


def plantable() -> list[str]:
    """Every effect but the declared ones, products (made by a rule) and the bias by position (no such channel here)."""
    return [
        name
        for name, its in effects().items()
        if name not in MODEL.effects and "position" not in its.needs and "*" not in name
    ]


def built(case: Case) -> Built:
    """Make the runs of a case."""
    if case.row in ("null", "excess"):
        campaign = standard(case.seed)
        return Built(campaign, campaign.runs(misspecified=case.name, noise_seed=case.noise_seed), ())
    campaign = _design(case.row, case.seed)
    if case.row == "outside":
        return Built(campaign, _with_outside(campaign, case), ())
    rng = np.random.default_rng((case.seed, 3))
    planted = tuple(planted_in(campaign, name, case.z, rng) for name in case.name.split(" + "))
    return Built(campaign, campaign.runs(planted, noise_seed=case.noise_seed), planted)


@lru_cache(maxsize=2)
def standard(seed: int) -> Campaign:
    """Fifteen runs in five types of test."""
    return Campaign(seed)


@lru_cache(maxsize=2)
def _design(row: str, seed: int) -> Campaign:
    if row == "ramp":
        return Campaign(seed, types=("ramp",), runs=9)
    if row == "once":
        return Campaign(seed, types=_ONCE, runs=15)
    return standard(seed)


def shape_of(name: str, campaign: Campaign, rng: np.random.Generator) -> Shape:
    """Some shape of an effect, drawn from its grid; of a line and a jump any."""
    if effect(name).kind is EffectKind.LINE:
        return {"frequency_hz": float(1.0 / rng.uniform(150.0, 1500.0))}
    if effect(name).kind is EffectKind.EVENT:
        return {"run": campaign.names[int(rng.integers(10))], "at_s": float(rng.uniform(4000.0, 17000.0))}
    shapes = effect(name).shapes(campaign.runs(noiseless=True))
    return dict(shapes[int(rng.integers(len(shapes)))])


def planted_in(campaign: Campaign, name: str, z: float, rng: np.random.Generator) -> Planted:
    """An effect of some shape, of the size that the ideal fit sees with significance `z`."""
    shape = shape_of(name, campaign, rng)
    width = len(effect(name).columns(shape))
    smooth = np.cos(np.linspace(0.0, 3.0, width) + rng.uniform(0.0, 3.0))
    direction = [float(each) for each in (rng.standard_normal(2) if width == 2 else smooth)]
    size = campaign.coefficients_for(name, shape, z, direction=direction if width > 1 else None)
    return Planted(name, size, shape)


def _pair(seed: int) -> str:
    """Two causes, neither of which the library calls an alias of the other.

    The squares of gravity along three axes add up to one, so that two of them are the third.
    """
    rng = np.random.default_rng((seed, 4))
    known = [
        name for name in plantable() if effect(name).kind is EffectKind.LIBRARY and effect(name).role is Role.CAUSE
    ]
    while True:
        first, second = (str(name) for name in rng.choice(known, 2, replace=False))
        squares = first.startswith("gravity") and second.startswith("gravity") and "squared" in first + second
        if not squares and second not in effect(first).aliases and first not in effect(second).aliases:
            return f"{first} + {second}"


def _with_outside(campaign: Campaign, case: Case) -> list[RunBlocks]:
    """The runs with an effect that has no name, of the size that the ideal fit sees with the z of the case."""
    _, form = OUTSIDE[case.name]
    runs = campaign.runs(noise_seed=case.noise_seed)
    whiten = DenseWhitener([campaign.slots[number] for number in campaign.training], campaign.block_s, campaign.noise)
    known = [
        np.column_stack([np.ones(len(run)), run.mean("input_rate"), run.mean("temperature"), form(run)])
        for run in (runs[number] for number in campaign.training)
    ]
    white = whiten(np.concatenate(known))
    basis, _ = np.linalg.qr(white[:, :-1] / np.linalg.norm(white[:, :-1], axis=0))
    left = white[:, -1] - basis @ (basis.T @ white[:, -1])
    size = case.z / float(np.linalg.norm(left))
    return [replace(run, value=run.value + size * form(run)) for run in runs]
