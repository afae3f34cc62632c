"""Which units of a file are tested, and which measure beside them, as a chamber does."""

import re
from collections.abc import Iterable, Sequence

from ingest.tables.sample_file import SignalSummary
from stream.channel_names import STANDARD_CHANNELS
from stream.quantities import is_angular_rate

# as the SQL macro `is_instrument_name` has it
_INSTRUMENT = re.compile(
    "^(table|input|chamber|command|cmd|set_?point|target|demand|desired|vibration|stage|platform|encoder|earth|motor"
    "|spindle|soll|(dreh)?tisch|drehzahl|vorgabe|referenz|kammer|consigne|plateau)"
    "|^(reference|ref|true|truth)(_|$)"
    "|^rate_(table|input|command|set_?point|target|demand|desired|reference|ref|true|truth|[os])$"
    "|^(转台|台面|台体|速率台|[内中外]框|基准|参考|标准|指令|设定|给定|输入|目标|期望|温箱|地球|地速|电机)|转速"
    "|^(轉台|速率台|基準|標準|設定|給定|目標|テーブル|モータ)|轉速|回転数"
)
_OUTPUT = re.compile("^(rate|gyro|angle|output)")
_NAMED = re.compile("^rate(_|$)|^gyro(_[xyz])?$|^(?i:angle_([xyz]|heading|yaw|azimuth|pitch|roll))$")
_CHINESE = re.compile(
    "(([xyz][轴向]?|航向|俯仰|横滚|滚转)_?)?((光纤|激光)?陀螺仪?|角速[率度])"
    "(输出(信号|脉冲|计数|电压)?|信号|脉冲|计数)?数?值?_?([xyz][轴向]?|[0-9]+)?"
)
_BESIDE = re.compile("temp|温度|suppl|供电|电流|current|acc|加速度|加计|加表|^time|status|状态|humid|湿度|press|气压")
_COUNTS = frozenset({"count", "LSB", "count/s", "LSB/s"})


def is_instrument_name(signal: str) -> bool:
    """Whether a signal is that of a table, a chamber, or a reference.

    >>> is_instrument_name("Table_rate"), is_instrument_name("Soll-Drehrate"), is_instrument_name("rate_x")
    (True, True, False)
    """
    return _INSTRUMENT.search(signal.lower()) is not None


def is_output_name(signal: str) -> bool:
    """Whether metrics take a signal for the output of a gyro by its name, as the SQL macro `is_output_name` has it.

    >>> is_output_name("rate_x"), is_output_name("X轴陀螺输出"), is_output_name("rate_table"), is_output_name("转速")
    (True, True, False, False)
    """
    is_named = _NAMED.search(signal) is not None or _CHINESE.fullmatch(signal.lower()) is not None
    return is_named and not is_instrument_name(signal)


def tested_units(signals: Iterable[SignalSummary]) -> list[str]:
    """Units of which a signal may be the output of a gyro, by its unit of measure or its name."""
    return list(dict.fromkeys(each.unit for each in signals if may_be_output(each)))


def may_be_output(signal: SignalSummary) -> bool:
    """Whether a signal may be the output of a gyro, by its unit of measure or its name."""
    if is_instrument_name(signal.signal):
        return False
    name = signal.signal.lower()
    if _OUTPUT.search(name) is not None or _CHINESE.fullmatch(name) is not None or signal.unit_of_measure in _COUNTS:
        return True
    return is_angular_rate(signal.unit_of_measure)


def no_output_warnings(signals: Sequence[SignalSummary]) -> list[str]:
    """A warning where metrics take no signal of a file for the output of a gyro, and some could be one."""
    others = [
        each.signal for each in signals
        if each.signal not in STANDARD_CHANNELS and not is_instrument_name(each.signal)
        and _BESIDE.search(each.signal.lower()) is None
    ]  # fmt: skip
    if not others or any(map(_is_output, signals)):
        return []
    name = others[0]
    rename = f"import the file with --rename '{name}=rate'"
    return [f"warning: no signal is taken for the output of a gyro: if {name} is one, {rename}"]


def _is_output(signal: SignalSummary) -> bool:
    """Whether metrics take a signal for the output of a gyro."""
    name = signal.signal
    return is_output_name(name) or (is_angular_rate(signal.unit_of_measure) and not is_instrument_name(name))
