"""A unit that falls silent while a step records is named while it lasts."""

import time
from uuid import UUID

import numpy as np
import pytest

from ingest.station.checks.step_coverage import StepCoverage
from stream.batch import SampleBatch


def batch(unit: str, dt_ns: int = 10_000_000) -> SampleBatch:
    return SampleBatch(unit, "rate", "r1", UUID(int=1), 0, 0, dt_ns, "deg/s", values=np.zeros(9))


def test_silence_counts_while_a_step_records(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [1000.0]
    monkeypatch.setattr("ingest.station.checks.step_coverage.time.monotonic", lambda: clock[0])
    coverage = StepCoverage(["A", "B", "SLOW"])
    for unit in ("A", "B"):
        coverage.see(batch(unit))
    coverage.see(batch("SLOW", 60_000_000_000))
    clock[0] += 100.0
    assert coverage.silent() == {}  # nothing records
    coverage.watch(is_recording=True)
    clock[0] += 9.0
    coverage.see(batch("A"))
    clock[0] += 9.0
    assert coverage.silent() == {"B": 18.0}
    coverage.see(batch("B"))
    assert coverage.silent() == {}
    clock[0] += 15.0
    coverage.release("A")
    assert coverage.silent() == {"B": 15.0}
    assert coverage.silent(speed=60.0) == {"B": 15.0, "SLOW": 33.0}
    coverage.watch(is_recording=False)
    assert coverage.silent() == {}
    assert time.monotonic() == clock[0]
