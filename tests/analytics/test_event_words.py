"""Names of documents and their words for people, in both languages."""

import typing
from enum import StrEnum
from typing import Any

import msgspec
import pytest

from analytics.event_words import kind_name, summary
from stream.events import AnyDocument, CommandOutcome, RunAction
from stream.events.store_events import SpecificationAction

KINDS = [each.__name__ for each in typing.get_args(AnyDocument)]


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_document_has_a_name_in_both_languages(kind: str) -> None:
    assert kind_name(kind, "en") != kind
    assert kind_name(kind, "zh") not in {kind, kind_name(kind, "en")}


@pytest.mark.parametrize(
    ("field", "words"), [("action", RunAction), ("action", SpecificationAction), ("outcome", CommandOutcome)]
)
def test_the_words_of_documents_are_in_chinese(field: str, words: type[StrEnum]) -> None:
    for word in words:
        assert summary({field: word.value}, "zh") != word.value
        assert summary({field: word.value}, "en") == word.value


def test_what_people_wrote_stays_and_what_the_program_wrote_is_translated() -> None:
    reason = "record of 300 s: the clauses ask for one hour as a rule"
    document: dict[str, Any] = {"kind": "VerdictGiven", "verdict": "FAIL", "reason": reason}
    assert summary(document, "zh") == "不合格，记录长 300 s：条款一般要求一小时"
    assert summary({"text": "refused: paused", "text_zh": "已拒绝：暂停中"}, "zh") == "已拒绝：暂停中"
    assert summary({"number": "GYL-2026-0001", "reason": "model corrected"}, "zh") == "GYL-2026-0001，model corrected"
    assert summary(msgspec.to_builtins({"words": {"step": "rate", "position": "X_up"}})) == "rate, X_up"
