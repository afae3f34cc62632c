"""The folder of a run's commands: what another user puts there is not taken, and only one side gets a command."""

import os
import stat
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from storage.recording.command_box import (
    GIVEN,
    TAKEN,
    WITHDRAWN,
    BadCommand,
    CommandAnswer,
    CommandBox,
    CommandFolder,
    RunCommand,
)
from storage.recording.run_command import give_command, is_at_work
from storage.recording.status_board import StatusBoard
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import StoreError
from stream.events import CommandOutcome, RunAction
from stream.status.role_status import Role, RoleState, RunProgress, new_status

COMMAND = RunCommand(id="c1", run="r", action=RunAction.PAUSE, by="Li", reason="door", given_ns=1, expires_ns=2**62)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[CommandFolder]:
    with CommandFolder(tmp_path, "r") as found:
        yield found


def test_only_its_owner_can_read_and_write_it(tmp_path: Path, folder: CommandFolder) -> None:
    folder.write("c1", GIVEN, COMMAND)
    for path, mode in ((tmp_path / "control", 0o700), (folder.path, 0o700), (folder.path / "c1.given", 0o600)):
        assert stat.S_IMODE(path.stat().st_mode) == mode
    folder.path.chmod(0o755)
    with pytest.raises(StoreError, match=r"open to others \(mode 0755\)"):
        CommandBox(tmp_path, "r")


def test_a_command_is_taken_once(tmp_path: Path, folder: CommandFolder) -> None:
    folder.write("c1", GIVEN, COMMAND)
    with CommandBox(tmp_path, "r") as box:
        assert list(box.take()) == [COMMAND]
        assert list(box.take()) == []
        assert not folder.move("c1", GIVEN, WITHDRAWN), "it was taken"
        assert list(box.taken()) == [COMMAND]
        box.answer("c1", CommandAnswer(outcome=CommandOutcome.DONE, text="paused"))
        assert list(box.taken()) == []
    folder.write("c2", GIVEN, msgspec.structs.replace(COMMAND, id="c2"))
    assert folder.move("c2", GIVEN, WITHDRAWN)
    with CommandBox(tmp_path, "r") as box:
        assert list(box.take()) == [], "it was withdrawn"


def forged(folder: CommandFolder, how: str) -> None:
    path, content = folder.path / "c1.given", msgspec.json.encode(COMMAND)
    match how:
        case "open":
            path.write_bytes(content)
            path.chmod(0o666)
        case "owner":
            path.write_bytes(content)
            path.chmod(0o600)
            os.chown(path, 65534, 65534)
        case "link":
            (folder.path / "elsewhere").write_bytes(content)
            path.symlink_to("elsewhere")
        case "pipe":
            os.mkfifo(path, 0o600)
        case "folder":
            path.mkdir(mode=0o700)
            path.rmdir()
            path.symlink_to(folder.path.parent)
        case "other run":
            folder.write("c1", GIVEN, msgspec.structs.replace(COMMAND, run="another"))
        case "other id":
            folder.write("c1", GIVEN, msgspec.structs.replace(COMMAND, id="c9"))
        case "long":
            folder.write("c1", GIVEN, msgspec.structs.replace(COMMAND, reason="x" * 70_000))
        case "garbage":
            path.write_bytes(b"\xff\x00{")
            path.chmod(0o600)


@pytest.mark.parametrize(
    "how",
    [
        "open",
        pytest.param("owner", marks=pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")),
        "link",
        "pipe",
        "folder",
        "other run",
        "other id",
        "long",
        "garbage",
    ],
)
def test_a_forged_command_is_never_taken(tmp_path: Path, folder: CommandFolder, how: str) -> None:
    forged(folder, how)
    with CommandBox(tmp_path, "r") as box:
        (found,) = box.take()
        assert isinstance(found, BadCommand)
        assert found.why
        assert list(box.take()) == []
        assert list(box.taken()) == []


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives folders away")
def test_a_folder_of_another_user_is_not_used(tmp_path: Path, folder: CommandFolder) -> None:
    os.chown(folder.path, 65534, 65534)
    with pytest.raises(StoreError, match="belongs to user 65534"):
        CommandBox(tmp_path, "r")


def test_one_process_takes_the_commands_of_a_run(tmp_path: Path) -> None:
    with CommandBox(tmp_path, "r"):
        assert is_at_work(tmp_path, "r")
        assert not is_at_work(tmp_path, "another")
        with pytest.raises(StoreError, match="taken by another process"):
            CommandBox(tmp_path, "r")
    assert not is_at_work(tmp_path, "r")


def test_what_nobody_takes_is_withdrawn_told_and_logged(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "S")
    with CommandBox(store.folder, "r") as box:
        began_s = time.monotonic()
        given = give_command(store, "r", RunAction.ABORT, by="Li", reason="smoke", patience_s=0.3)
        assert 0.3 <= time.monotonic() - began_s < 5.0
        assert given.answer.outcome is CommandOutcome.UNANSWERED
        assert "withdrawn" in given.answer.text
        assert given.is_logged
        assert list(box.take()) == list(box.withdrawn()) == []
    given = give_command(store, "r", RunAction.PAUSE, by="Li", reason="door")
    assert given.answer.outcome is CommandOutcome.REFUSED
    with Catalog(store) as catalog:
        sql = "select kind, document->>'$.reason', document->>'$.outcome' from events order by t_ns, kind desc"
        assert catalog.rows(sql) == [
            ("RunCommandGiven", "smoke", None), ("RunCommandAnswered", None, "unanswered"),
            ("RunCommandGiven", "door", None), ("RunCommandAnswered", None, "refused"),
        ]  # fmt: skip
    with CommandFolder(store.folder, "r") as folder:
        assert folder.names(GIVEN) == folder.names(TAKEN) == folder.names(WITHDRAWN) == []


@pytest.mark.parametrize(
    ("state", "expected"),
    [(RoleState.WORKING, "takes no commands"), (RoleState.PAUSED, "takes no commands"), (RoleState.ENDED, "killed")],
)
def test_a_run_at_work_that_takes_no_commands_is_not_called_left(
    tmp_path: Path, state: RoleState, expected: str
) -> None:
    store = Store.create(tmp_path / "S")
    StatusBoard(store).put(new_status(Role.RUN, 1, name="bench", state=state, run=RunProgress(run="r")))
    answer = give_command(store, "r", RunAction.PAUSE, by="Li", reason="door").answer
    assert answer.outcome is CommandOutcome.REFUSED
    assert expected in answer.text
    assert answer.text_zh
