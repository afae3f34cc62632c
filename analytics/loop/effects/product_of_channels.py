"""Products of two channels, for what acts only together with something else."""

from collections.abc import Sequence
from itertools import combinations

from analytics.loop.effects.base import Effect, Kind
from analytics.loop.effects.channel_names import channel_name
from analytics.loop.effects.monomial import Monomial, nominal

_DRIVERS = (
    *("temperature", "supply_voltage", "humidity", "vibration", "input_rate"),
    *("gravity_i", "gravity_o", "gravity_s", "magnetic_i", "magnetic_o", "magnetic_s"),
)
_WITHOUT_ZERO = ("supply_voltage", "humidity")
_GRAVITY = ("gravity_i", "gravity_o", "gravity_s")
_IN_LIBRARY = (frozenset(("temperature", "input_rate")), *(frozenset(pair) for pair in combinations(_GRAVITY, 2)))


class ProductOfChannels(Monomial):
    """Product of two channels, each counted from its reference; named ``temperature*supply_voltage``.

    Parameters
    ----------
    first, second: Standard channels.
    """

    kind = Kind.SECOND_TIER
    powers = (1, 1)
    cause = (
        "The sensitivity to one influence depends on another one, as when a regulator's drift depends on its heat. "
        "Neither alone shows it."
    )
    cause_zh = "对一种因素的灵敏度取决于另一种因素，例如稳压器漂移取决于其温度。单独改变任一因素都看不出。"
    reference = "IEEE 1431-2004, combined environmental sensitivities"
    separating_test_zh = "两个因素的全因子试验：各取高低两档，共四种组合，重复进行"
    separating_test = "factorial test of both: each at two levels, all four combinations, repeated"

    def __init__(self, first: str, second: str) -> None:
        names = (channel_name(first), channel_name(second))
        self.name = f"{first}*{second}"
        self.en = f"{names[0][0]} times {names[1][0]}"
        self.zh = f"{names[0][1]}与{names[1][1]}乘积"
        self.needs = (first, second)
        self.per = f"{{{first}}}*{{{second}}}"
        self.parameters = tuple(nominal(channel) for channel in self.needs if channel in _WITHOUT_ZERO)

    @classmethod
    def instances(cls) -> Sequence[Effect]:
        return tuple(cls(*pair) for pair in combinations(_DRIVERS, 2) if frozenset(pair) not in _IN_LIBRARY)
