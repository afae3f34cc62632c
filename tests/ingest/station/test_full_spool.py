"""A spool that fills: the warnings before it is full and while it is, the note after it, the samples that are lost."""

import threading
import time
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from ingest.station.delivery_account import DeliveryAccount
from ingest.station_clock import StationClock
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.delivery.spool import Spool, SpoolFull
from stream.delivery.spool_room import SpoolRoom
from stream.events import NoteAdded
from stream.identity import event_key
from stream.transport.bus import LocalBus
from stream.wire.acknowledgement import StreamId
from tests.stream.stand_in_recorder import KEY, PLACE, N, StandIn, batch, until

MS = 1_000_000


class Clock(StationClock):
    """A clock that is set."""

    t_ns = 10**18

    def now_ns(self) -> int:
        return self.t_ns


def rate(unit: str, first: int, count: int, *, irregular: bool = False) -> SampleBatch:
    return SampleBatch(
        unit, "rate", "r1", UUID(int=1), first, 10**18 + first * 10 * MS, 10 * MS, "deg/s", values=np.zeros(count),
        irregular=irregular,
    )  # fmt: skip


def test_a_filling_spool_is_named_once_a_level_and_forecast(tmp_path: Path) -> None:
    room = SpoolRoom(tmp_path, 1600)
    said = []
    for second in range(100):
        room.grew(15 * second, now_s=float(second))
        said.append(room.warning)
    levels = [each for each in dict.fromkeys(said) if each is not None]
    assert [each.split(" % full, with room for ")[0].rpartition(" ")[2] for each in levels] == ["50", "75", "90"]
    assert [each.split(" with room for ")[1].split(" at the present")[0] for each in levels] == ["50 s", "25 s", "10 s"]
    room.grew(500, now_s=101.0)
    assert room.warning is None


def test_documents_do_not_wait_for_the_room_of_samples(tmp_path: Path) -> None:
    stream = StreamId("gyrofleet/plant/bench/U1/rate", "e")
    with Spool(tmp_path, max_bytes=32_000) as spool:
        with pytest.raises(SpoolFull):
            for seq in range(1000):
                spool.append(stream, seq, seq + 1, bytes(200))
        assert "is full: lines and buses are not read since" in str(spool.room.warning)
        kept = spool.position(stream)
        for seq in range(kept, kept + 5):
            spool.append(stream, seq, seq + 1, bytes(200), is_document=True)
        assert spool.position(stream) == kept + 5
        assert sum(path.stat().st_size for path in tmp_path.glob("*.spool")) <= 32_000


def test_samples_that_lack_after_a_delivery_that_waited_were_not_read() -> None:
    clock = Clock()
    account = DeliveryAccount(clock)
    for first in (0, 25, 55):  # 5 lost on the way
        with account.delivering(rate("A", first, 25)):
            pass
    assert (account.lost, account.not_read, account.over()) == (5, 0, None)
    with account.delivering(rate("A", 80, 25)):
        clock.t_ns += 2 * 10**9
        assert account.not_read_now() == {"A"}
    for first in (300, 325):
        with account.delivering(rate("A", first, 25)):
            pass
    assert (account.lost, account.not_read) == (5 + 195, 195)
    assert account.over() is None  # what comes next may show more
    clock.t_ns += 4 * 10**9
    units, text = account.over() or ([], "")
    assert units == ["A"]
    assert text.startswith("A were not read from 01:46:40 to 01:46:42 UTC, as what had come waited for a recorder")
    assert text.endswith("195 samples are lost")
    assert account.over() is None
    for first in (0, 900):
        with account.delivering(rate("B", first, 5, irregular=True)):
            pass
    assert account.lost == 200


@pytest.mark.long
def test_a_source_waits_until_a_recorder_is_there_and_documents_go_by(tmp_path: Path) -> None:
    bus, account = LocalBus(), DeliveryAccount(StationClock())
    with Spool(tmp_path, max_bytes=100_000) as spool:
        publisher = DurablePublisher(bus, window_bytes=5000, resend_after_s=0.1, timeout_s=0.5, spool=spool)
        publisher.waits_when_full = True

        def send() -> None:
            for i in range(400):
                with account.delivering(batch(i)):
                    publisher.send_batch(KEY, batch(i))

        source = threading.Thread(target=send)
        source.start()
        until(lambda: bool(account.not_read_now()))
        time.sleep(1.0)  # twice the time after which waiting ended
        assert "is full: lines and buses are not read since" in str(publisher.warning)
        publisher.send_event(event_key(PLACE), NoteAdded(run="r1", t_ns=0, text="while it is full"))
        recorder = StandIn(bus)
        source.join(20.0)
        assert not source.is_alive()
        publisher.drain()
        publisher.close()
    assert recorder.samples() == list(range(400 * N))
    assert "1 were" not in str(account.over())
    assert account.lost == 0
