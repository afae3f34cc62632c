"""The simulated station: any stretch made again is the same; a run goes on where it was, and states its gaps."""

from pathlib import Path

import numpy as np
import pytest

from ingest.run.live_run import LiveRun, RunParameters
from ingest.simulator.demo_fleet import station_fleet
from ingest.simulator.station import PowerCycle, SimulatedStation
from stream.batch import SampleBatch
from stream.delivery.spool import Spool
from stream.errors import BadInput, StoreError
from stream.events import AnyDocument, PowerOn, RunEnded, RunResumed, RunStarted, StepEnded, StepStarted
from stream.wire.acknowledgement import StreamId
from stream.wire.batches import encode_batch

SECOND = 10**9


def station(batch: int = 100, seed: int = 1) -> SimulatedStation:
    return SimulatedStation(station_fleet(3, 100.0, seed), "r1", batch=batch)


def counts(batches: list[SampleBatch], unit: str, signal: str) -> np.ndarray:
    return np.concatenate([b.counts for b in batches if (b.unit, b.signal) == (unit, signal) and b.counts is not None])


def test_any_stretch_made_again_is_the_same_in_batches_of_whatever_size() -> None:
    power_cycle = PowerCycle(0, 5 * SECOND)
    whole = list(station().batches("r1", power_cycle, end_ns=305 * SECOND))
    assert [batch.last_ns for batch in whole] == sorted(batch.last_ns for batch in whole)
    first = {("SIM-0001", "rate"): 20_000, ("SIM-0002", "rate"): 10_000, ("SIM-0002", "temperature"): 50}
    part = list(station().batches("r1", power_cycle, end_ns=305 * SECOND, first=first))
    wanted = [batch for batch in whole if batch.seq >= first.get((batch.unit, batch.signal), 0)]
    assert part == wanted
    larger = list(station(batch=777).batches("r1", power_cycle, end_ns=305 * SECOND))
    for unit in ("SIM-0001", "SIM-0003"):
        for signal, n in (("rate", 30_000), ("temperature", 300)):
            assert len(counts(whole, unit, signal)) == n
            assert np.array_equal(counts(whole, unit, signal), counts(larger, unit, signal))


def test_power_ons_units_and_seeds_differ() -> None:
    def of(number: int, unit: str, seed: int) -> np.ndarray:
        return counts(
            list(station(seed=seed).batches("r1", PowerCycle(number, 0), end_ns=10 * SECOND)), f"SIM-000{unit}", "rate"
        )

    one = of(0, "1", 1)
    for other in (of(1, "1", 1), of(0, "2", 1), of(0, "1", 2)):
        assert np.mean(one == other) < 0.2
    epochs = {station().epoch(PowerCycle(k, 0), unit) for k in range(3) for unit in ("SIM-0001", "SIM-0002")}
    assert len(epochs) == 6


class Memory:
    """Stands for a publisher: keeps what it is given, in the spool as well; breaks off on request."""

    def __init__(self, spool: Spool, *, breaks_after: int | None = None) -> None:
        self.spool = spool
        self.breaks_after = breaks_after
        self.batches: list[SampleBatch] = []
        self.documents: list[AnyDocument] = []

    def _count(self) -> None:
        if self.breaks_after is not None and len(self.batches) + len(self.documents) >= self.breaks_after:
            raise PowerLoss

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        self._count()
        self.spool.append(StreamId(key, batch.epoch.hex), batch.seq, batch.next_seq, encode_batch(batch))
        self.batches.append(batch)

    def send_event(self, key: str, document: AnyDocument) -> None:
        self._count()
        self.documents.append(document)


class PowerLoss(Exception):
    """Stands for the moment at which the process ends."""


class Station:
    """A run taken up again and again, with a clock of its own."""

    def __init__(self, folder: Path, speed: float, hours: float = 0.01, **words: str) -> None:
        self.folder = folder
        self.now_ns = 1_000_000 * SECOND
        self.parameters = RunParameters(
            simulate=2, rate_hz=100.0, batch=50, hours=hours, speed=speed, seed=4, site="local", station="bench",
            **words,
        )  # fmt: skip
        self.batches: list[SampleBatch] = []
        self.documents: list[AnyDocument] = []

    def take_up(self, breaks_after: int | None = None) -> LiveRun:
        with Spool(self.folder) as spool:
            live = LiveRun("r1", self.parameters, spool, lambda: self.now_ns)
            memory = Memory(spool, breaks_after=breaks_after)
            try:
                live.begin(memory)
                for batch in live.batches(lambda _: False):
                    memory.send_batch(live.key(batch), batch)
                live.end(memory)
                live.close()
            finally:
                self.batches += memory.batches
                self.documents += memory.documents
        return live

    def of(self, kind: type[AnyDocument]) -> list[AnyDocument]:
        return list({document.uid: document for document in self.documents if isinstance(document, kind)}.values())


def test_a_run_without_a_pace_goes_on_with_the_next_sample(tmp_path: Path) -> None:
    undisturbed = Station(tmp_path / "a", speed=0.0)
    undisturbed.take_up()
    broken = Station(tmp_path / "b", speed=0.0)
    for breaks_after in (0, 1, 2, 5, 20, 33, 60):
        with pytest.raises(PowerLoss):
            broken.take_up(breaks_after)
        broken.now_ns += 1000 * SECOND
    live = broken.take_up()
    assert live.state.phase == "ended"
    assert broken.batches == undisturbed.batches
    assert [len(broken.of(kind)) for kind in (RunStarted, PowerOn, RunEnded)] == [1, 2, 1]
    assert {document.gap_ns for document in broken.of(RunResumed) if isinstance(document, RunResumed)} == {0}
    assert broken.of(RunEnded) == undisturbed.of(RunEnded)
    sent = len(broken.batches)
    assert broken.take_up().state.phase == "ended"
    assert len(broken.batches) == sent


@pytest.mark.parametrize(("speed", "steps"), [(0.0, 2), (1000.0, 4)])
def test_each_power_on_is_a_step_of_what_is_done(tmp_path: Path, speed: float, steps: int) -> None:
    plain = Station(tmp_path / "plain", speed=0.0)
    plain.take_up()
    assert plain.of(StepStarted) == []
    station = Station(tmp_path / "steps", speed=speed, procedure="static_bias", position="IRA_east_west")
    with pytest.raises(PowerLoss):
        station.take_up(breaks_after=5 + 20)
    station.now_ns += 20_000_000
    station.take_up()
    begun = {each.uid: each for each in station.of(StepStarted) if isinstance(each, StepStarted)}
    ended = [each for each in station.of(StepEnded) if isinstance(each, StepEnded)]
    assert len(begun) == len(ended) == steps
    assert {(each.words.procedure, each.words.position) for each in begun.values()} == {
        ("static_bias", "IRA_east_west")
    }
    for batch in station.batches:
        inside = [
            each for each in ended
            if each.unit == batch.unit and begun[each.step_uid].t_ns <= batch.t0_ns and batch.t0_ns <= each.t_ns
        ]  # fmt: skip
        assert len(inside) == 1
        assert batch.signal != "rate" or batch.last_ns <= inside[0].t_ns


def test_a_paced_run_loses_the_time_it_was_off_and_says_how_much(tmp_path: Path) -> None:
    station = Station(tmp_path, speed=1000.0)  # 36 s of samples in 36 ms
    with pytest.raises(PowerLoss):
        station.take_up(breaks_after=3 + 20)
    first = list(station.batches)
    measured_s = 10 * 50 / 100.0
    station.now_ns += 20_000_000  # 20 s of its time
    live = station.take_up()
    (resumed,) = station.of(RunResumed)
    assert isinstance(resumed, RunResumed)
    assert resumed.gap_ns == round((20.0 - measured_s) * SECOND)
    later = [batch for batch in station.batches[len(first) :] if batch.signal == "rate"]
    assert {batch.epoch for batch in later}.isdisjoint({batch.epoch for batch in first})
    assert min(batch.t0_ns for batch in later) == live.state.t0_ns + 20 * SECOND
    assert [batch.seq for batch in later[:2]] == [0, 0]
    assert len(station.of(PowerOn)) == 4
    (ended,) = station.of(RunEnded)
    assert isinstance(ended, RunEnded)
    assert sum(total.samples for total in ended.totals) == sum(len(batch) for batch in station.batches)


def test_a_paced_run_whose_time_is_over_is_only_ended(tmp_path: Path) -> None:
    station = Station(tmp_path, speed=1000.0)
    with pytest.raises(PowerLoss):
        station.take_up(breaks_after=10)
    sent = len(station.batches)
    station.now_ns += 3600 * SECOND
    assert station.take_up().state.phase == "ended"
    assert len(station.batches) == sent
    assert len(station.of(RunEnded)) == 1
    assert len(station.of(PowerOn)) == 2


def test_other_parameters_are_refused(tmp_path: Path) -> None:
    station = Station(tmp_path, speed=0.0)
    with pytest.raises(PowerLoss):
        station.take_up(breaks_after=10)
    other = Station(tmp_path, speed=0.0, hours=2.0)
    with pytest.raises(BadInput, match=r"run r1 was started with other options: --hours was 0.01, now 2.0"):
        other.take_up()
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(StoreError, match=r"run.json cannot be read.*another --run"):
        station.take_up()
