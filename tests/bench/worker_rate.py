"""What a worker takes: samples a second through all estimators of many signals, alone in a process, and its memory.

    .venv/bin/python tests/bench/worker_rate.py [--signals 1000] [--batch 100,1000] [--samples 2e7] [--limits]
        [--no-spectrum] [--json]

Messages are encoded beforehand, in lots, of which the first, that begins the signals, is not counted. Timed is from the
first message of a lot going in until the last is worked off, as wall time and as CPU time of the worker's thread, the
checkpoint at the end and the feeding apart. `cores` is the share of one core that 10 million samples a second would
take, 3 million at 100 a batch. Each signal is sampled at 10 kHz.
"""

import argparse
import json
import resource
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from uuid import UUID

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stream.batch import SampleBatch
from stream.delivery.recorded_log import LogBeginning, LoggedMessage
from stream.events import AnyDocument, Limit, LimitsApplied, encode_event
from stream.identity import Place, event_key, sample_key
from stream.transport.bus import LocalBus
from stream.wire.acknowledgement import StreamId
from stream.wire.batches import encode_batch
from stream.worker.compile_kernels import warm_up
from stream.worker.worker import EstimationWorker

PLACE = Place("plant", "bench")
DT_NS = 100_000
LOT_SAMPLES = 4_000_000
GOALS = {100: 3e6, 1000: 10e6}
LIMITS = tuple(
    Limit(characteristic=what, signal="rate", tau_s=tau_s, upper=upper, unit_of_measure=unit)
    for what, tau_s, upper, unit in (
        ("bias_stability", 10.0, 0.5, "deg/h"),
        ("allan_deviation", 3.0, 0.5, "deg/h"),
        ("angle_random_walk", None, 1e-3, "deg/sqrt(h)"),
    )
)


class Sink:
    """Takes documents and forgets them."""

    outstanding = 0
    documents = 0

    def send_event(self, key: str, document: AnyDocument) -> None:
        self.documents += 1

    def drain(self) -> None:
        """Nothing is outstanding."""


class EmptyLog:
    identity = "bench"

    def beginning(self, *, thorough: bool = False) -> LogBeginning:
        return LogBeginning({}, frozenset())

    def since(self, positions: Mapping[StreamId, int]) -> Iterator[LoggedMessage]:
        return iter(())

    def published(self, positions: Mapping[StreamId, int]) -> Iterator[str]:
        return iter(())


def lots(signals: int, batch: int, samples: int) -> Iterator[list[tuple[str, bytes]]]:
    """Messages of all signals in turn, as they come from a bus."""
    counts = np.random.default_rng(1).integers(-150, 150, 64 * batch).astype(np.int32)
    names = [(f"FOG-{i:04d}", sample_key(PLACE, f"FOG-{i:04d}", "rate"), UUID(int=i + 1)) for i in range(signals)]
    rounds = max(1, LOT_SAMPLES // (signals * batch))
    seq = 0
    while seq * signals < samples:
        lot = []
        for _ in range(rounds):
            for i, (unit, key, epoch) in enumerate(names):
                at = (seq // batch + i) % 64 * batch
                part = counts[at : at + batch]
                head = ("rate", "r1", epoch, seq, seq * DT_NS, DT_NS, "deg/h")
                lot.append((key, encode_batch(SampleBatch(unit, *head, counts=part, scale=1e-3))))
            seq += batch
        yield lot


def rate(signals: int, batch: int, samples: int, *, limits: bool, spectrum: bool = True) -> dict[str, float]:
    bus, sink = LocalBus(), Sink()
    with tempfile.TemporaryDirectory() as folder:
        worker = EstimationWorker(
            bus, sink, log=EmptyLog(), checkpoint=Path(folder) / "c", checkpoint_every_s=1e6, every_s=60.0,
            spectrum=spectrum,
        )  # fmt: skip
        assert worker._thread.ident is not None
        clock = time.pthread_getcpuclockid(worker._thread.ident)
        if limits:
            applied = LimitsApplied(run="r1", t_ns=0, revision="R", limits=LIMITS, planned_s=3600.0)
            bus.publish(event_key(PLACE), encode_event(applied, "e", 0))
        wall_s = cpu_s = 0.0
        taken = messages = 0
        for number, lot in enumerate(lots(signals, batch, samples + LOT_SAMPLES)):
            began, cpu_began = time.perf_counter(), time.clock_gettime(clock)
            for key, payload in lot:
                worker.wait_for_room()
                bus.publish(key, payload)
            taken += len(lot) * batch
            while worker.counts.samples < taken and worker.failure is None:
                time.sleep(0.001)
            if number:
                messages += len(lot)
                wall_s += time.perf_counter() - began
                cpu_s += time.clock_gettime(clock) - cpu_began
        began = time.perf_counter()
        worker.close()
        checkpoint_s = time.perf_counter() - began
        checkpoint_mb = (Path(folder) / "c").stat().st_size / 1e6
    found = {
        "signals": signals,
        "batch": batch,
        "samples": messages * batch,
        "samples_per_s": messages * batch / wall_s,
        "cpu_us_per_message": cpu_s / messages * 1e6,
        "cpu_ns_per_sample": cpu_s / messages / batch * 1e9,
        "cores": cpu_s / messages / batch * GOALS.get(batch, 10e6),
        "documents": sink.documents,
        "checkpoint_s": checkpoint_s,
        "checkpoint_mb": checkpoint_mb,
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    assert worker.counts.lost == 0
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--signals", type=int, default=1000)
    parser.add_argument("--batch", default="100,1000", help="samples a batch, several with commas")
    parser.add_argument("--samples", type=float, default=2e7)
    parser.add_argument("--limits", action="store_true", help="with limits that are decided early")
    parser.add_argument("--no-spectrum", action="store_true", help="Allan deviation and bias stability only")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    warm_up()
    for batch in (int(each) for each in arguments.batch.split(",")):
        found = rate(
            arguments.signals, batch, int(arguments.samples), limits=arguments.limits,
            spectrum=not arguments.no_spectrum,
        )  # fmt: skip
        if arguments.json:
            print(json.dumps(found))
            continue
        print(
            f"{found['signals']} signals, {batch} a batch: {found['samples_per_s'] / 1e6:.2f} M samples/s, "
            f"{found['cpu_us_per_message']:.1f} us a message, {found['cpu_ns_per_sample']:.1f} ns a sample "
            f"({found['cores']:.2f} of a core at the goal's rate), {found['documents']} documents, checkpoint "
            f"{found['checkpoint_s']:.1f} s {found['checkpoint_mb']:.0f} MB, {found['memory_mb']:.0f} MB"
        )


if __name__ == "__main__":
    main()
