"""The embedded path: a slow estimator holds up its own source, and nothing else."""

import errno
import time
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from ingest.run import pipeline as pipeline_module
from ingest.run.pipeline import EmbeddedPipeline
from storage.log.writer import SegmentWriter
from storage.sql.catalog import Catalog
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.estimators.bias_stability import BiasStability
from stream.events import RunEnded
from stream.identity import Place, event_key, sample_key
from stream.transport.zenoh_bus import ZenohBus
from stream.worker import worker as worker_module
from stream.worker.worker import EstimationWorker

PLACE = Place("plant", "bench")
KEY = sample_key(PLACE, "U1", "rate")


class SlowEstimator(BiasStability):
    """Takes its time over every batch."""

    def update(self, batch: SampleBatch) -> None:
        time.sleep(0.002)
        super().update(batch)


def batch(i: int) -> SampleBatch:
    return SampleBatch(
        "U1", "rate", "r1", UUID(int=1), i * 1000, i * 10**10, 10**7, "deg/s", values=np.full(1000, float(i))
    )


@pytest.mark.parametrize("batches", [100, pytest.param(500, marks=pytest.mark.long)])
def test_a_slow_estimator_throttles_its_source_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, batches: int
) -> None:
    monkeypatch.setattr(worker_module, "_ROOM_BYTES", 100_000)
    monkeypatch.setattr(
        pipeline_module,
        "EstimationWorker",
        lambda *args, **kwargs: EstimationWorker(*args, **kwargs, estimators={"slow": lambda: SlowEstimator(1.0)}),
    )
    with EmbeddedPipeline(tmp_path / "store", "test", estimate_every_s=10.0) as pipeline:
        for i in range(batches):
            pipeline.send_batch(KEY, batch(i))
        pipeline.send_event(event_key(PLACE), RunEnded(run="r1", t_ns=batches * 10**10))
        pipeline.finish()
    assert pipeline.worker.counts.lost == 0
    assert pipeline.worker.counts.samples == 1000 * batches
    with Catalog(pipeline.store) as catalog:
        assert catalog.rows("select count(*), count(distinct t_ns) from samples") == [(1000 * batches, 1000 * batches)]
        assert catalog.rows("select count(*) from estimates where final") == [(1,)]
        assert catalog.rows("select count(*) from estimates where not final")[0][0] >= batches - 1


def test_a_worker_that_cannot_follow_leaves_out_counts_and_keeps_living(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_module, "_MOST_BYTES", 100_000)
    with ZenohBus() as bus, DurablePublisher(bus) as publisher:
        worker = EstimationWorker(bus, publisher, estimators={"slow": lambda: SlowEstimator(1.0)})
        for i in range(300):
            publisher.send_batch(KEY, batch(i))
        time.sleep(0.2)
        publisher.send_batch(KEY, batch(300))
        deadline = time.monotonic() + 20
        while worker.counts.samples + worker.counts.lost < 301_000 and time.monotonic() < deadline:
            time.sleep(0.01)
            publisher.send_batch(KEY, batch(300))  # a duplicate, but for the first that finds room
        assert worker.counts.lost > 0
        assert worker.counts.samples + worker.counts.lost == 301_000
        worker.close()
        publisher.abandon()  # nobody records


@pytest.mark.long
def test_a_full_disk_is_told_at_once_and_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = SegmentWriter.sync
    syncs = iter(range(1000))
    is_full = True

    def fill_up(writer: SegmentWriter) -> None:
        if is_full and next(syncs) >= 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(writer)

    monkeypatch.setattr(SegmentWriter, "sync", fill_up)
    warnings: list[str] = []

    def warn(text: str) -> None:
        nonlocal is_full
        warnings.append(text)
        is_full = len(warnings) < 8

    with EmbeddedPipeline(tmp_path / "store", "test", on_warning=warn) as pipeline:
        for i in range(3000):
            pipeline.send_batch(KEY, batch(i))
        pipeline.finish()
    assert "No space left on device" in warnings[0]
    assert any("recording is paused" in text for text in warnings)
    assert any("resumes after a pause" in text for text in warnings)
    with Catalog(pipeline.store) as catalog:
        ((n, moments),) = catalog.rows("select count(*), count(distinct t_ns) from samples")
    assert n == moments == 3000 * 1000
