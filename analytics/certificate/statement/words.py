"""Texts of a certificate, in English and Chinese."""

from typing import Literal

import msgspec

Language = Literal["en", "zh", "both"]
LANGUAGES: tuple[Language, ...] = ("en", "zh", "both")


class Words(msgspec.Struct, frozen=True):
    """A text in both languages."""

    en: str
    zh: str

    @classmethod
    def of(cls, given: "str | Words") -> "Words":
        """A text as a file gives it: one for both languages, or a table with ``en`` and ``zh``.

        >>> Words.of("20 degC")
        Words(en='20 degC', zh='20 degC')
        """
        return given if isinstance(given, Words) else cls(given, given)

    def __bool__(self) -> bool:
        return bool(self.en.strip() and self.zh.strip())


def clause_in_chinese(clause: str) -> str:
    """A clause as a Chinese text names it.

    >>> clause_in_chinese("annex A"), clause_in_chinese("8 m")
    ('附录 A', '8 m')
    """
    return clause.replace("annex ", "附录 ")
