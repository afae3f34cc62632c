"""Units that an instrument carries from position to position, where else an operator is asked."""

from pathlib import Path

import pytest

from ingest.procedures.file import Names
from ingest.procedures.plan import PlannedStep
from ingest.station import run as station_run
from ingest.station.run import StationRun
from stream.delivery.spool import Spool
from stream.errors import InstrumentError
from stream.events import StepWords
from tests.ingest.station.test_station_run import Operator, Supply, Wire, begun, station


class Carrier(Supply):
    """A table that carries the units to one position."""

    positions = ("X_up",)

    def __init__(self) -> None:
        super().__init__()
        self.carried: list[str] = []
        self.refusals = 1

    def carry(self, position: str) -> None:
        if self.refusals:
            self.refusals -= 1
            raise InstrumentError("the arm is in the way")
        self.carried.append(position)


def test_a_position_that_an_instrument_carries_to_asks_no_operator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(station_run, "_RETRY_S", 0.0)
    asked: list[str] = []

    class Asked(Operator):
        def ready(self, prompt: str) -> bool:
            asked.append(prompt)
            return True

    steps = tuple(
        PlannedStep(
            number=at, words=StepWords(procedure="p", step="mount", position=position),
            prompt=Names(en=f"to {position}", zh="安装"),
        )
        for at, position in enumerate(("X_up", "Y_up", None), start=1)
    )  # fmt: skip
    wire, carrier = Wire(), Carrier()
    operator = Asked()
    with Spool(tmp_path) as spool:
        log = begun(tmp_path, wire, steps, spool)
        StationRun(log, steps, station(), {"supply": carrier}, operator, carrier.clock).go(list)
    assert carrier.carried == ["X_up"]
    assert asked == ["to Y_up / 安装", "to None / 安装"]
    assert operator.said == ["carrying to X_up: the arm is in the way; trying again"]
