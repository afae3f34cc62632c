"""Documents of the log in English and Chinese: names of their kinds, and what each says in a few words."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from analytics.loop.bilingual import Bilingual

# what stands in a summary, in this order
_SUMMARY = (
    "action", "number", "procedure", "step", "specification", "name", "revision", "version", "stage", "product", "lot",
    "title", "slot", "limit", "metric", "item", "verdict", "outcome", "what", "alert", "target", "text", "note",
    "reason",
)  # fmt: skip
_ENDED = {"RunEnded", "StepEnded"}
_FREE = {"text", "reason"}
_Pairs = Mapping[str, tuple[str, str]]


@cache
def _content() -> dict[str, Any]:
    return tomllib.loads(files("analytics").joinpath("event_words.toml").read_text(encoding="utf-8"))


def kind_name(kind: str, language: str) -> str:
    """The name of a kind of document; itself where it has none.

    >>> kind_name("CertificateIssued", "zh"), kind_name("CertificateIssued", "en")
    ('签发证书', 'Certificate issued')
    """
    return _of(_content()["kinds"], kind, language)


def notes_of_store() -> list[str]:
    """The words of `StoreNoted.what`."""
    return list(_content()["words"]["what"])


def is_known_kind(kind: str) -> bool:
    """Whether there are documents of this kind."""
    return kind in _content()["kinds"]


def store_note(what: str, text: str) -> Bilingual:
    """What a store notes of itself, its word first; in Chinese as far as `reasons.toml` has the text.

    >>> store_note("arrival_clock_step", "the recorder's clock, which gives arrival times, was set by +3.000 s").zh
    '记录时钟被调整：记录程序的时钟（到达时间由其给出）被调整 +3.000 s'
    """
    from analytics.evaluation.reasons import in_chinese

    return Bilingual(f"{what}: {text}", f"{_of(_content()['words']['what'], what, 'zh')}：{in_chinese(text)}")


def summary(document: Mapping[str, Any], language: str = "en") -> str:
    """What a document says in a few words: its texts, outcomes and reasons.

    Names, and what people wrote, stay as they are. The log leaves out an outcome that is the usual one.

    >>> summary({"kind": "RunEnded", "outcome": "completed", "streams": [1]})
    'completed'
    >>> summary({"kind": "StepEnded"}, "zh")
    '完成'
    >>> summary({"specification": "FOG", "revision": "A", "action": "added", "reason": "first"}, "zh")
    '新增，FOG，A，first'
    """
    if document.get("kind") in _ENDED:
        document = {"outcome": "completed", **document}
    parts = [
        _word(name, document, language)
        for name in _SUMMARY
        if isinstance(document.get(name), str | int | float)
        and document[name] != ""
        and not (name == "specification" and document.get("kind") == "CertificateIssued")  # a hash
    ]
    # a step's words are a table of their own
    words = document.get("words") or {}
    parts += [str(words[name]) for name in ("step", "position") if words.get(name)]
    return ("，" if language == "zh" else ", ").join(parts)


def _word(name: str, document: Mapping[str, Any], language: str) -> str:
    value = document[name]
    if language == "zh" and name in _FREE:
        from analytics.evaluation.reasons import in_chinese

        return str(document.get(f"{name}_zh") or in_chinese(str(value)))
    return _of(_content()["words"].get(name, {}), str(value), language)


def _of(pairs: _Pairs, key: str, language: str) -> str:
    pair = pairs.get(key)
    return key if pair is None else pair[language == "zh"]
