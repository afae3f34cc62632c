"""Effects that are a product of powers of channels, such as T, T**2 or omega_I*omega_O: data of one class."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.effects.base import Effect, EffectKind, Inputs, Role, Shape, ShapeParameter
from analytics.loop.effects.block_kernels import block_means
from analytics.loop.effects.channel_names import channel_name, reference_point, standard_reference
from stream.batch import FloatArray
from stream.errors import BadInput

NOMINAL = "_nominal"
PREFIX = "channel:"
_DRIVERS = (
    *("temperature", "supply_voltage", "humidity", "vibration", "input_rate"),
    *("gravity_i", "gravity_o", "gravity_s", "magnetic_i", "magnetic_o", "magnetic_s"),
)
_WITHOUT_ZERO = ("supply_voltage", "humidity")
_GRAVITY = ("gravity_i", "gravity_o", "gravity_s")
_IN_LIBRARY = (frozenset(("temperature", "input_rate")), *(frozenset(pair) for pair in combinations(_GRAVITY, 2)))


def nominal(channel: str) -> ShapeParameter:
    """Shape parameter for the reference value of a channel without a natural zero; it is taken from the runs."""
    en, zh = channel_name(channel)
    return ShapeParameter(channel + NOMINAL, f"{{{channel}}}", (), f"nominal {en}", f"标称{zh}")


@dataclass(kw_only=True, eq=False)
class Monomial(Effect):
    """Product of powers of channels, each relative to its reference.

    The reference is 25 degC for temperatures, the value in the shape where the effect has a `nominal` parameter, else
    0. A block's mean of a power exceeds the power of its mean by the variance of the channel within the block.
    """

    name: str
    en: str
    zh: str
    cause: str
    cause_zh: str
    reference: str
    separating_test: str
    separating_test_zh: str
    powers: Mapping[str, int] = field(default_factory=dict)  # exponents, 1 to 3; default: own name, 1
    aliases: tuple[str, ...] = ()
    follows: tuple[str, ...] = ()
    role: Role = Role.CAUSE
    kind: EffectKind = EffectKind.LIBRARY
    parameters: tuple[ShapeParameter, ...] = ()
    per: str = ""  # by default the product of the channels' units
    needs: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
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
    return block_means(channel, lambda mean, spread: (mean - reference) ** 3 + 3.0 * (mean - reference) * spread**2)


def is_linear(effect: Monomial) -> bool:
    """Whether an effect is proportional to one channel, without a parameter.

    >>> is_linear(channel_linear("pressure"))
    True
    """
    return list(effect.powers.values()) == [1] and not effect.parameters


def channel_linear(channel: str) -> Monomial:
    """Linear effect of one channel, named ``channel:NAME``; for the channels without a standard name."""
    en, zh = channel_name(channel)
    return Monomial(
        name=PREFIX + channel,
        en=f"proportional to {en}",
        zh=f"与{zh}成比例",
        powers={channel: 1},
        cause="The signal is proportional to this recorded channel. The physical mechanism is not in the library.",
        cause_zh="信号与该记录通道成比例变化。其物理机理不在效应库之内。",
        reference="IEEE 952-2020, environmental sensitivities",
        separating_test="step this channel alone, several times, with all others held constant",
        separating_test_zh="保持其他条件不变，单独多次阶跃改变该通道",
    )


def product_of_channels(first: str, second: str) -> Monomial:
    """Product of two standard channels, each relative to its reference; named ``temperature*supply_voltage``."""
    names = (channel_name(first), channel_name(second))
    return Monomial(
        name=f"{first}*{second}",
        en=f"{names[0][0]} times {names[1][0]}",
        zh=f"{names[0][1]}与{names[1][1]}乘积",
        powers={first: 1, second: 1},
        kind=EffectKind.SECOND_TIER,
        parameters=tuple(nominal(channel) for channel in (first, second) if channel in _WITHOUT_ZERO),
        cause="The sensitivity to one influence depends on another, as when the drift of a regulator depends on its "
        "temperature. Varying only one of them does not show it.",
        cause_zh="对一种因素的灵敏度取决于另一种因素，例如稳压器漂移取决于其温度。单独改变任一因素都看不出。",
        reference="IEEE 1431-2004, combined environmental sensitivities",
        separating_test="factorial test of both: each at two levels, all four combinations, repeated",
        separating_test_zh="两个因素的全因子试验：各取高低两档，共四种组合，重复进行",
    )


EFFECTS = tuple(product_of_channels(*pair) for pair in combinations(_DRIVERS, 2) if frozenset(pair) not in _IN_LIBRARY)
