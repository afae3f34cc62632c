"""Units of measure in Chinese words: words, prefixes, powers and roots, joined as units in letters are."""

import re
from functools import lru_cache

_WORDS = {
    "度": "deg", "弧度": "rad", "角秒": "arcsec", "角分": "arcmin", "摄氏度": "degC", "开尔文": "K", "秒": "s",
    "分": "min", "分钟": "min", "小时": "h", "时": "h", "天": "day", "伏": "V", "伏特": "V", "安": "A", "安培": "A",
    "瓦": "W", "瓦特": "W", "赫": "Hz", "赫兹": "Hz", "欧": "ohm", "欧姆": "ohm", "米": "m", "帕": "Pa",
    "帕斯卡": "Pa", "特斯拉": "T", "高斯": "gauss", "转": "turn", "脉冲": "count", "脉冲数": "count", "个": "count",
}  # fmt: skip
_PREFIXES = {"纳": "n", "微": "u", "毫": "m", "百": "h", "千": "k", "兆": "M", "": ""}
_AS_USUAL = {"turn/min": "rpm"}
_CHINESE = re.compile("[\u4e00-\u9fff]")
_LONGEST = 30
_WORD = re.compile(f"({'|'.join(filter(None, _PREFIXES))})?({'|'.join(sorted(_WORDS, key=len, reverse=True))})")
_SQUARED = re.compile("(?:二次方|平方)(.+)|(.+?)(?:二次方|平方|²|\\^2|2)")
_ROOT = re.compile(r"(?:√|根号|根)(?:\((.+)\)|(.+))")
_LETTERS = re.compile("[A-Za-z°µμΩ]+")


@lru_cache(maxsize=4096)
def chinese_unit(text: str) -> str | None:
    """A unit of measure in Chinese words, in letters; None where the text is none.

    >>> chinese_unit("度每小时"), chinese_unit("毫度/秒"), chinese_unit("度/√小时"), chinese_unit("米每二次方秒")
    ('deg/h', 'mdeg/s', 'deg/sqrt(h)', 'm/s^2')
    >>> chinese_unit("转/分"), chinese_unit("度/h"), chinese_unit("兆欧"), chinese_unit("转台"), chinese_unit("deg/s")
    ('rpm', 'deg/h', 'Mohm', None, None)
    """
    text = "".join(text.split())
    if len(text) > _LONGEST or _CHINESE.search(text) is None:
        return None
    factors = [_factor(each) for each in re.split("[/每]", text)]
    if None in factors:
        return None
    unit = "/".join(map(str, factors))
    return _AS_USUAL.get(unit, unit)


def _factor(text: str) -> str | None:
    if match := _ROOT.fullmatch(text):
        inner = _factor(match[1] or match[2])
        return inner and f"sqrt({inner})"
    if match := _WORD.fullmatch(text):
        return _PREFIXES[match[1] or ""] + _WORDS[match[2]]
    if _LETTERS.fullmatch(text):
        return text.replace("°", "deg")
    if match := _SQUARED.fullmatch(text):
        inner = _factor(match[1] or match[2])
        return inner and f"{inner}^2"
    return None
