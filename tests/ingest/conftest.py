"""What the tests of the table reader share, and those of live CAN buses: a bus that can be pulled out."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar
from uuid import UUID, uuid4

import can
import can.interfaces
import numpy as np
import polars as pl
import pytest
from can.interfaces.virtual import VirtualBus

from ingest.can.bus.bus import CanBus, CanBusOptions
from ingest.can.frames import FrameBlock
from ingest.station_clock import StationClock
from ingest.tables.file import TableFile
from ingest.tables.rows import BadRow
from stream.batch import SampleBatch
from stream.events import StepEnded, StepStarted

Delivered = list[SampleBatch | StepStarted | StepEnded]


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write text, bytes or columns as a file and give its path."""

    def do(content: str | bytes | dict[str, object], name: str = "run1.csv") -> Path:
        path = tmp_path / name
        if isinstance(content, dict):
            pl.DataFrame(content).write_parquet(path)
        else:
            path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return do


@pytest.fixture
def deliver() -> Callable[[TableFile], Delivered]:
    """Give everything that a table delivers, in one epoch."""
    return lambda table: list(table.batches(lambda unit, run: UUID(int=7)))


@pytest.fixture
def samples() -> Callable[[Delivered], dict[tuple[str, str, str], list[tuple[int, float]]]]:
    """Put batches together again: (time, value) of each unit, run and signal; checks the numbering."""

    def do(delivered: Delivered) -> dict[tuple[str, str, str], list[tuple[int, float]]]:
        result: dict[tuple[str, str, str], list[tuple[int, float]]] = {}
        for batch in delivered:
            if isinstance(batch, SampleBatch):
                found = result.setdefault((batch.unit, batch.run, batch.signal), [])
                assert batch.seq == len(found)
                assert np.all(np.diff(batch.time_array) > 0)
                found.extend(zip(batch.time_array.tolist(), batch.value_array.tolist(), strict=True))
        return result

    return do


@pytest.fixture
def by_signal() -> Callable[[Delivered], dict[str, Delivered]]:
    """Sort what is delivered by its signal; how signals are interleaved depends on the size of the blocks."""

    def do(delivered: Delivered) -> dict[str, Delivered]:
        result: dict[str, Delivered] = {}
        for item in delivered:
            result.setdefault(item.signal if isinstance(item, SampleBatch) else "steps", []).append(item)
        return result

    return do


@pytest.fixture
def said() -> Callable[[tuple[BadRow, ...]], list[str]]:
    """Give bad rows as people read them."""
    return lambda bad: [str(row) for row in bad]


class Keeper:
    """Decodes nothing: keeps all frames, and makes one sample of each."""

    def __init__(self) -> None:
        self.blocks: list[FrameBlock] = []
        self.epoch = uuid4()

    def take(self, block: FrameBlock) -> list[SampleBatch]:
        seq = sum(map(len, self.blocks))
        self.blocks.append(block)
        numbers = np.ascontiguousarray(block.data[:, :4]).view("<u4")[:, 0].astype(np.float64)
        return [SampleBatch("G1", "n", "r1", self.epoch, seq, int(block.t_ns[0]), 1000, "", values=numbers)]

    def finish(self) -> list[SampleBatch]:
        return []

    @property
    def frames(self) -> list[tuple[int, bytes]]:
        return [
            (int(block.arbitration_id[i]), block.data[i, : block.length[i]].tobytes())
            for block in self.blocks
            for i in range(len(block))
        ]


class Plug:
    """What a test does to a faulty bus."""

    is_there = True
    state = can.BusState.ACTIVE
    opened = 0
    last_words: list[can.Message] | None = None  # what the interface still gives before it is gone

    def __init__(self) -> None:
        self.filters_asked: list[Any] = []

    def pull(self) -> None:
        self.is_there = False

    def plug_in(self) -> None:
        self.is_there = True


class FaultyBus(VirtualBus):
    """A virtual bus that can be unplugged and go off the bus; python-can finds it by name."""

    plugs: ClassVar[dict[str, Plug]] = {}

    def __init__(self, channel: str, **options: Any) -> None:
        self.plug = self.plugs.setdefault(channel, Plug())
        if not self.plug.is_there:
            self._is_shutdown = True
            raise can.CanInitializationError("no such device")
        super().__init__(channel, **options)
        self.plug.opened += 1

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.plug.last_words:
            return self.plug.last_words.pop(0), False
        if not self.plug.is_there or self.plug.last_words is not None:
            self.plug.last_words = None
            raise can.CanOperationError("device not configured")
        return super()._recv_internal(timeout)

    def _apply_filters(self, filters: Any) -> None:
        self.plug.filters_asked.append(filters)

    @property
    def state(self) -> can.BusState:
        return self.plug.state

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        raise NotImplementedError


class BusBench:
    """One bus under test: what it delivered and said."""

    def __init__(self, channel: str, interface: str = "virtual", **more: Any) -> None:
        self.keeper = Keeper()
        self.delivered: list[SampleBatch] = []
        self.said: list[str] = []
        self.clock = StationClock()
        options = CanBusOptions(
            interface=interface,
            channel=channel,
            **{name: more.pop(name) for name in ("fd", "number", "options", "filter") if name in more},
        )
        arguments: dict[str, Any] = {
            "decoder": self.keeper,
            "deliver": self.delivered.append,
            "report": self.said.append,
            "block_s": 0.01,
            "reopen_s": (0.01, 0.05),
        }
        self.bus = CanBus(options, self.clock, **arguments | more)

    @property
    def numbers(self) -> list[int]:
        return [int.from_bytes(data[:4], "little") for _, data in self.keeper.frames]


@pytest.fixture
def bus_bench() -> type[BusBench]:
    """Make a bus under test on a channel."""
    return BusBench


@pytest.fixture
def keeper() -> Keeper:
    return Keeper()


@pytest.fixture
def channel() -> str:
    return uuid4().hex


@pytest.fixture
def sender(channel: str) -> Iterator[can.BusABC]:
    with can.Bus(channel, interface="virtual", ignore_config=True) as bus:
        yield bus


@pytest.fixture
def faulty(monkeypatch: pytest.MonkeyPatch, channel: str) -> Plug:
    monkeypatch.setitem(can.interfaces.BACKENDS, "faulty", (__name__, "FaultyBus"))
    FaultyBus.plugs[channel] = Plug()
    return FaultyBus.plugs[channel]


@pytest.fixture
def frame() -> Callable[..., can.Message]:
    """Make a frame that carries a number."""

    def make(number: int, arbitration_id: int = 0x123, **more: Any) -> can.Message:
        return can.Message(
            arbitration_id=arbitration_id, is_extended_id=False, data=number.to_bytes(4, "little") + bytes(4), **more
        )

    return make


@pytest.fixture
def until() -> Callable[..., None]:
    """Wait until something is so."""

    def wait(condition: Callable[[], object], within_s: float = 10.0) -> None:
        end_s = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < end_s, "waited in vain"
            time.sleep(0.002)

    return wait
