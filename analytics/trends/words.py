"""Sentences in two languages, and numbers as people read them."""

import math
from typing import NamedTuple


class Words(NamedTuple):
    """The same said in English and in Chinese."""

    en: str
    zh: str

    def said(self, language: str) -> str:
        """In the language `en` or `zh`."""
        return self.zh if language == "zh" else self.en


class Refused(NamedTuple):
    """Something that was not computed, and why."""

    why: Words


def figures(value: float, half_width: float) -> str:
    """A value to two figures of half its interval.

    Examples
    --------
    >>> figures(0.049531, 0.0084), figures(123.4, 31.0), figures(1.0, 0.0)
    ('0.0495', '123', '1')
    """
    if not math.isfinite(half_width) or half_width <= 0:
        return f"{value:.4g}"
    decimals = 1 - math.floor(math.log10(half_width))
    if decimals > 12 or decimals < -12:
        return f"{value:.4g}"
    return f"{round(value, decimals):.{max(decimals, 0)}f}"


def interval(value: float, lo: float, hi: float, unit: str) -> Words:
    """A value with its limits and unit.

    Examples
    --------
    >>> interval(0.049531, 0.0412, 0.0578, "deg/h")
    Words(en='0.0495 deg/h (0.0412 to 0.0578)', zh='0.0495 deg/h（0.0412 至 0.0578）')
    """
    half = (hi - lo) / 2
    name = "" if unit in {"", "1"} else f" {unit}"
    shown, least, most = (figures(each, half) for each in (value, lo, hi))
    return Words(f"{shown}{name} ({least} to {most})", f"{shown}{name}（{least} 至 {most}）")


def listed(names: list[str], most: int = 5) -> Words:
    """Names in a row; those beyond `most` are counted.

    Examples
    --------
    >>> listed(["A", "B", "C"], 2)
    Words(en='A, B and 1 more', zh='A、B 等 3 个')
    """
    if len(names) <= most:
        return Words(", ".join(names), "、".join(names))
    shown = names[:most]
    return Words(f"{', '.join(shown)} and {len(names) - most} more", f"{'、'.join(shown)} 等 {len(names)} 个")
