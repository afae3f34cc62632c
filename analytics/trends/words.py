"""Sentences in two languages, and numbers rounded for people."""

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import NamedTuple

from analytics.specifications.verdicts import UNGIVEN, UNGIVEN_ZH


class Words(NamedTuple):
    """A text in English and in Chinese."""

    en: str
    zh: str


class NotComputed(NamedTuple):
    """A result that was not computed, and why."""

    why: Words


NOTHING = Words("", "")
_COMMAS = Words(", ", "、")
_GROUPS_ZH = {"station": "试验台", "fixture": "夹具", "lot": "批次", "unit": "产品", "product": "产品型号"}


@cache
def _templates() -> Mapping[str, Sequence[str]]:
    return tomllib.loads(files("analytics.trends").joinpath("sentences.toml").read_text(encoding="utf-8"))


def words(key: str, /, **parts: object) -> Words:
    """A sentence of ``sentences.toml`` filled with parts; one that is `Words` goes in by its language.

    >>> words("drift", size="3 deg/h", per=words("per_day"))
    Words(en='it drifts by 3 deg/h per day.', zh='存在漂移，每天 3 deg/h。')
    """
    texts = [
        text.format(**{name: each[at] if isinstance(each, Words) else each for name, each in parts.items()})
        for at, text in enumerate(_templates()[key])
    ]
    return Words(*texts)


def kind_of(standard: str, settings: Iterable[tuple[str, str]]) -> Words:
    """The standard and the settings of values, these by the names that ``--parameter`` takes."""
    texts = [f"{name}={value}" for name, value in settings]
    named = [words(each) if each in _templates() else Words(each, each) for each in texts]
    return joined([words("standard", standard=standard), *named], ", ", "，")


def not_computed(key: str, /, **parts: object) -> NotComputed:
    """A sentence as the reason."""
    return NotComputed(words(key, **parts))


def group_name(group: str) -> Words:
    """The name of a group of units, such as ``station``."""
    return Words(group, _GROUPS_ZH.get(group, group))


def joined(texts: Iterable[Words], en: str = "; ", zh: str = "；") -> Words:
    """Texts joined by the separators of their languages."""
    pairs = list(texts)
    return Words(en.join(each.en for each in pairs), zh.join(each.zh for each in pairs))


def figures(value: float, half_width: float) -> str:
    """A value rounded to two digits of half its interval.

    >>> figures(0.049531, 0.0084), figures(123.4, 31.0), figures(1.0, 0.0)
    ('0.0495', '123', '1')
    """
    if not 1e-11 <= half_width < 1e14:
        return f"{value:.4g}"
    decimals = 1 - math.floor(math.log10(half_width))
    return f"{round(value, decimals):.{max(decimals, 0)}f}"


def interval(value: float, lo: float, hi: float, unit: str) -> Words:
    """A value with its bounds and unit.

    >>> interval(0.049531, 0.0412, 0.0578, "deg/h")
    Words(en='0.0495 deg/h (0.0412 to 0.0578)', zh='0.0495 deg/h（0.0412 至 0.0578）')
    """
    half = (hi - lo) / 2
    shown, least, most = (figures(each, half) for each in (value, lo, hi))
    name = behind(unit)
    return Words(f"{shown}{name} ({least} to {most})", f"{shown}{name}（{least} 至 {most}）")


def behind(unit: str) -> str:
    """A unit as it stands behind a number: nothing for a plain number.

    >>> behind("deg/h"), behind("1")
    (' deg/h', '')
    """
    return "" if unit in {"", "1"} else f" {unit}"


def listed(names: list[str], most: int = 5, apart: Words = _COMMAS) -> Words:
    """Names in a row; those beyond `most` are counted.

    >>> listed(["A", "B", "C"], 2)
    Words(en='A, B and 1 more', zh='A、B 等 3 个')
    """
    shown = names[:most]
    in_chinese = apart.zh.join(UNGIVEN_ZH if name == UNGIVEN else name for name in shown)
    if len(names) <= most:
        return Words(apart.en.join(names), in_chinese)
    return Words(f"{apart.en.join(shown)} and {len(names) - most} more", f"{in_chinese} 等 {len(names)} 个")
