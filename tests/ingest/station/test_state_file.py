"""State files: there whole or not at all, and what cannot be read or written is reported."""

from pathlib import Path

import msgspec
import pytest

from ingest.run_record import RunRecord, read_state, write_state
from stream.delivery.spool import Spool
from stream.errors import StoreError
from stream.identity import Place


class Progress(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    step: int


def test_a_state_takes_the_place_of_the_one_before(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    assert read_state(path, Progress) is None
    for step in (1, 2):
        written = write_state(path, Progress(step))
        assert read_state(path, Progress) == written == Progress(step)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("content", [b"", b'{"step": 1', b'{"step": "one"}', b'{"step": 1, "more": 2}'])
def test_a_file_that_holds_no_state_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "run.json"
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"run\.json cannot be read: .*give another --run"):
        read_state(path, Progress)


def test_where_nothing_can_be_written_the_state_before_is_still_there(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    write_state(path, Progress(1))
    (tmp_path / "run.json.part").mkdir()
    with pytest.raises(StoreError, match="cannot be written"):
        write_state(path, Progress(2))
    assert read_state(path, Progress) == Progress(1)


def test_a_run_goes_on_where_its_state_cannot_be_written_and_reports_it(tmp_path: Path) -> None:
    """As while a disk is full: the state is written with the next change that finds room."""
    path, blocked = tmp_path / "run.json", tmp_path / "run.json.part"

    class Counted(RunRecord[Progress]):
        def go_to(self, step: int) -> None:
            self._save(step=step)

    with Spool(tmp_path / "spool") as spool:
        record = Counted(Progress(0), path, spool, Place("plant", "bench"))
        blocked.mkdir()
        with pytest.raises(StoreError, match="cannot be written"):
            record.go_to(1)  # nothing could be resumed
        blocked.rmdir()
        record.go_to(2)
        blocked.mkdir()
        record.go_to(3)
        assert record.state == Progress(3)
        assert read_state(path, Progress) == Progress(2)
        reasons = [record.unsaved]
        blocked.rmdir()
        record.go_to(4)
        reasons.append(record.unsaved)
        assert "the run goes on, and after a crash would resume from what was written last" in str(reasons[0])
        assert reasons[1] is None
        assert read_state(path, Progress) == Progress(4)
