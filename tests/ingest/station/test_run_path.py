"""What keeps a run's samples from being recorded is reported once, when it begins, changes and ends."""

import errno
import os
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
from rich.console import Console

from ingest.procedures.plan import PlannedStep
from ingest.run.run_path import Destination, TroubleWatch
from ingest.station import operator_console
from ingest.station.operator_console import ConsoleOperator
from ingest.station_clock import StationClock
from stream.batch import SampleBatch
from stream.delivery import spool as spool_module
from stream.delivery.publisher import DurablePublisher
from stream.delivery.spool import Spool
from stream.errors import BadInput
from stream.events import StepWords
from stream.identity import ACKNOWLEDGEMENT_KEY, Place, sample_key
from stream.terminal.console import Stop
from stream.transport.bus import LocalBus
from stream.wire.acknowledgement import encode_acknowledgement

KEY = sample_key(Place("plant", "bench"), "U1", "rate")


def batch(i: int) -> SampleBatch:
    return SampleBatch("U1", "rate", "r1", UUID(int=1), 10 * i, 10**9 * i, 10**8, "deg/s", values=np.zeros(10))


def test_a_recorder_that_pauses_and_a_spool_that_cannot_be_written_are_told_to_the_operator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, until: Callable[..., None]
) -> None:
    bus, said = LocalBus(), StringIO()
    operator = ConsoleOperator(Console(file=said, width=500), Stop(), says_yes=True, quiet=True, listens=False)
    with Spool(tmp_path / "spool") as spool, DurablePublisher(bus, spool=spool) as publisher:
        operator.watch(TroubleWatch(publisher, operator.report).look)

        def reported() -> list[str]:
            assert operator.poll_request() is None
            return said.getvalue().splitlines()

        def pause(reason: str) -> None:
            bus.publish(ACKNOWLEDGEMENT_KEY, encode_acknowledgement("s", (), reason))

        assert reported() == []
        pause("the disk is full")
        until(lambda: len(reported()) == 1)
        pause("the disk is full")
        pause("the disk is gone")
        until(lambda: len(reported()) == 2)
        pause("")
        until(lambda: len(reported()) == 3)

        def refuse(descriptor: int, content: bytes) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with monkeypatch.context() as full:
            full.setattr(spool_module, "_write_whole", refuse)
            publisher.send_batch(KEY, batch(0))
            assert len(reported()) == 4
        publisher.abandon()
    first, second, third, fourth = reported()
    assert first == "warning: the recorder pauses: the disk is full"
    assert second == "warning: the recorder pauses: the disk is gone"
    assert third == "recording goes on"
    assert "cannot be written" in fourth
    assert "No space left on device" in fourth


def test_a_folder_that_could_not_be_made_is_refused(tmp_path: Path) -> None:
    Destination.chosen("陀" * 66, tmp_path, None, None, 1)
    with pytest.raises(BadInput, match="has 201 bytes in UTF-8"):
        Destination.chosen("陀" * 67, tmp_path, None, None, 1)


def test_the_time_left_at_the_terminal_is_that_of_the_status(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a simulated station that is fifty times as fast."""
    said, clock = StringIO(), StationClock(speed=50.0)
    monkeypatch.setattr(operator_console, "_REPORT_EVERY_S", 0.0)
    operator = ConsoleOperator(
        Console(file=said, width=500), Stop(), says_yes=True, quiet=False, listens=False, takes_s=clock.computer_s
    )
    operator.at(PlannedStep(number=8, words=StepWords(step="rate"), record_s=450.0), "recording", 450.0)
    assert "recording, 9 s left" in said.getvalue()
    assert clock.computer_s(operator.left_s) == 9.0  # in the status of the run
