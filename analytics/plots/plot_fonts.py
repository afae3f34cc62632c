"""Fonts of plots: a Chinese one where it is installed, and never a character that no font can draw."""

from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findSystemFonts, fontManager, get_font
from matplotlib.text import Text

LATIN_FONT = "DejaVu Sans"
NOT_DRAWABLE = "\N{WHITE SQUARE}"

_CHINESE_FONTS = (
    "Noto Sans CJK SC", "Noto Sans SC", "Source Han Sans SC", "WenQuanYi Micro Hei", "WenQuanYi Zen Hei",
    "Droid Sans Fallback", "Microsoft YaHei", "SimHei", "PingFang SC",
)  # fmt: skip


@lru_cache(maxsize=1)
def chinese_font() -> str | None:
    """Name of an installed font with Chinese characters, None where there is none."""
    found = _first_installed()
    if found is None:
        # matplotlib keeps a list of fonts in its cache: what was installed later is not in it
        known = {entry.fname for entry in fontManager.ttflist}
        for path in findSystemFonts():
            if path not in known:
                with suppress(OSError, RuntimeError):  # a file that is no font that it can read
                    fontManager.addfont(path)
        found = _first_installed()
    return found


def _first_installed() -> str | None:
    installed = {entry.name for entry in fontManager.ttflist}
    return next((name for name in _CHINESE_FONTS if name in installed), None)


def chinese_font_file() -> tuple[str, Path] | None:
    """Name and file of the installed font with Chinese characters, None where there is none."""
    name = chinese_font()
    return None if name is None else (name, Path(fontManager.findfont(FontProperties(family=name))))


def set_fonts(figure: Figure) -> None:
    """Give all texts of a figure their fonts, and print them as they are: a ``$`` begins no formula.

    Texts with characters that the Latin font lacks fall back on the Chinese one, where there is one; a
    character that neither has becomes a square.
    """
    chinese = chinese_font()
    for text in figure.findobj(Text):
        text.set_parse_math(False)
        families: tuple[str, ...] = (LATIN_FONT,)
        if chinese is not None and NOT_DRAWABLE in drawable(text.get_text(), families):
            families = (LATIN_FONT, chinese)
            # most Chinese fonts come in one weight, and asking for another is logged as a failure
            text.set_fontweight("normal")
        text.set_fontfamily(list(families))
        text.set_text(drawable(text.get_text(), families))


def drawable(text: str, families: tuple[str, ...]) -> str:
    r"""Return `text` with a square for every character that none of the fonts can draw.

    >>> drawable("τ = 1 s\n\x07", (LATIN_FONT,))
    'τ = 1 s □'
    """
    known = frozenset[int]().union(*(_characters(family) for family in families))
    return "".join(c if ord(c) in known else NOT_DRAWABLE for c in text.replace("\n", " "))


@lru_cache(maxsize=8)
def _characters(family: str) -> frozenset[int]:
    path = fontManager.findfont(FontProperties(family=family), fallback_to_default=False)
    return frozenset(get_font(path).get_charmap())
