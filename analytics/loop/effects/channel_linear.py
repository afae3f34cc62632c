"""What a channel of no standard name does to the signal, if it does so in proportion."""

from collections.abc import Sequence

from analytics.loop.effects.base import Effect
from analytics.loop.effects.channel_names import channel_name
from analytics.loop.effects.monomial import Monomial

PREFIX = "channel:"


class ChannelLinear(Monomial):
    """Linear effect of one channel, named ``channel:NAME``; made for the channels that a record happens to have.

    Parameters
    ----------
    channel: Name of the channel in the record.

    Examples
    --------
    >>> ChannelLinear("compressor").name
    'channel:compressor'
    """

    powers = (1,)
    cause = (
        "The signal follows this recorded channel in proportion. What physics stands behind it the library does not "
        "know."
    )
    cause_zh = "信号与该记录通道成比例变化。其物理机理不在效应库之内。"
    reference = "IEEE 952-2020, environmental sensitivities"
    separating_test = "step this channel alone, several times, with all others held"
    separating_test_zh = "保持其他条件不变，单独多次阶跃改变该通道"

    def __init__(self, channel: str) -> None:
        en, zh = channel_name(channel)
        self.name = PREFIX + channel
        self.en = f"proportional to {en}"
        self.zh = f"与{zh}成比例"
        self.needs = (channel,)
        self.per = f"{{{channel}}}"

    @classmethod
    def instances(cls) -> Sequence[Effect]:
        return ()
