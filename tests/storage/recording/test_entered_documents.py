"""Documents that are entered into a store while its disk is full."""

import time
from pathlib import Path

import msgspec
import pytest

from storage.log.tail import documents_beyond
from storage.recording.client import record_documents
from storage.recording.disk_watch import DiskWatch
from storage.store import Store
from stream.errors import StoreError
from stream.events import NoteAdded

NOTE = NoteAdded(run="r1", t_ns=0, text="door opened")


def test_a_full_disk_refuses_a_document_at_once_and_has_none_of_it_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store.create(tmp_path / "S")
    with monkeypatch.context() as full:
        full.setattr(DiskWatch, "look", lambda *_, **__: ("0 B free", None))
        began = time.monotonic()
        with pytest.raises(StoreError, match="0 B free"):
            record_documents(store, [NOTE], role="a test")
        assert time.monotonic() - began < 10.0
    again = msgspec.structs.replace(NOTE, text="door closed")
    record_documents(store, [again], role="a test")
    texts = [document.text for document, _ in documents_beyond(store, set()) if isinstance(document, NoteAdded)]
    assert texts == ["door closed"]
