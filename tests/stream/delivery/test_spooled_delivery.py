"""The publisher with a spool: what is on disk survives the process, a full disk and damage."""

import errno
import os
from pathlib import Path
from uuid import UUID

import pytest

from stream.delivery import spool as spool_module
from stream.delivery.outbox import Outbox
from stream.delivery.outgoing import HeldMessage
from stream.delivery.publisher import DurablePublisher
from stream.delivery.spool import Spool
from stream.errors import DeliveryError
from stream.events import NoteAdded
from stream.identity import event_key
from stream.transport.bus import LocalBus
from stream.wire.acknowledgement import StreamId, StreamPosition
from stream.wire.batches import encode_batch
from tests.stream.stand_in_recorder import KEY, PLACE, N, StandIn, batch, until


def refuse(*_: object) -> int:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


class TestSpool:
    def test_hours_without_a_recorder_take_a_window_of_memory(self, tmp_path: Path) -> None:
        bus = LocalBus()
        size = len(encode_batch(batch(5)))
        with Spool(tmp_path, file_bytes=50_000) as spool:
            with DurablePublisher(bus, window_bytes=10 * size, resend_after_s=0.1, spool=spool) as publisher:
                for i in range(1000):
                    publisher.send_batch(KEY, batch(i))
                assert publisher._out.bytes <= 11 * size  # a message read from the disk is taken whole
                assert publisher.outstanding == 1000
                recorder = StandIn(bus)
                publisher.drain()
            assert publisher.outstanding == 0
            assert recorder.samples() == list(range(1000 * N))
            until(lambda: len(list(tmp_path.glob("*.spool"))) <= 2)

    def test_the_next_process_sends_what_is_left(self, tmp_path: Path) -> None:
        bus = LocalBus()
        recorder = StandIn(bus)
        for start in range(3):
            with Spool(tmp_path) as spool:
                publisher = DurablePublisher(bus, window_bytes=5000, resend_after_s=0.1, spool=spool)
                recorder.is_stopped = start != 1
                for i in range(start * 100, start * 100 + 100):
                    publisher.send_batch(KEY, batch(i))
                publisher.send_event(event_key(PLACE), NoteAdded(run="r1", t_ns=0, text=str(start)))
                publisher.abandon()  # as if killed
        recorder.is_stopped = False
        with Spool(tmp_path) as spool, DurablePublisher(bus, resend_after_s=0.1, spool=spool) as publisher:
            publisher.drain()
        assert recorder.samples() == list(range(300 * N))
        assert sum(stream.key == event_key(PLACE) for stream in recorder.marks) == 3

    def test_what_was_acknowledged_is_not_sent_again(self, tmp_path: Path) -> None:
        bus = LocalBus()
        recorder = StandIn(bus)
        with Spool(tmp_path) as spool, DurablePublisher(bus, spool=spool) as publisher:
            for i in range(50):
                publisher.send_batch(KEY, batch(i))
            publisher.drain()
            recorder.is_stopped = True
            publisher.send_batch(KEY, batch(50))
            publisher.abandon()
            recorder.is_stopped = False
            recorder.arrived.clear()
        with Spool(tmp_path) as spool, DurablePublisher(bus, spool=spool):
            pass
        assert recorder.arrived == [(StreamId(KEY, UUID(int=1).hex), 50 * N)]

    def test_a_disk_that_fails_leaves_the_window(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        bus = LocalBus()
        recorder = StandIn(bus)
        monkeypatch.setattr(spool_module, "_RETRY_S", 0.05)
        with Spool(tmp_path) as spool, DurablePublisher(bus, resend_after_s=0.1, spool=spool) as publisher:
            for i in range(100):
                if i == 20:
                    monkeypatch.setattr(os, "write", refuse)
                if i == 60:
                    assert publisher.warning is not None
                    assert "No space left" in publisher.warning
                    monkeypatch.undo()
                    monkeypatch.setattr(spool_module, "_RETRY_S", 0.0)
                publisher.send_batch(KEY, batch(i))
            assert publisher.warning is None
        assert recorder.samples() == list(range(100 * N))

    def test_messages_that_no_disk_took_are_counted(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """They are lost with the process."""
        with Spool(tmp_path) as spool:
            publisher = DurablePublisher(LocalBus(), spool=spool)
            publisher.send_batch(KEY, batch(0))
            assert (publisher.outstanding, publisher.not_kept) == (1, 0)
            with monkeypatch.context() as full:
                full.setattr(os, "write", refuse)
                for i in (1, 2):
                    publisher.send_batch(KEY, batch(i))
            assert (publisher.outstanding, publisher.not_kept) == (3, 2)
            publisher.abandon()

    @pytest.mark.long
    def test_a_full_spool_makes_its_source_wait(self, tmp_path: Path) -> None:
        bus = LocalBus()
        with Spool(tmp_path, max_bytes=100_000) as spool:
            publisher = DurablePublisher(bus, window_bytes=5000, resend_after_s=0.1, timeout_s=1.0, spool=spool)
            with pytest.raises(DeliveryError, match=r"the spool .* is full.*outstanding"):
                for i in range(1000):
                    publisher.send_batch(KEY, batch(i))
            reached = spool.position(StreamId(KEY, UUID(int=1).hex)) // N
            recorder = StandIn(bus)
            for i in range(reached, 1000):
                publisher.send_batch(KEY, batch(i))
            publisher.drain()
            publisher.close()
        assert recorder.samples() == list(range(1000 * N))

    def test_what_a_damaged_spool_still_has_goes_on_under_an_epoch_of_its_own(self, tmp_path: Path) -> None:
        bus = LocalBus()
        with Spool(tmp_path, file_bytes=20_000) as spool, DurablePublisher(bus, spool=spool) as publisher:
            for i in range(100):
                publisher.send_batch(KEY, batch(i))
            publisher.abandon()
        path = sorted(tmp_path.glob("*.spool"))[1]
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
        recorder = StandIn(bus)
        for first in (100, 110):
            with Spool(tmp_path) as spool, DurablePublisher(bus, resend_after_s=0.1, spool=spool) as publisher:
                for i in range(first, first + 10):
                    publisher.send_batch(KEY, batch(i))
        assert spool.damages == [] or "damaged" in spool.damages[0]
        before, after = recorder.values.values()
        assert before == list(range(len(before)))
        assert after == list(range(len(before) + N, 120 * N))

    def test_it_goes_on_after_a_recorder_has_lost_what_it_had(self, tmp_path: Path) -> None:
        bus = LocalBus()
        recorder = StandIn(bus)
        stream = StreamId(KEY, UUID(int=1).hex)
        with Spool(tmp_path) as spool, DurablePublisher(bus, resend_after_s=0.05, timeout_s=10, spool=spool) as sender:
            for i in range(5):
                sender.send_batch(KEY, batch(i))
            sender.drain()
            recorder.marks[stream] = 2 * N  # a segment was lost
            for i in range(5, 10):
                sender.send_batch(KEY, batch(i))
            sender.drain()
            assert "the recorder has lost what it had acknowledged" in str(sender.warning)
            sender.send_batch(KEY, batch(10))
        with Spool(tmp_path) as spool, DurablePublisher(bus, resend_after_s=0.05, timeout_s=10, spool=spool) as sender:
            sender.send_batch(KEY, batch(11))
        assert recorder.values.pop(stream) == list(range(5 * N))
        assert list(recorder.values.values()) == [list(range(5 * N, 12 * N))]

    def test_documents_go_on_as_well(self, tmp_path: Path) -> None:
        bus = LocalBus()
        recorder = StandIn(bus)
        with Spool(tmp_path) as spool, DurablePublisher(bus, resend_after_s=0.05, timeout_s=10, spool=spool) as sender:
            for i in range(3):
                sender.send_event(event_key(PLACE), NoteAdded(run="r1", t_ns=i, text=""))
            sender.drain()
            (stream,) = recorder.marks
            recorder.marks[stream] = 1
            sender.send_event(event_key(PLACE), NoteAdded(run="r1", t_ns=3, text=""))
            sender.drain()
            sender.send_event(event_key(PLACE), NoteAdded(run="r1", t_ns=4, text=""))
            sender.drain()
        assert recorder.marks.pop(stream) == 1
        assert list(recorder.marks.values()) == [2]

    def test_an_answer_to_a_name_from_before_lets_go_of_nothing(self, tmp_path: Path) -> None:
        """Two holes in one stream of a damaged spool: it is renamed twice, and the first answer comes once more."""
        stream = StreamId(KEY, UUID(int=1).hex)
        with Spool(tmp_path) as spool:
            out = Outbox(1 << 20, 2.0, spool)
            sent = out.stream(stream)
            for seq in (5, 15, 20, 25):  # 0 to 4 and 10 to 14 are lost
                spool.append(stream, seq, seq + 5, b"x", taken=True)
                out.hold(sent, HeldMessage(seq, seq + 5, b"x"))
            out.answer("store", StreamPosition(*stream, 0, rewind=True), 1.0)
            first = sent.wire_id
            out.answer("store", StreamPosition(*first, 5), 2.0)
            out.answer("store", StreamPosition(*first, 5, rewind=True), 3.0)
            assert (sent.base, sent.wire_id == first) == (15, False)
            for late in (
                StreamPosition(*first, 5),
                StreamPosition(*first, 5, rewind=True),
                StreamPosition(*stream, 20),
            ):
                out.answer("store", late, 4.0)
            assert ([each.seq for each in sent.held], sent.acknowledged, sent.base) == ([15, 20, 25], 10, 15)
            out.answer("store", StreamPosition(*sent.wire_id, 15), 5.0)
            assert (list(sent.held), sent.acknowledged, out.bytes) == ([], 30, 0)
