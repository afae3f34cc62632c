"""Effects that are a product of powers of channels, such as T, T**2 or omega_I*omega_O: data of one class."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.effects.base import Effect, EffectKind, Inputs, Role, Shape, ShapeParameter
from analytics.loop.effects.channel_names import channel_name, reference_point, standard_reference
from stream.batch import FloatArray
from stream.errors import BadInput

NOMINAL = "_nominal"


def nominal(channel: str) -> ShapeParameter:
    """Shape parameter for the reference value of a channel without a natural zero; it is taken from the runs."""
    en, zh = channel_name(channel)
    return ShapeParameter(channel + NOMINAL, f"{{{channel}}}", (), f"nominal {en}", f"标称{zh}")


@dataclass(kw_only=True, eq=False)
class Monomial(Effect):
    """Product of powers of channels, each relative to its reference.

    The reference is 25 degC for temperatures, the value in the shape where the effect has a `nominal` parameter, else
    0. A block's mean of a power exceeds the power of its mean by the variance of the channel within the block.

    Parameters
    ----------
    powers: Exponent of each channel, 1 to 3; by default the channel of the effect's name, linear.
    per: See `Effect`; by default the product of the channels' units.
    """

    name: str
    en: str
    zh: str
    cause: str
    cause_zh: str
    reference: str
    separating_test: str
    separating_test_zh: str
    powers: Mapping[str, int] = field(default_factory=dict)
    aliases: tuple[str, ...] = ()
    follows: tuple[str, ...] = ()
    role: Role = Role.CAUSE
    kind: EffectKind = EffectKind.LIBRARY
    parameters: tuple[ShapeParameter, ...] = ()
    per: str = ""
    needs: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Derive channels and unit from the powers."""
        self.powers = self.powers or {self.name: 1}
        self.needs = tuple(self.powers)
        units = (f"{{{channel}}}" + (f"^{power}" if power > 1 else "") for channel, power in self.powers.items())
        self.per = self.per or "*".join(units)

    def shapes(self, runs: Sequence[RunBlocks]) -> Sequence[Shape]:
        return [{p.name: _median(p.name.removesuffix(NOMINAL), runs) for p in self.parameters}]

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        column = np.ones(len(run))
        for name, power in self.powers.items():
            channel = run.channels[name]
            reference = _reference(name, shape, reference_point(channel.unit_of_measure))
            column = column * _moment(channel, reference, power)
        return column[:, None]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        error = np.full(time_s.size, coefficients[0])
        for name, power in self.powers.items():
            error *= (channels[name] - _reference(name, shape, standard_reference(name))) ** power
        return error


def _reference(channel: str, shape: Shape, otherwise: float) -> float:
    value = shape.get(channel + NOMINAL, otherwise)
    if not isinstance(value, int | float):
        raise BadInput(f"{channel}{NOMINAL} is {value!r}; a number is needed")
    return float(value)


def _median(channel: str, runs: Sequence[RunBlocks]) -> float:
    means = np.concatenate([run.mean(channel) for run in runs])
    return float(f"{np.nanmedian(means):.3g}") if np.isfinite(means).any() else 0.0


def _moment(channel: Channel, reference: float, power: int) -> FloatArray:
    mean = channel.mean - reference
    if power == 1:
        return mean
    if power == 2:
        return np.asarray(mean**2 + channel.spread**2)
    return np.asarray(mean**3 + 3.0 * mean * channel.spread**2)
