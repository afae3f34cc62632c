"""Effects made from the names of channels: in proportion to one channel, and products of two."""

from itertools import combinations

from analytics.loop.effects.base import EffectKind
from analytics.loop.effects.channel_names import channel_name
from analytics.loop.effects.monomial import Monomial, nominal

PREFIX = "channel:"

_DRIVERS = (
    *("temperature", "supply_voltage", "humidity", "vibration", "input_rate"),
    *("gravity_i", "gravity_o", "gravity_s", "magnetic_i", "magnetic_o", "magnetic_s"),
)
_WITHOUT_ZERO = ("supply_voltage", "humidity")
_GRAVITY = ("gravity_i", "gravity_o", "gravity_s")
_IN_LIBRARY = (frozenset(("temperature", "input_rate")), *(frozenset(pair) for pair in combinations(_GRAVITY, 2)))


def channel_linear(channel: str) -> Monomial:
    """Linear effect of one channel, named ``channel:NAME``; for the channels without a standard name.

    Examples
    --------
    >>> channel_linear("compressor").name
    'channel:compressor'
    """
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
