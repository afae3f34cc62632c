"""Reasons in Chinese: why there is no value or no verdict, what a value rests on."""

import re
import tomllib
from functools import cache, lru_cache
from importlib.resources import files

from analytics.evaluation.system_errors import system_error
from ingest.measurement_standards import QUANTITIES

_PLACE = re.compile(r"\{(\d)\}")
_OF_STANDARD = re.compile(r"((?:GJB|JJF) ?\d+[A-Z]?): (.+)")
_VERDICTS = {"PASS": "合格", "FAIL": "不合格", "MARGINAL": "临界", "NO_DATA": "无数据"}


@lru_cache(4096)
def in_chinese(reason: str) -> str:
    """A reason of a metric, verdict or clock in Chinese; itself where `reasons.toml` does not have it.

    >>> in_chinese("record of 300 s: the clauses ask for one hour as a rule")
    '记录长 300 s：条款一般要求一小时'
    >>> in_chinese("3 power-ons measured, the clause asks for 6 or more")
    '测得 3 次上电，条款要求不少于 6 次'
    >>> in_chinese("/data/lake: Input/output error")
    '/data/lake：输入/输出错误'
    >>> in_chinese("type B unknown: table rate, error common to all rates, clock rate: the station states none")
    'B类未知：转台速率(各速率共同误差)、时钟频率：试验台未给出'
    >>> in_chinese("something else")
    'something else'
    """
    if len(texts := reason.split("; ")) > 1:  # first, since a place of one text would reach into the next
        parts = [_translated(part) for part in texts]
        if all(parts):
            return "；".join(part for part in parts if part)
    if (found := _translated(reason)) is not None:
        return found
    of_standard = _OF_STANDARD.fullmatch(reason)
    return f"{of_standard[1]}：{in_chinese(of_standard[2])}" if of_standard else reason


@cache
def _quantities() -> tuple[re.Pattern[str], dict[str, str]]:
    """A list of quantities of measurement standards, and their Chinese names; a name may have a comma."""
    names = {each.en: each.zh for each in QUANTITIES.values()}
    one = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True))
    return re.compile(rf"(?:(?:{one})(?:, |$))+"), names


def _translated(text: str) -> str | None:
    pattern, names = _quantities()
    if pattern.fullmatch(text) is not None:
        return "、".join(names[each] for each in re.findall("|".join(map(re.escape, names)), text))
    for pattern, chinese in _patterns():
        if (match := pattern.fullmatch(text)) is not None:
            filled = [_VERDICTS.get(part) or in_chinese(part) for part in match.groups()]
            return "".join(filled[int(each[1])] if _PLACE.fullmatch(each) else each for each in _pieces(chinese))
    if (error := system_error(text)) is None:
        return None
    before, what, of = error
    return (f"{in_chinese(before)}：" if before else "") + what + (f"：{of}" if of else "")


@cache
def _patterns() -> list[tuple[re.Pattern[str], str]]:
    """English texts as patterns, those with the most own letters first."""
    content = tomllib.loads(files("analytics.evaluation").joinpath("reasons.toml").read_text(encoding="utf-8"))
    known = sorted(content.items(), key=lambda each: -len(_PLACE.sub("", each[0])))
    return [(re.compile(_PLACE.sub("(.+?)", _escaped(english))), chinese) for english, chinese in known]


def _escaped(english: str) -> str:
    """The pattern of a text in which places stay as they are."""
    return "".join(each if _PLACE.fullmatch(each) else re.escape(each) for each in _pieces(english))


def _pieces(text: str) -> list[str]:
    """Places of a text, and what stands between them."""
    return re.split(r"(\{\d\})", text)
