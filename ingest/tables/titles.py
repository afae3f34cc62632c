"""Titles of columns: name and unit of measure, as other programs and Chinese ones write them too."""

import difflib
import re
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache

from ingest.tables.steps import WORD_NAMES
from ingest.tables.units import expected_unit, is_per_time, is_time_unit, is_unit, known_unit, time_unit
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
    r"[\s：:]+(?:in\s+)?|(?<=[\u4e00-\u9fff])(?=[^\u4e00-\u9fff\w\s：:/\[\]()]|[a-zA-Zµμ])|(?<=[\u4e00-\u9fff])(?<![角温速])(?=度[/每])"
)
_SYMBOLS = frozenset("tTUIPf")  # of quantities, and of units too
_OF_TIME = re.compile("时|间隔|周期|延迟|time|delay|latency|duration|interval|period")
_FULL_WIDTH = str.maketrans({chr(code + 0xFEE0): chr(code) for code in range(0x21, 0x7F)} | {"【": "[", "】": "]"})
_ROW_NUMBERS = frozenset({"序号", "行号", "点号", "采样序号", "样本序号", "no", "no.", "index"})
_REMARKS = frozenset({"备注", "说明", "remark", "remarks"})
_SERIALS = frozenset({
    "产品编号", "编号", "产品序号", "序列号", "陀螺编号", "器件编号",
    "serial", "serial number", "serial_number", "sn", "s/n",
})  # fmt: skip


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


def _by_slash(title: str) -> tuple[str, str] | None:
    """Name and unit of a title as physicists write them, unless it is a unit as a whole.

    >>> _by_slash("T/℃"), _by_slash("ω/°/s"), _by_slash("V/deg/s"), _by_slash("Date/Time")
    (('T', '℃'), ('ω', '°/s'), None, None)
    """
    name, _, unit = (part.strip() for part in title.partition("/"))
    if not unit or not is_unit(unit) or (name not in _SYMBOLS and is_unit(title)):
        return None
    return name, unit


def no_samples(name: str, cells: Callable[[], Sequence[str]]) -> str | None:
    """Why a column without a unit holds no samples, by its name and first cells: it numbers the rows, or has remarks.

    >>> no_samples("序号", lambda: ["1"]), no_samples("备注", lambda: ["", "好"]), no_samples("备注", lambda: ["1.5"])
    ('numbers the rows', 'holds remarks', None)
    """
    if name.lower() not in _ROW_NUMBERS | _REMARKS:
        return None
    written = [cell for cell in cells() if cell]
    if name.lower() in _ROW_NUMBERS and written and all(cell.isdecimal() for cell in written):
        return "numbers the rows"
    return "holds remarks" if name.lower() in _REMARKS and not any(map(_is_number, written)) else None


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
    if _by_slash(name) is not None:  # T/℃
        return False
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
    if name.lower() in _SERIALS:
        return (
            f"column {title!r} may say whose samples a row holds: give --rename '{title}=unit'; to leave it out: "
            f"--rename '{title}='"
        )
    found = next((each for each in _unit_ends(title) if is_unit(each[1])), None) or _by_slash(title)
    if found is not None:
        of_time = is_time_name(found[0]) and is_time_unit(found[1])
        unit = time_unit(found[1]) if of_time else known_unit(found[1])
        proposed = f"{'time' if of_time else usable_name(found[0])}[{unit}]"
        return (
            f"column {title!r} has its unit without brackets: give --rename '{title}={proposed}'; to leave it out: "
            f"--rename '{title}='"
        )
    near = difflib.get_close_matches(name.lower(), [*WORD_NAMES, "unit", "run"], n=1, cutoff=0.8)
    expected = expected_unit(name)
    hint = f" (or did you mean {near[0]!r}?)" if near else ""
    signal = f"{plain_letters(name) if name.isascii() else usable_name(name)}[{expected or 1}]"
    return (
        f"column {title!r} has no unit; name it like '{name}[{expected or 'deg/s'}]', or '{name}[1]' if it has none"
        f"{hint}; without changing the file: --rename '{title.strip()}={signal}'; "
        f"to leave it out: --rename '{title.strip()}='"
    )


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
