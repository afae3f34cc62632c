"""An output that stands still passes nothing while it flows: neither early nor at the end of its run."""

import msgspec
import numpy as np
import pytest

from stream.events import EarlyDecision, LimitsApplied, Verdict, VerdictGiven
from stream.worker.early_decisions import EarlyDecisions
from tests.stream import worker_runs
from tests.stream.worker_runs import LIMITS, STARTS, VALUES, batch, run


def frozen_from(monkeypatch: pytest.MonkeyPatch, sample: int) -> None:
    values = VALUES.copy()
    values[sample:] = values[min(sample, len(values) - 1)]
    monkeypatch.setattr(worker_runs, "VALUES", values)


@pytest.mark.parametrize(
    ("sample", "verdict"), [(60_000, Verdict.PASS), (0, Verdict.NO_DATA), (20_000, Verdict.MARGINAL)]
)
def test_a_frozen_output_passes_no_limit(monkeypatch: pytest.MonkeyPatch, sample: int, verdict: Verdict) -> None:
    """Of 600 s at 100 Hz; the three limits are far above the noise, so that a whole record passes."""
    frozen_from(monkeypatch, sample)
    monkeypatch.setattr(worker_runs, "LIMITS", LIMITS[1:4])
    found, _ = run(None, [STARTS])
    (given,) = [each for each in found if isinstance(each, VerdictGiven)]
    assert given.verdict is verdict
    looks = [each for each in found if isinstance(each, EarlyDecision)]
    passed_s = {each.limit: each.looked_at_fraction * 600.0 for each in looks if each.outcome == "PASS"}
    assert len(passed_s) == {Verdict.PASS: 3, Verdict.NO_DATA: 0, Verdict.MARGINAL: 2}[verdict]
    assert verdict is not Verdict.MARGINAL or max(passed_s.values()) < 200.0, "before it froze"
    if verdict is not Verdict.PASS:
        assert all("samples" in (check.reason or "") and "alike" in (check.reason or "") for check in given.checks)
        assert any("相同" in each.reason_zh for each in looks)


def test_a_frozen_output_fails_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Squares can only grow: what it was before it froze is above the limit whatever comes."""
    frozen_from(monkeypatch, 50_000)
    found, _ = run(None, [STARTS])
    outcomes = {
        each.limit: each.outcome for each in found if isinstance(each, EarlyDecision) and each.outcome != "UNDECIDED"
    }
    assert outcomes[LIMITS[0]] == "FAIL"
    assert "PASS" not in {outcomes.get(limit) for limit in LIMITS[3:4]}


def test_the_stretch_goes_on_after_a_restart(monkeypatch: pytest.MonkeyPatch) -> None:
    frozen_from(monkeypatch, 1000)
    decisions = EarlyDecisions("rate")
    decisions.apply(LimitsApplied(run="r1", t_ns=0, revision="R", limits=LIMITS[1:2], planned_s=600.0))
    for start in STARTS[:10]:
        decisions.update(batch(start))
        state = msgspec.msgpack.decode(msgspec.msgpack.encode(decisions.export_state()))
        decisions = EarlyDecisions.from_state("rate", state)
    assert (decisions.still.longest, decisions.still.samples) == (4000, 5000)


def test_noise_of_one_count_is_not_still(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_runs, "VALUES", np.rint(VALUES))
    monkeypatch.setattr(worker_runs, "LIMITS", LIMITS[1:4])
    found, _ = run(None, [STARTS])
    assert [each.verdict for each in found if isinstance(each, VerdictGiven)] == [Verdict.PASS]
