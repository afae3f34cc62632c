"""Names of documents and their words for people, in both languages."""

import errno
import os
import re
import typing
from enum import StrEnum
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from analytics.event_words import kind_name, store_note, summary
from storage.check.recover import recover
from storage.lake.builder import build_missing
from storage.log.event_log import EventLog
from storage.recording.disk_watch import DiskWatch
from storage.recording.intake import ClockStep, NumberConflict
from storage.recording.reports import Reports
from storage.sql.catalog import Catalog
from stream.events import AnyDocument, CommandOutcome, RunAction
from stream.events.store_events import SpecificationAction
from tests.storage.verified_store import filled

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


def test_notes_of_a_store_are_in_chinese(tmp_path: Path) -> None:
    """Of a segment that is damaged, one that is gone, and clocks, numbers and a disk as the recorder notes them."""
    store = filled(tmp_path / "S", range(2), range(2, 4), range(4, 6))
    path = store.log / "00000002.mcap"
    content = bytearray(path.read_bytes())
    content[len(content) // 2 :] = bytes(len(content) - len(content) // 2)
    path.write_bytes(content)
    (store.log / "00000001.mcap").unlink()
    list(recover(store))
    log = EventLog(store)
    intake: Any = SimpleNamespace(
        clock_steps=[ClockStep("gyro/v1/a/b/U1/rate", "r1", 5, 10**9)],
        conflicts=[NumberConflict("gyro/v1/a/b/U1/rate", "e", 3, 9)] * 2,
    )  # fmt: skip
    reports = Reports(store, log, intake, lambda _: None)
    reports.clock_steps()
    reports.conflicts(0.0)
    disk: Any = SimpleNamespace(space=lambda _: SimpleNamespace(free=10**9, total=10**11))
    _, warning = DiskWatch(store.folder, disk).look(10.0)
    disk.space = lambda _: SimpleNamespace(free=10**7, total=10**11)
    full, _ = DiskWatch(store.folder, disk).look(10.0)
    reports.append("disk_low", str(warning), {})
    reports.append("recording_paused", f"recording resumes after a pause of 3.0 s: {full}", {})
    log.seal()
    list(build_missing(store))
    with Catalog(store) as catalog:
        rows = catalog.rows("select document->>'$.what', document->>'$.text' from events where kind = 'StoreNoted'")
    assert {what for what, _ in rows} >= {"segment_missing", "segment_salvaged", "numbers_missing", "number_conflict"}
    for what, text in rows:
        chinese = store_note(what, text).zh
        assert not re.search(r"[a-z]+ [a-z]+ [a-z]+", chinese), chinese


def test_what_people_wrote_stays_and_what_the_program_wrote_is_translated() -> None:
    reason = "record of 300 s: the clauses ask for one hour as a rule"
    document: dict[str, Any] = {"kind": "VerdictGiven", "verdict": "FAIL", "reason": reason}
    assert summary(document, "zh") == "不合格，记录长 300 s：条款一般要求一小时"
    assert summary({"text": "refused: paused", "text_zh": "已拒绝：暂停中"}, "zh") == "已拒绝：暂停中"
    assert summary({"number": "GYL-2026-0001", "reason": "model corrected"}, "zh") == "GYL-2026-0001，model corrected"
    assert summary(msgspec.to_builtins({"words": {"step": "rate", "position": "X_up"}})) == "rate, X_up"


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EACCES, errno.ENOENT, errno.EIO, errno.EROFS, errno.EADDRINUSE])
def test_errors_of_the_system_are_in_chinese_wherever_they_stand(code: int) -> None:
    """ "No space left on device" stood in English within Chinese notes."""
    text, full = os.strerror(code), str(OSError(code, os.strerror(code), "/data/log/1.mcap"))
    (own,) = {summary({"reason": text}, "zh")}
    assert re.search("[a-z]", own) is None
    assert summary({"reason": full}, "zh") == f"{own}：'/data/log/1.mcap'"
    assert summary({"reason": full}) == full
    note = store_note("recording_paused", f"recording resumes after a pause of 3.0 s: {text}").zh
    assert note.endswith(own)
    assert text not in note


def test_a_sentence_that_only_contains_such_a_text_stays() -> None:
    text = "No space left on device was what we read, see the note"
    assert summary({"reason": text}, "zh") == text
