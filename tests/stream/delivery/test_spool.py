"""The spool keeps what it was given until it is acknowledged, whatever happens to the process and to its files."""

import errno
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stream.delivery import spool as spool_module
from stream.delivery.spool import Spool, SpooledMessage, SpoolError, SpoolFull, held_messages
from stream.delivery.spool_frames import encode_frame, parse_frames
from stream.wire.acknowledgement import StreamId
from tests.stream.examples import examples

A, B = StreamId("gyrofleet/p/b/A/rate", "a" * 32), StreamId("gyrofleet/p/b/B/rate", "b" * 32)
QUIET_S = 3600.0  # no background step comes in between


def payload(stream: StreamId, seq: int, size: int = 40) -> bytes:
    return f"{stream.epoch[0]}{seq} ".encode() * size


def everything(spool: Spool) -> list[SpooledMessage]:
    found = []
    while spool.waiting:
        found += spool.read(1000)
    return found


Step = tuple[str, int, int]
steps = st.lists(
    st.one_of(
        st.tuples(st.just("append"), st.integers(0, 1), st.integers(1, 200)),
        st.tuples(st.just("acknowledge"), st.integers(0, 1), st.integers(0, 10)),
        st.tuples(st.just("sync"), st.just(0), st.just(0)),
        st.tuples(st.just("read"), st.just(0), st.integers(1, 5000)),
        st.tuples(st.just("reopen"), st.just(0), st.just(0)),
        st.tuples(st.just("kill"), st.integers(0, 100), st.just(0)),
    ),
    max_size=60,
)


@examples(30, 150, steps)
def test_whatever_comes_every_message_stays_until_it_is_acknowledged(taken: list[Step]) -> None:
    streams = (A, B)
    appended: dict[StreamId, list[bytes]] = {A: [], B: []}
    acknowledged = {A: 0, B: 0}
    with TemporaryDirectory() as name:
        folder = Path(name)

        def opened() -> Spool:
            return Spool(folder, max_bytes=1 << 20, file_bytes=2000, sync_interval_s=QUIET_S)

        spool = opened()
        for what, i, n in taken:
            stream = streams[i % 2]
            if what == "append":
                seq = len(appended[stream])
                spool.append(stream, seq, seq + 1, payload(stream, seq, n))
                appended[stream].append(payload(stream, seq, n))
            elif what == "acknowledge":
                acknowledged[stream] = min(acknowledged[stream] + n, len(appended[stream]))
                spool.acknowledge("store", stream, acknowledged[stream])
            elif what == "sync":
                spool._sync()
            elif what == "read":
                for message in spool.read(n):
                    assert message.payload == appended[message.stream][message.seq]
            elif what == "reopen":
                spool.close()
                spool = opened()
            else:
                killed(spool)
                newest = max(folder.glob("*.spool"))
                with newest.open("ab") as file:  # a message that was being written
                    file.write(encode_frame(2, 10**9, 10**9 + 1, b"x" * 200)[:i])
                spool = opened()
                assert spool.damages == []
        spool.close()
        with opened() as spool:
            assert spool.damages == []
            assert {s: spool.position(s) for s in streams} == {s: len(appended[s]) for s in streams}
            found = everything(spool)
        for stream in streams:
            mine = [message for message in found if message.stream == stream]
            missing = range(acknowledged[stream], len(appended[stream]))
            assert [message.seq for message in mine if message.seq >= acknowledged[stream]] == list(missing)
            assert all(message.payload == appended[stream][message.seq] for message in mine)


def killed(spool: Spool) -> None:
    """Leave the files as a process leaves them that is killed."""
    spool._stopped.set()
    spool._syncer.join()
    for descriptor in [*spool._unsynced, spool._out]:
        os.close(descriptor)
    spool._lock_file.close()


def filled(folder: Path, messages: int = 50) -> list[bytes]:
    with Spool(folder, file_bytes=4000) as spool:
        for seq in range(messages):
            spool.append(A, seq, seq + 1, payload(A, seq))
    return [payload(A, seq) for seq in range(messages)]


@pytest.mark.long
@pytest.mark.parametrize("seed", range(60))
def test_damage_is_told_and_costs_what_it_hit(tmp_path: Path, seed: int) -> None:
    sent = filled(tmp_path)
    rng = random.Random(seed)
    path = rng.choice(sorted(tmp_path.glob("*.spool"))[:-1])  # the last is that of the end, without messages
    content = bytearray(path.read_bytes())
    at = rng.randrange(len(content))
    kind = ("flip", "zero", "cut")[seed % 3]
    if kind == "flip":
        content[at] ^= 1 << rng.randrange(8)
    elif kind == "zero":
        content[at : at + 100] = bytes(len(content[at : at + 100]))
    else:
        del content[at:]
    if content == path.read_bytes():
        return
    path.write_bytes(content)
    with Spool(tmp_path) as spool:
        reported = bool(spool.damages)
        found = everything(spool)
    assert reported
    seqs = [message.seq for message in found]
    assert seqs == sorted(set(seqs))
    assert all(message.payload == sent[message.seq] for message in found)
    lost = set(range(50)) - set(seqs)
    if kind != "cut":
        assert len(lost) <= 3
    assert lost == set() or max(lost) - min(lost) == len(lost) - 1


APPEND = """
import sys
from pathlib import Path
from stream.wire.acknowledgement import StreamId
from stream.delivery.spool import Spool
stream = StreamId("gyrofleet/p/b/A/rate", "a" * 32)
spool = Spool(Path(sys.argv[1]), file_bytes=100_000)
seq = spool.position(stream)
while True:
    spool.append(stream, seq, seq + 1, str(seq).encode() * 50)
    seq += 1
    sys.stdout.write(f"{seq}\\n")
    sys.stdout.flush()
    if seq % 7 == 0:
        spool.acknowledge("store", stream, max(0, seq - 500))
"""


@pytest.mark.parametrize("kills", [1, pytest.param(4, marks=pytest.mark.long)])
def test_a_process_that_is_killed_leaves_everything_that_append_returned_for(tmp_path: Path, kills: int) -> None:
    rng = random.Random(8)
    for _ in range(kills):
        process = subprocess.Popen(
            [sys.executable, "-c", APPEND, str(tmp_path)], stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(rng.uniform(0.05, 0.5))
        process.send_signal(signal.SIGKILL)
        out, _ = process.communicate()
        last = int(out.split("\n")[-2])
        with Spool(tmp_path) as spool:
            assert spool.damages == []
            assert spool.position(StreamId(A.key, "a" * 32)) >= last
            seqs = [message.seq for message in everything(spool)]
        assert seqs == list(range(seqs[0], seqs[-1] + 1))
        assert seqs[-1] >= last - 1
        assert seqs[0] <= max(0, last - 500)


def test_files_go_when_they_are_acknowledged_and_what_is_read_again_is_little(tmp_path: Path) -> None:
    with Spool(tmp_path, file_bytes=4000, sync_interval_s=0.01) as spool:
        for seq in range(200):
            spool.append(A, seq, seq + 1, payload(A, seq), taken=True)
        assert len(list(tmp_path.glob("*.spool"))) > 5
        spool.acknowledge("store", A, 190)
        deadline = time.monotonic() + 10
        while len(list(tmp_path.glob("*.spool"))) > 3 and time.monotonic() < deadline:
            time.sleep(0.01)
        assert len(list(tmp_path.glob("*.spool"))) <= 3
    with Spool(tmp_path) as spool:
        assert [message.seq for message in everything(spool)] == list(range(190, 200))
        assert spool.store == "store"
        assert held_messages(tmp_path) == 10
        spool.acknowledge("store", A, 200)
    assert sum(path.stat().st_size for path in tmp_path.glob("*.spool")) < 1000
    with Spool(tmp_path) as spool:
        assert (spool.waiting, spool.position(A), spool.unacknowledged) == (0, 200, False)


def test_a_full_spool_says_so_and_takes_again_when_there_is_room(tmp_path: Path) -> None:
    with Spool(tmp_path, max_bytes=20_000) as spool:
        with pytest.raises(SpoolFull, match=r"is full.*gyrofleet record"):
            for seq in range(1000):
                spool.append(A, seq, seq + 1, payload(A, seq))
        kept = spool.position(A)
        assert sum(path.stat().st_size for path in tmp_path.glob("*.spool")) <= 20_000
        spool.acknowledge("store", A, kept)
        spool.append(A, kept, kept + 1, b"again")
        assert spool.position(A) == kept + 1


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> list[OSError | int]:
    """What the next writes do: raise, or write so many bytes; afterwards they write."""
    plan: list[OSError | int] = []
    write = os.write

    def planned(descriptor: int, data: bytes) -> int:
        todo = plan.pop(0) if plan else len(data)
        if isinstance(todo, OSError):
            raise todo
        return write(descriptor, data[:todo])

    monkeypatch.setattr(os, "write", planned)
    return plan


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO])
@pytest.mark.parametrize("cut", [0, 10, 60])
def test_a_write_that_fails_is_told_and_leaves_no_trace(
    tmp_path: Path, failing: list[OSError | int], monkeypatch: pytest.MonkeyPatch, code: int, cut: int
) -> None:
    monkeypatch.setattr(spool_module, "_RETRY_S", 0.05)
    with Spool(tmp_path, sync_interval_s=QUIET_S) as spool:
        spool.append(A, 0, 1, payload(A, 0))
        failing += [cut, OSError(code, os.strerror(code))] if cut else [OSError(code, os.strerror(code))]
        with pytest.raises(SpoolError, match="cannot be written"):
            spool.append(A, 1, 2, payload(A, 1))
        with pytest.raises(SpoolError):  # not tried at once
            spool.append(A, 1, 2, payload(A, 1))
        time.sleep(0.06)
        failing.append(OSError(code, os.strerror(code)))
        with pytest.raises(SpoolError):  # nor can a new file be begun
            spool.append(A, 1, 2, payload(A, 1))
        time.sleep(0.06)
        spool.append(A, 1, 2, payload(A, 1))
        assert spool.failure is None
    with Spool(tmp_path) as spool:
        assert spool.damages == []
        assert [message.payload for message in everything(spool)] == [payload(A, 0), payload(A, 1)]


def test_no_more_is_read_than_was_asked_for_and_one_message(tmp_path: Path) -> None:
    with Spool(tmp_path) as spool:
        for seq in range(200):
            spool.append(A, seq, seq + 1, b"x" * 100)
        read = [len(spool.read(most)) for most in (1, 100, 250, 5000)]
        assert read == [1, 1, 3, 50]
        spool.append(B, 0, 1, b"y" * (6 << 20))  # a frame longer than what is read at once
        assert sum(len(each.payload) for each in everything(spool)) == (200 - sum(read)) * 100 + (6 << 20)


def test_one_process_at_a_time(tmp_path: Path) -> None:
    with Spool(tmp_path / "s"), pytest.raises(SpoolError, match="another process sends from the spool"):
        Spool(tmp_path / "s")
    Spool(tmp_path / "s").close()
    (tmp_path / "file").write_text("x")
    with pytest.raises(SpoolError, match="cannot be opened"):
        Spool(tmp_path / "file")


@given(st.lists(st.binary(max_size=60), max_size=8), st.integers(0, 2000), st.integers(1, 255))
def test_frames_survive_a_flipped_byte_all_but_one(payloads: list[bytes], at: int, flip: int) -> None:
    frames = [encode_frame(2, i, i + 1, data) for i, data in enumerate(payloads)]
    content = bytearray(b"".join(frames))
    if not content:
        return
    content[at % len(content)] ^= flip
    parsed = parse_frames(bytes(content), is_end=True)
    assert len(parsed.damaged) == 1 or parsed.torn
    assert len(parsed.frames) == len(payloads) - 1
    assert all(frame.payload == payloads[frame.seq] for frame in parsed.frames)
