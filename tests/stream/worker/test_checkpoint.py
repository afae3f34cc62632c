"""A worker's checkpoint: written whole, refused when damaged, gone on from to the last bit."""

import time
from functools import cache
from pathlib import Path
from uuid import UUID

import pytest

from stream.delivery.publisher import DurablePublisher
from stream.errors import CheckpointDamaged, EstimatorError
from stream.events import AnyDocument
from stream.transport.bus import LocalBus
from stream.wire.batches import encode_batch
from stream.worker.checkpoint import CHECKPOINT_VERSION, Checkpoint, generations, read_checkpoint, write_checkpoint
from stream.worker.worker import EstimationWorker
from tests.stream.worker_runs import KEY, STARTS, MemoryLog, batch, run, sorted_documents


@cache
def undisturbed() -> list[AnyDocument]:
    return run(None, [STARTS])[0]


def test_lives_that_end_anywhere_give_the_documents_of_one(tmp_path: Path) -> None:
    whole = undisturbed()
    assert len(whole) > 50
    broken, workers = run(tmp_path / "c", [STARTS[:30], STARTS[30:31], STARTS[31:100], STARTS[100:]])
    assert sorted_documents(broken) == sorted_documents(whole)
    assert any(worker.resumed for worker in workers)


def test_what_came_while_nobody_listened_is_read_in_the_log(tmp_path: Path) -> None:
    whole = undisturbed()
    deaf = frozenset(STARTS[20:25] + STARTS[119:])
    broken, workers = run(tmp_path / "c", [STARTS[:70], STARTS[70:]], deaf=deaf)
    assert sorted_documents(broken) == sorted_documents(whole)
    assert sum(worker.counts.lost for worker in workers) == 0
    assert sum(worker.counts.recalled for worker in workers) >= 5 * 500


def test_a_run_whose_first_samples_came_only_to_the_log_is_begun_at_its_beginning(tmp_path: Path) -> None:
    whole = undisturbed()
    found, (worker,) = run(tmp_path / "c", [STARTS], deaf=frozenset(STARTS[:3]))
    assert sorted_documents(found) == sorted_documents(whole)
    assert worker.counts.lost == 0
    assert worker.counts.recalled >= 3 * 500


def test_any_flipped_byte_cut_or_zeroed_block_of_a_checkpoint_is_seen(tmp_path: Path) -> None:
    path = tmp_path / "c"
    assert read_checkpoint(path) is None
    checkpoint = Checkpoint("s", [("k", "e", 3)], ["r0"], [], [])
    write_checkpoint(path, checkpoint)
    assert read_checkpoint(path) == checkpoint
    content = path.read_bytes()
    for at in range(len(content)):
        zeroed = content[:at] + bytes(min(16, len(content) - at)) + content[at + 16 :]
        for damaged in (content[:at] + bytes([content[at] ^ 0x10]) + content[at + 1 :], content[:at], zeroed):
            if damaged != content:
                path.write_bytes(damaged)
                with pytest.raises(CheckpointDamaged, match="is damaged"):
                    read_checkpoint(path)


def test_a_checkpoint_of_a_newer_gyrofleet_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "c"
    with monkeypatch.context() as newer:
        newer.setattr("stream.worker.checkpoint.CHECKPOINT_VERSION", CHECKPOINT_VERSION + 1)
        write_checkpoint(path, Checkpoint("memory", [], [], [], []))
    with pytest.raises(EstimatorError, match="use the one that wrote it"):
        run(path, [STARTS[:1]])
    assert [each.name for each in tmp_path.iterdir()] == ["c"]


@pytest.mark.parametrize("both", [False, True])
def test_of_a_damaged_checkpoint_the_one_before_or_the_log_gives_the_same_documents(tmp_path: Path, both: bool) -> None:
    whole = undisturbed()
    path = tmp_path / "c"

    def damage() -> None:
        for each in generations(path)[: 2 if both else 1]:
            content = bytearray(each.read_bytes())
            content[len(content) // 2] ^= 1
            each.write_bytes(content)

    found, workers = run(path, [STARTS[:50], STARTS[50:90], STARTS[90:]], between=damage)
    assert sorted_documents(found) == sorted_documents(whole)
    assert [worker.resumed for worker in workers] == [False, not both, not both]
    assert all("it is kept as" in worker.warnings[0] for worker in workers[1:])
    assert len(list(tmp_path.glob("c*.damaged-*"))) == 2 * (1 + both)


def test_a_write_that_is_cut_off_anywhere_leaves_a_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "c"
    for seq in (1, 2):
        write_checkpoint(path, Checkpoint("s", [("k", "e", seq)], [], [], []))
    renames = [0]
    replace = Path.replace

    def cut_off(self: Path, target: Path) -> Path:
        renames[0] -= 1
        if renames[0] < 0:
            raise OSError("cut off")
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", cut_off)
    for allowed in (0, 1):
        renames[0] = allowed
        with pytest.raises(EstimatorError, match="cut off"):
            write_checkpoint(path, Checkpoint("s", [("k", "e", 3)], [], [], []))
        found = [each for each in map(read_checkpoint, generations(path)) if each is not None]
        assert found[0].positions == [("k", "e", 2)]


def test_a_checkpoint_of_another_store_is_not_gone_on_from(tmp_path: Path) -> None:
    path = tmp_path / "c"
    write_checkpoint(path, Checkpoint("another", [(KEY, UUID(int=1).hex, 30_000)], [], [], []))
    found, (worker,) = run(path, [STARTS])
    assert not worker.resumed
    whole = undisturbed()
    assert sorted_documents(found) == sorted_documents(whole)


def test_a_folder_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(EstimatorError, match="cannot be written"):
        write_checkpoint(tmp_path / "file" / "c", Checkpoint("s", [], [], [], []))


def test_a_checkpoint_that_cannot_be_written_is_told_and_estimating_goes_on(tmp_path: Path) -> None:
    bus = LocalBus()
    log = MemoryLog(bus)
    path = tmp_path / "folder" / "c"
    with DurablePublisher(bus) as publisher:
        worker = EstimationWorker(bus, publisher, log=log, checkpoint=path, checkpoint_every_s=0.01)
        path.unlink()
        path.parent.rmdir()
        path.parent.write_text("no folder")
        deadline = time.monotonic() + 10
        for start in STARTS:
            bus.publish(KEY, encode_batch(batch(start)))
        while not worker.warnings and time.monotonic() < deadline:
            time.sleep(0.01)
        assert "cannot be written" in worker.warnings[0]
        assert worker.failure is None
        path.parent.unlink()
        worker.close()
        assert worker.counts.samples == 60_000
        assert path.exists()
