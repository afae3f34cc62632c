"""Sentences in two languages, and numbers rounded for people."""

import math
from collections.abc import Iterable
from typing import NamedTuple


class Words(NamedTuple):
    """A text in English and in Chinese."""

    en: str
    zh: str

    def in_language(self, language: str) -> str:
        """The text in the language `en` or `zh`."""
        return self.zh if language == "zh" else self.en


class NotComputed(NamedTuple):
    """A result that was not computed, and why."""

    why: Words


def not_computed(en: str, zh: str) -> NotComputed:
    """The reason in two languages."""
    return NotComputed(Words(en, zh))


def words(en: str, zh: str, **parts: object) -> Words:
    """Templates filled with parts; one that is `Words` goes in by its language.

    >>> words("{what} of {n}", "{n}个{what}", what=Words("unit", "样品"), n=3)
    Words(en='unit of 3', zh='3个样品')
    """
    texts = [
        text.format(**{name: each[at] if isinstance(each, Words) else each for name, each in parts.items()})
        for at, text in enumerate((en, zh))
    ]
    return Words(*texts)


def joined(texts: Iterable[Words], en: str = "; ", zh: str = "；") -> Words:
    """Texts joined by the separators of their languages."""
    pairs = list(texts)
    return Words(en.join(each.en for each in pairs), zh.join(each.zh for each in pairs))


NOTHING = Words("", "")


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
    name = "" if unit in {"", "1"} else f" {unit}"
    shown, least, most = (figures(each, half) for each in (value, lo, hi))
    return Words(f"{shown}{name} ({least} to {most})", f"{shown}{name}（{least} 至 {most}）")


def listed(names: list[str], most: int = 5) -> Words:
    """Names in a row; those beyond `most` are counted.

    >>> listed(["A", "B", "C"], 2)
    Words(en='A, B and 1 more', zh='A、B 等 3 个')
    """
    if len(names) <= most:
        return Words(", ".join(names), "、".join(names))
    shown = names[:most]
    return Words(f"{', '.join(shown)} and {len(names) - most} more", f"{'、'.join(shown)} 等 {len(names)} 个")
