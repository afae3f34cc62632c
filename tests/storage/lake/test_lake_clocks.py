"""Drift, offset and jumps of a source's clock from what arrival and source times say."""

from typing import Any
from uuid import UUID

import numpy as np
import pytest

from storage.sql.catalog import Catalog
from stream.batch import SampleBatch
from tests.storage.conftest import START_NS, Filler

COLUMNS = "drift_ppm, drift_uncertainty_ppm, offset_least_ns, backward_jumps, jumps, largest_jump_ns, stretches, reason"


def clocks(filler: Filler) -> dict[str, Any]:
    filler.seal()
    filler.build()
    with Catalog(filler.store) as catalog:
        ((*row,),) = catalog.rows(f"select {COLUMNS} from clocks")
    return dict(zip(COLUMNS.split(", "), row, strict=True))


def live(
    filler: Filler,
    minutes: int,
    ppm: float,
    *,
    jumps: dict[int, int] | None = None,
    pauses: dict[int, int] | None = None,
    seed: int = 1,
    seal_every: int = 300,
) -> None:
    """A signal at 100 Hz, a batch a second, sampled by a clock that is fast by `ppm`, delays of 1 to 20 ms.

    At the seconds of `jumps` the clock is set, at those of `pauses` sampling rests so long; both in ns.
    """
    rng = np.random.default_rng(seed)
    set_by_ns = rested_ns = 0
    for second in range(minutes * 60):
        set_by_ns += (jumps or {}).get(second, 0)
        rested_ns += (pauses or {}).get(second, 0)
        true_ns = second * 10**9 + rested_ns
        t0_ns = START_NS + round(true_ns * (1 + ppm * 1e-6)) + set_by_ns
        batch = SampleBatch(
            "U1", "rate", "r1", UUID(int=1), second * 100, t0_ns, 10**7, "deg/s", counts=np.zeros(100, np.int32)
        )
        delay_ns = round(rng.gamma(0.5, 5e6)) + 10**6
        filler.batch(batch, START_NS + true_ns + 990_000_000 + delay_ns)
        if second % seal_every == seal_every - 1:
            filler.seal()


@pytest.mark.long
@pytest.mark.parametrize("ppm", [50.0, -50.0, 0.0])
def test_drift_is_found_within_its_uncertainty(filler: Filler, ppm: float) -> None:
    live(filler, 40, ppm)
    found = clocks(filler)
    assert found["reason"] is None
    assert 0 < found["drift_uncertainty_ppm"] < 1
    assert abs(found["drift_ppm"] - ppm) < 4 * found["drift_uncertainty_ppm"] + 0.05
    assert (found["backward_jumps"], found["jumps"], found["largest_jump_ns"]) == (0, 0, None)


@pytest.mark.long
def test_jumps_are_found_and_do_not_look_like_drift(filler: Filler) -> None:
    live(filler, 40, 50.0, jumps={620: 5 * 10**9, 1500: -2 * 10**9}, pauses={1000: 30 * 10**9})
    found = clocks(filler)
    assert abs(found["drift_ppm"] - 50.0) < 4 * found["drift_uncertainty_ppm"] + 0.1
    assert (found["backward_jumps"], found["jumps"]) == (1, 2)
    assert abs(found["largest_jump_ns"] - 5 * 10**9) < 10**7


def test_messages_that_were_held_up_are_no_drift(filler: Filler) -> None:
    """The recorder was away for five minutes; what the source kept came in a burst."""
    rng = np.random.default_rng(3)
    for second in range(2400):
        batch = SampleBatch(
            "U1", "rate", "r1", UUID(int=1), second * 100, START_NS + second * 10**9, 10**7, "deg/s",
            counts=np.zeros(100, np.int32),
        )  # fmt: skip
        arrival_s = max(second + 1, 1200) if 900 <= second < 1200 else second + 1
        filler.batch(batch, START_NS + arrival_s * 10**9 + round(rng.gamma(0.5, 5e6)))
    found = clocks(filler)
    assert abs(found["drift_ppm"]) < 4 * found["drift_uncertainty_ppm"] + 0.1
    assert found["jumps"] == 0


def test_a_file_that_is_imported_has_no_drift_and_says_why(filler: Filler) -> None:
    for second in range(600):
        filler.counts("rate", START_NS + second * 10**9, 100, arrival_ns=START_NS + second * 10**6)
    found = clocks(filler)
    assert found["drift_ppm"] is None
    assert "arrived faster than it was sampled" in found["reason"]


def test_two_minutes_are_too_little(filler: Filler) -> None:
    live(filler, 1, 50.0)
    found = clocks(filler)
    assert found["drift_ppm"] is None
    assert "at least 3" in found["reason"]


def test_time_that_goes_back_within_a_message_is_counted(filler: Filler) -> None:
    times_ns = START_NS + np.arange(100, dtype=np.int64) * 10**7
    times_ns[60:] -= 3 * 10**8
    batch = SampleBatch(
        "U1", "rate", "r1", UUID(int=1), 0, START_NS, 10**7, "deg/s", values=np.zeros(100), times_ns=times_ns
    )
    filler.batch(batch)
    found = clocks(filler)
    assert (found["backward_jumps"], found["largest_jump_ns"]) == (1, -290_000_000)
