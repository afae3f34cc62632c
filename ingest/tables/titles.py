"""Titles of columns: name and unit of measure, as other programs and Chinese ones write them too."""

import difflib
import re
from collections.abc import Iterator
from functools import lru_cache

from ingest.tables.steps import WORD_NAMES
from ingest.tables.units import is_per_time, is_time_unit
from stream.errors import BadInput
from stream.identity import check_name

SQUARE = "name it like 'rate[deg/s]'"
_TITLE = re.compile(r"\s*([^\[\]]*?)\s*(?:\[([^\[\]]*)\])?\s*")
_ROUND_TITLE = re.compile(r"\s*([^\[\]]*?)\s*/?\s*\(((?:[^()\[\]]|\([^()\[\]]*\))*)\)\s*")
_LOOKS_LIKE_TIME = frozenset({
    "t", "time", "timestamp", "times", "epoch", "clock", "date", "datetime", "elapsedtime", "zeit", "zeitstempel",
})  # fmt: skip
_CHINESE_TIMES = frozenset({"时间", "时刻", "时间戳", "采样时间", "记录时间", "日期时间", "日期", "相对时间"})
_SLASH_TITLE = re.compile(r"\s*([^\[\]()/]*[\u4e00-\u9fff][^\[\]()/]*?)\s*/\s*([^\[\]]+?)\s*")  # 量/单位, GB/T 3101
# a unit without brackets begins behind a blank or a colon, or where Chinese letters end
_UNIT_EDGE = re.compile(
    r"[\s：:]+|(?<=[\u4e00-\u9fff])(?=[^\u4e00-\u9fff\w\s：:/\[\]()]|[a-zA-Zµμ])|(?<=[\u4e00-\u9fff])(?<![角温速])(?=度[/每])"
)
_OF_TIME = re.compile("时|间隔|周期|延迟|time|delay|latency|duration|interval|period")
_FULL_WIDTH = str.maketrans("（）［］【】／", "()[][]/")


@lru_cache(maxsize=4096)  # files of one command have the same titles
def title_parts(title: str) -> tuple[str, str | None, bool]:
    """Name and unit of a title, and whether its unit stands as other programs write it: in round brackets or bare."""
    title = title.translate(_FULL_WIDTH)
    if match := _ROUND_TITLE.fullmatch(title):
        return match[1], match[2], True
    if "/" in title and (found := next((each for each in _unit_ends(title) if is_per_time(each[1])), None)):
        return *found, True
    if match := _SLASH_TITLE.fullmatch(title):
        return match[1], match[2], True
    match = _TITLE.fullmatch(title)
    return (match[1], match[2], False) if match else ("", None, False)


def _unit_ends(title: str) -> Iterator[tuple[str, str]]:
    """Name and end of a title where the end may be a unit of measure without brackets; the longest end first.

    >>> list(_unit_ends("gyro output deg/s")), list(_unit_ends("陀螺输出°/h")), list(_unit_ends("X轴度/小时"))
    ([('gyro', 'output deg/s'), ('gyro output', 'deg/s')], [('陀螺输出', '°/h')], [('X轴', '度/小时')])
    """
    for edge in _UNIT_EDGE.finditer(title.strip()):
        name, end = edge.string[: edge.start()].strip(), edge.string[edge.end() :].strip()
        if name and end:
            yield name, end


def is_misread_unit(title: str, name: str, unit: str) -> bool:
    """Whether what stands behind the slash of a title is a unit of time, though the column is none."""
    is_slash = _SLASH_TITLE.fullmatch(title.translate(_FULL_WIDTH)) is not None
    return is_slash and is_time_unit(unit) and _OF_TIME.search(name.lower()) is None


def plain_letters(text: str) -> str:
    """Letters and digits of a text, in lower case."""
    return re.sub(r"[^a-z0-9]", "", text.lower())


@lru_cache(maxsize=4096)
def is_time_name(name: str) -> bool:
    """Whether a column is the time by its name."""
    return plain_letters(name) in _LOOKS_LIKE_TIME or name.strip() in _CHINESE_TIMES


def is_usable(name: str) -> bool:
    """Whether a signal may have the name."""
    try:
        check_name("signal", name)
    except BadInput:
        return False
    return True


def usable_name(name: str) -> str:
    """A name that a signal may have."""
    return re.sub(r"[^\w]+", "_", name).strip("_") or "signal"


def how_to_name(title: str, name: str, held: str = "") -> str:
    """What to do with a column without a usable title; `held` are the time stamps or durations in it."""
    if held:
        return f"column {title!r} holds {held}: give --rename '{title}=time', or leave it out: --rename '{title}='"
    if not name:
        return f"column {title!r} cannot be read; {SQUARE}"
    if _is_number(name):
        return f"column {title!r} is a number: the first line must be the header, like 'time[s],rate[deg/s]'"
    if is_time_name(name):
        return (
            f"column {title!r} has no unit; if it is the time, give it in seconds and name it 'time[s]', "
            f"or as ISO 8601 time stamps, like 2026-11-21T18:00:00.5Z"
        )
    near = difflib.get_close_matches(name.lower(), [*WORD_NAMES, "unit", "run"], n=1, cutoff=0.8)
    hint = f" (or did you mean {near[0]!r}?)" if near else ""
    return (
        f"column {title!r} has no unit; name it like '{name}[deg/s]', or '{name}[1]' if it has none{hint}; "
        f"without changing the file: --rename '{title.strip()}={plain_letters(name) or usable_name(name)}[1]'; "
        f"to leave it out: --rename '{title.strip()}='"
    )


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
