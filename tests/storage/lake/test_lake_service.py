"""The builder as a command of its own, and what its files take and keep."""

import json
import subprocess
import time
from collections.abc import Callable
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from storage.lake.buffered_rows import counts_columns
from storage.lake.builder import builder_lock
from storage.lake.rollups import joined, roll_up
from storage.manifests.lake import read_manifest
from storage.sql.catalog import Catalog
from storage.upkeep.service import LakeService
from stream.batch import SampleBatch
from stream.terminal.console import Stop
from tests.conftest import Outcome
from tests.storage.conftest import START_NS, Filler


def test_the_service_builds_what_is_sealed_while_it_runs(
    filler: Filler, spawn: Callable[..., "subprocess.Popen[str]"], gyrofleet: Callable[..., Outcome]
) -> None:
    store = filler.store
    process = spawn("lake", "--store", store.folder, "--json")
    try:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["event"] == "building"
        refused = gyrofleet("lake", "--once", "--store", store.folder)
        assert (refused.code, "another builder of the lake is at work" in refused.err) == (1, True)
        for i in range(3):
            now_ns = time.time_ns()
            filler.counts("rate", START_NS + i * 10**9, 100, arrival_ns=now_ns)
            filler.seal()
            reported = json.loads(process.stdout.readline())
            assert (reported["event"], reported["segment"]) == ("segment", f"{i + 1:08d}")
    finally:
        process.terminate()
        out, _ = process.communicate(timeout=30)
    assert json.loads(out.splitlines()[-1])["event"] == "ended"
    assert process.returncode == 0
    assert [part.samples for part in read_manifest(store).parts] == [100] * 3


def test_a_damaged_segment_is_reported_and_holds_up_no_other(filler: Filler, gyrofleet: Callable[..., Outcome]) -> None:
    for i in range(3):
        filler.counts("rate", START_NS + i * 10**9, 100)
        filler.seal()
    segment = filler.store.log / "00000002.mcap"
    content = bytearray(segment.read_bytes())
    content[len(content) // 3] ^= 0xFF
    segment.write_bytes(content)
    done = gyrofleet("lake", "--once", "--store", filler.store.folder, "--json")
    assert done.code == 1
    events = [json.loads(line) for line in done.out.splitlines()]
    assert [each["what"] for each in events if each.get("event") == "problem"] == ["00000002"]
    with builder_lock(filler.store):
        held = {segment for part in read_manifest(filler.store).parts for segment in part.segments}
    assert held == {"00000001", "00000003"}


def test_what_failed_is_a_trouble_until_it_works(filler: Filler) -> None:
    filler.counts("rate", START_NS, 100)
    filler.seal()
    segment = filler.store.log / "00000001.mcap"
    content = segment.read_bytes()
    damaged = bytearray(content)
    damaged[len(content) // 3] ^= 0xFF
    segment.write_bytes(damaged)
    service = LakeService(filler.store, report=lambda *_parts, **_numbers: None)
    assert len(service.round(Stop())) == 1
    assert service.round(Stop()) == [], "it is tried again in a minute"
    assert "00000001" in service.status().trouble
    segment.write_bytes(content)
    service._failed["00000001"] = float("-inf")
    assert service.round(Stop()) == []
    assert service.status().trouble == ""


def test_noise_in_counts_takes_hardly_more_than_its_entropy(filler: Filler) -> None:
    """White noise of 50 counts has an entropy of 0.96 bytes a sample."""
    for _ in range(20):
        filler.counts("rate", START_NS + filler._next.get("rate", 0) * 10**6, 10_000, dt_ns=10**6)
    filler.seal()
    filler.build()
    (part,) = read_manifest(filler.store).parts
    assert part.files["samples.parquet"].bytes < 1.05 * part.samples
    assert part.bytes < 1.2 * part.samples  # with rollups, and what does not grow with the samples


@given(
    st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=50).map(lambda x: np.repeat(x, 300)),
    st.integers(0, 3),
)
@settings(max_examples=60, deadline=None)
def test_counts_of_any_size_come_back(levels: np.ndarray[tuple[int], np.dtype[np.int64]], spread: int) -> None:
    noise = np.random.default_rng(1).integers(-(10**spread), 10**spread + 1, len(levels))
    counts = np.clip(levels + noise, -(2**31), 2**31 - 1).astype(np.int32)
    base, above = (column.to_numpy().astype(np.int64) for column in counts_columns(counts))
    assert np.array_equal(base + above, counts)


def test_a_ramp_takes_nothing() -> None:
    base, above = counts_columns(np.arange(0, 3_000_000, 300, dtype=np.int32))
    assert np.all(above.to_numpy() == 0)
    assert np.all(np.diff(base.to_numpy()) == 300)


@pytest.mark.parametrize("seed", range(5))
def test_buckets_merged_in_any_pieces_are_those_of_the_whole(seed: int) -> None:
    rng = np.random.default_rng(seed)
    t_ns = np.cumsum(rng.integers(1, 2 * 10**8, 2000)) - 10**11
    values = rng.normal(1e6, 1.0, 2000)
    values[rng.random(2000) < 0.05] = np.nan
    whole = roll_up(t_ns, values)
    assert np.all(whole.n > 0)
    assert np.all(np.isfinite(whole.mean))
    cuts = np.sort(rng.integers(0, 2000, 7))
    pieces = [roll_up(t, v) for t, v in zip(np.split(t_ns, cuts), np.split(values, cuts), strict=True) if len(t)]
    merged = joined(pieces)
    for name in ("bucket", "n", "lo", "hi"):
        assert np.array_equal(getattr(merged, name), getattr(whole, name))
    assert np.allclose(merged.mean, whole.mean, rtol=1e-14)
    # squares about the mean, though the mean is a million standard deviations
    assert np.allclose(merged.m2, whole.m2, rtol=1e-6, atol=1e-8)


def test_two_epochs_and_a_clock_set_back_share_their_buckets(filler: Filler) -> None:
    """Buckets in the middle of one segment are in that of another: put together all the same."""
    for epoch, t0_ns in ((1, START_NS), (2, START_NS + 5 * 10**8), (3, START_NS)):
        values = filler.rng.normal(0, 1, 5000)
        filler.batch(SampleBatch("U1", "rate", "r1", UUID(int=epoch), 0, t0_ns, 10**7, "deg/s", values=values))
        filler.seal()
    filler.build()
    with Catalog(filler.store) as catalog:
        rows = catalog.rows("select t_ns // 1000000000 as b, n, mean, stddev, lo, hi from rollup_1s order by b")
        samples = catalog.rows(
            "select t_ns // 1000000000 as b, count(*), avg(value), stddev(value), min(value), max(value) "
            "from samples group by b order by b"
        )
    assert len(rows) == 51
    assert np.allclose(np.array(rows, float), np.array(samples, float), rtol=1e-12)
