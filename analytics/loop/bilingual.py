"""Texts that carry their Chinese form."""

from collections.abc import Iterable


class Bilingual(str):
    """An English text with its Chinese form; msgspec encodes plain strings only: a document holds `str(text)`.

    >>> text = Bilingual("2 runs", "2次试验")
    >>> text, text.zh
    ('2 runs', '2次试验')
    """

    __slots__ = ("zh",)
    zh: str

    def __new__(cls, en: str, zh: str) -> "Bilingual":
        """A text in both languages."""
        text = super().__new__(cls, en)
        text.zh = zh
        return text

    def __getnewargs__(self) -> tuple[str, str]:  # type: ignore[override]
        return str(self), self.zh


def chinese(text: str) -> str:
    """The Chinese form of a text; of a text without one, the text itself."""
    return text.zh if isinstance(text, Bilingual) else text


def listed(texts: Iterable[str]) -> Bilingual:
    """Texts joined by commas."""
    every = list(texts)
    return Bilingual(", ".join(every), "、".join(map(chinese, every)))
