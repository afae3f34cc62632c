"""Step records against NumPy on samples: short steps exactly, long ones over whole seconds, and how they are kept."""

import math
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import numpy.typing as npt
import pyarrow.parquet as pq
import pytest
from scipy import stats

from analytics.step_records.evaluated_signal import MOST_RAW
from analytics.step_records.series_statistics import series_statistics
from analytics.step_records.step_table import step_means
from storage.lake.builder import builder_lock
from storage.lake.lake import Lake
from storage.segments.records import SAMPLES, LogRecord
from storage.store import Store
from stream.batch import SampleBatch
from stream.events import StepEnded, StepStarted, StepWords
from stream.identity import Place, sample_key
from stream.wire.batches import encode_batch

START_NS = 1_763_683_200 * 10**9  # 2025-11-21 00:00 UTC
SECOND_NS = 10**9
DT_NS = 10**8
Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


def exact(value: Any) -> Any:
    return pytest.approx(value, rel=1e-9, abs=0)


def records(tested: Any) -> list[dict[str, Any]]:
    with tested.catalog() as catalog:
        rows: list[dict[str, Any]] = step_means(catalog).to_pylist()
    return rows


def one(tested: Any) -> dict[str, Any]:
    rows = records(tested)
    assert len(rows) == 1
    return rows[0]


def put(tested: Any, t_ns: Ints, values: Floats, *, counts: bool = False, scale: float = 1.0) -> None:
    """Samples at their own times."""
    data: dict[str, Any] = {"values": values, "irregular": True}
    if counts:
        data = {"counts": values.astype(np.int32), "scale": scale}
    batch = SampleBatch("U1", "rate", "r1", uuid4(), 0, int(t_ns[0]), DT_NS, "deg/h", times_ns=t_ns, **data)
    key = sample_key(Place("plant", "station-1"), batch.unit, batch.signal)
    tested._append(LogRecord(key, SAMPLES, batch.last_ns + 10**6, batch.t0_ns, encode_batch(batch)))


def step(tested: Any, from_ns: int, to_ns: int, *, outcome: str = "completed", **words: Any) -> None:
    begun = StepStarted(run="r1", t_ns=from_ns, unit="U1", words=StepWords(**words))
    tested.document(begun)
    tested.document(StepEnded(run="r1", t_ns=to_ns, unit="U1", step_uid=begun.uid, outcome=outcome))


def holds(row: dict[str, Any], values: Floats) -> None:
    assert row["n"] == len(values)
    assert row["mean"] == exact(values.mean())
    assert row["sd"] == exact(values.std(ddof=1))


def scatter_of(t_ns: Ints, values: Floats, average_s: int, bounds_ns: tuple[int, int], dt_ns: int) -> tuple[int, float]:
    """How many means of whole `average_s` of the source's clock lie in the bounds, and their deviation."""
    number = t_ns // (average_s * SECOND_NS)
    means = [
        values[number == each].mean()
        for each in np.unique(number)
        if each * average_s * SECOND_NS >= bounds_ns[0]
        and (each + 1) * average_s * SECOND_NS <= bounds_ns[1] + dt_ns
        and np.count_nonzero(number == each) >= 0.9 * average_s * SECOND_NS / dt_ns
    ]
    return len(means), float(np.std(means, ddof=1)) if len(means) > 1 else math.nan


def drifting(rng: np.random.Generator, n: int) -> Floats:
    return np.asarray(rng.normal(12.5, 3.0, n) + np.cumsum(rng.normal(0, 0.02, n)), np.float64)


@pytest.mark.long
@pytest.mark.parametrize("offset_ns", [0, 250_000_000])
def test_a_short_step_is_that_of_its_samples(tested: Any, offset_ns: int) -> None:
    values = drifting(np.random.default_rng(1), 3000)
    t_ns = START_NS + offset_ns + DT_NS * np.arange(3000)
    tested.run("r1")
    tested.samples("r1", "U1", "rate", values, t0_ns=int(t_ns[0]))
    settle, first, last = 12.35, int(t_ns[100]), int(t_ns[2899])
    step(tested, first, last, settle_s=settle)
    within = (t_ns >= first + round(settle * 1e9)) & (t_ns <= last)
    row = one(tested)
    holds(row, values[within])
    bounds = (first + round(settle * 1e9), last)
    for average_s in (1, 10, 100):
        n, sd = scatter_of(t_ns[within], values[within], average_s, bounds, DT_NS)
        assert (row[f"n_{average_s}s"], row[f"sd_{average_s}s"]) == (n, exact(sd) if n > 1 else None)
    assert row["duration_s"] == exact((bounds[1] - bounds[0]) / 1e9)


@pytest.mark.long
@pytest.mark.parametrize("ends_early_ns", [0, 1, DT_NS, 350_000_000])
def test_a_long_step_is_that_of_the_whole_seconds_within_it(tested: Any, ends_early_ns: int) -> None:
    n = MOST_RAW + 4000
    values = drifting(np.random.default_rng(2), n)
    t_ns = START_NS + 300_000_000 + DT_NS * np.arange(n)
    tested.run("r1")
    tested.samples("r1", "U1", "rate", values, t0_ns=int(t_ns[0]))
    first, last = int(t_ns[0]) + 4, int(t_ns[-1]) - ends_early_ns
    step(tested, first, last)
    second = t_ns // SECOND_NS * SECOND_NS
    within = (second >= first) & (second <= last + DT_NS - SECOND_NS)
    row = one(tested)
    holds(row, values[within])
    assert row["n"] == 10 * len(np.unique(second[within])) == 10 * row["whole_seconds"]
    for average_s in (1, 10, 100):
        found = (row[f"n_{average_s}s"], row[f"sd_{average_s}s"])
        of_samples = scatter_of(t_ns[within], values[within], average_s, (first, last), DT_NS)
        assert found == (of_samples[0], exact(of_samples[1]))


def test_a_long_step_that_ends_with_a_second_has_it(tested: Any) -> None:
    n = MOST_RAW + 10
    values = drifting(np.random.default_rng(3), n)
    tested.run("r1")
    tested.step("r1", "U1", values, t0_ns=START_NS)
    holds(one(tested), values)
    assert one(tested)["whole_seconds"] == n // 10  # and as many samples: nothing is left out


def test_a_gap_takes_its_averages_and_nothing_else(tested: Any) -> None:
    values = drifting(np.random.default_rng(4), 1000)
    t_ns = START_NS + DT_NS * np.arange(1000)
    there = np.ones(1000, bool)
    there[123:147] = False  # two of the seconds keep 3 and 3 of 10 samples
    tested.run("r1")
    tested.samples("r1", "U1", "rate", values[:123], t0_ns=START_NS)
    tested.samples("r1", "U1", "rate", values[147:], t0_ns=int(t_ns[147]))
    step(tested, START_NS, int(t_ns[-1]))
    row = one(tested)
    holds(row, values[there])
    of_samples = scatter_of(t_ns[there], values[there], 1, (START_NS, int(t_ns[-1])), DT_NS)
    assert of_samples[0] == 97
    assert (row["n_1s"], row["sd_1s"]) == (97, exact(of_samples[1]))


def test_irregular_samples_count_by_whole_seconds(tested: Any) -> None:
    rng = np.random.default_rng(5)
    t_ns = START_NS + np.sort(rng.choice(600 * 1000, 4000, replace=False)) * 1_000_000
    values = drifting(rng, 4000)
    tested.run("r1")
    put(tested, t_ns, values)
    first, last = START_NS + SECOND_NS // 2, START_NS + 600 * SECOND_NS
    step(tested, first, last)
    row = one(tested)
    second = t_ns // SECOND_NS * SECOND_NS
    within = (second >= first) & (second < last - SECOND_NS + DT_NS)
    holds(row, values[within])


def test_an_output_that_stands_on_one_count_is_known_to_its_step(tested: Any) -> None:
    t_ns = START_NS + DT_NS * np.arange(1000)
    tested.run("r1")
    put(tested, t_ns, np.full(1000, 7.0), counts=True, scale=0.5)
    step(tested, START_NS, int(t_ns[-1]))
    row = one(tested)
    assert (row["n"], row["mean"], row["sd"]) == (1000, 3.5, 0.0)
    assert row["standard_uncertainty"] == exact(0.5 / math.sqrt(12))


def test_one_sample_and_none(tested: Any) -> None:
    tested.run("r1")
    tested.samples("r1", "U1", "rate", np.array([4.0]), t0_ns=START_NS)
    step(tested, START_NS - SECOND_NS, START_NS + SECOND_NS)
    step(tested, START_NS + 2 * SECOND_NS, START_NS + 3 * SECOND_NS)
    single, empty = records(tested)
    assert (single["n"], single["mean"], single["sd"], single["standard_uncertainty"]) == (1, 4.0, None, None)
    assert (empty["n"], empty["mean"]) == (0, None)
    assert empty["reason"] == "no sample in the evaluated part of the step"


def test_steps_that_overlap_are_each_that_of_their_samples_and_those_cut_short_are_none(tested: Any) -> None:
    values = drifting(np.random.default_rng(6), 600)
    t_ns = START_NS + DT_NS * np.arange(600)
    tested.run("r1")
    tested.samples("r1", "U1", "rate", values, t0_ns=START_NS)
    step(tested, int(t_ns[0]), int(t_ns[399]), position="IRA_up")
    step(tested, int(t_ns[200]), int(t_ns[599]), position="IRA_down")
    step(tested, int(t_ns[300]), int(t_ns[500]), outcome="aborted")
    tested.document(StepStarted(run="r1", t_ns=int(t_ns[550]), unit="U1", words=StepWords()))
    up, down = records(tested)
    holds(up, values[:400])
    holds(down, values[200:])
    assert (up["position"], up["index"], down["position"], down["index"]) == ("IRA_up", 1, "IRA_down", 2)


@pytest.mark.long
def test_where_raw_rows_were_let_go_the_whole_seconds_tell_the_same(tested: Any) -> None:
    values = drifting(np.random.default_rng(7), 600)
    tested.run("r1")
    tested.step("r1", "U1", values, t0_ns=START_NS)
    before = one(tested)
    with builder_lock(tested.store):
        lake = Lake(tested.store)
        lake.drop_raw(dict.fromkeys(sorted(lake.manifest.segments), "uid"))
    after = one(tested)
    holds(after, values)
    for name in ("n_1s", "n_10s"):
        assert after[name] == before[name]
    for name in ("sd_1s", "sd_10s"):
        assert after[name] == exact(before[name])
    # of the same record, from samples and from seconds: each says how far another such record's mean would lie, and how
    # well it knows that
    ratio = after["standard_uncertainty"] / before["standard_uncertainty"]
    f = stats.f(after["freedom"], before["freedom"])
    assert f.ppf(0.025) < ratio**2 < f.ppf(0.975)


def test_a_run_of_an_unknown_date_is_reduced_alike(tested: Any) -> None:
    values = drifting(np.random.default_rng(8), 300)
    tested.run("r1", t_ns=0, date_known=False)
    tested.step("r1", "U1", values, t0_ns=0)
    row = one(tested)
    holds(row, values)
    assert row["n_1s"] == 30


_KILLED = """
import os, signal, sys
from pathlib import Path
from analytics.step_records import step_table
from storage.sql.catalog import Catalog
from storage.store import Store

def die(*_, **__):
    os.kill(os.getpid(), signal.SIGKILL)

write = Path.write_bytes
def half(path, content):
    write(path, content[: len(content) // 2])
    die()

if sys.argv[2] == "half":
    Path.write_bytes = half
else:
    Path.replace = die
with Catalog(Store.open(Path(sys.argv[1]))) as catalog:
    step_table.step_means(catalog)
"""


@pytest.mark.long
@pytest.mark.parametrize("moment", ["half", "whole"])
def test_a_kill_while_the_records_are_written_leaves_the_old_ones_or_none(tested: Any, moment: str) -> None:
    tested.run("r1")
    tested.step("r1", "U1", drifting(np.random.default_rng(9), 200), t0_ns=START_NS)
    before = one(tested)
    path = Path(tested.store.folder) / "metrics" / "steps.parquet"
    kept = path.read_bytes()
    tested.step("r1", "U1", drifting(np.random.default_rng(10), 200), t0_ns=START_NS + 100 * SECOND_NS)
    tested.catalog().close()
    command = [sys.executable, "-c", _KILLED, str(tested.store.folder), moment]
    done = subprocess.run(command, capture_output=True, timeout=120)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert path.read_bytes() == kept
    first, second = records(tested)
    assert first == before | {"fingerprint": second["fingerprint"]}
    assert pq.read_table(path).num_rows == 2
    assert Store.open(tested.store.folder).identity == tested.store.identity


@pytest.mark.long
def test_more_samples_of_white_noise_tell_the_mean_better() -> None:
    rng = np.random.default_rng(21)
    sizes = (5, 8, 10, 12, 16, 20, 24, 30, 48, 64, 100)
    medians = []
    for n in sizes:
        t_ns = np.arange(n) * SECOND_NS
        found = [
            series_statistics(
                t_ns, np.ones(n, int), rng.standard_normal(n), np.zeros(n), base_ns=SECOND_NS, samples_per_block=1.0,
                window_ns=(0, n * SECOND_NS),
            )
            for _ in range(400)
        ]  # fmt: skip
        medians.append(np.sqrt(np.mean([each.standard_uncertainty**2 for each in found])))
        # the truth is 0: 95 % of 400 less four standard deviations of the binomial
        half = [stats.t.ppf(0.975, each.freedom) * each.standard_uncertainty for each in found]
        held = sum(abs(each.mean) <= h for each, h in zip(found, half, strict=True))
        assert held > 400 * 0.95 - 4 * np.sqrt(400 * 0.95 * 0.05)
    # neighbours may differ by chance: 5 % is two standard deviations of the root mean square of 400
    assert all(b < a * 1.05 for a, b in pairwise(medians)), dict(zip(sizes, medians, strict=True))
    assert medians[5] < medians[2]


@pytest.mark.parametrize(("sd", "step", "is_still"), [(0.15, 1.0, False), (0.15, 0.0, True), (2.0, 1.0, False)])
def test_a_coarse_resolution_is_no_output_that_stood_still(sd: float, step: float, is_still: bool) -> None:
    values = np.round(np.random.default_rng(1).normal(100.0, sd, 36_000))
    t_ns = np.arange(values.size) * 100_000_000
    found = series_statistics(
        t_ns, np.ones(values.size, np.int64), values, np.zeros(values.size), base_ns=100_000_000, samples_per_block=1.0,
        window_ns=(0, int(t_ns[-1])), step=step,
    )  # fmt: skip
    assert (found.still >= 0.05) == is_still
