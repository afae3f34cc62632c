"""The language of a page: asked for, remembered in a cookie, or that of the browser; and its texts."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Literal

from markupsafe import Markup, escape
from starlette.requests import Request

from analytics.event_words import kind_name

Language = Literal["en", "zh"]
LANGUAGES: tuple[Language, ...] = ("en", "zh")
COOKIE = "gyrofleet_lang"


def language_of(request: Request) -> Language:
    """The language of a request: ``?lang=``, the cookie, Accept-Language, English."""
    asked = [request.query_params.get("lang", ""), request.cookies.get(COOKIE, "")]
    for text in [*asked, *_accepted(request.headers.get("accept-language", ""))]:
        for language in LANGUAGES:
            if text.lower() == language or text.lower().startswith(f"{language}-"):
                return language
    return "en"


def _accepted(header: str) -> list[str]:
    """Languages in the order of their weights.

    >>> _accepted("fr, en;q=0.5, zh-CN;q=0.9")
    ['fr', 'zh-CN', 'en']
    """
    weighted = []
    for each in header.split(",")[:20]:
        name, _, weight = each.partition(";q=")
        try:
            weighted.append((-float(weight or 1.0), name.strip()))
        except ValueError:
            continue
    return [name for _, name in sorted(weighted, key=lambda each: each[0])]


@cache
def _texts() -> Mapping[str, tuple[str, str]]:
    content = tomllib.loads(files("analytics.serve.pages").joinpath("texts.toml").read_text(encoding="utf-8"))
    return {key: (pair[0], pair[1]) for key, pair in content.items()}


class Texts:
    """The texts of the pages in one language, from ``texts.toml``."""

    def __init__(self, language: Language) -> None:
        self.language = language
        self._at = LANGUAGES.index(language)

    def __call__(self, key: str, /, **parts: object) -> str:
        """A text, filled with its parts.

        >>> Texts("zh")("runs"), Texts("en")("more_rows", n=3)
        ('试验', '3 more')
        """
        text = _texts()[key][self._at]
        if any(isinstance(each, Markup) for each in parts.values()):  # the others are text
            return escape(text).format(**parts)
        return text.format(**parts) if parts else text

    def either(self, en: str, zh: str) -> str:
        """The one of two texts that is in this language."""
        return (en, zh)[self._at]

    def reason(self, reason: str) -> str:
        """Why there is no value, or no verdict, in this language where it is known in it."""
        if self.language == "en":
            return reason
        from analytics.evaluation.reasons import in_chinese

        return in_chinese(reason)

    def word(self, word: str | None, kind: str) -> str:
        """A word of the data, such as a verdict, where it has a translation; else the word itself.

        >>> Texts("zh").word("PASS", "verdict"), Texts("zh").word("new", "verdict")
        ('合格', 'new')
        """
        if not word:
            return ""
        if kind == "kind":
            return kind_name(word, self.language)
        pair = _texts().get(f"{kind}_{word}")
        return word if pair is None else pair[self._at]
