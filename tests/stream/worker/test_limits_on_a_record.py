"""Limits on one record of a run: what lies before and behind it does not count, and a new record replaces the first."""

import re
from uuid import UUID

import msgspec
import numpy as np
import pytest

from analytics.evaluation.reasons import in_chinese
from stream.batch import FloatArray, SampleBatch
from stream.estimators.base import default_estimators
from stream.events import (
    AnyDocument,
    Check,
    EarlyDecision,
    Limit,
    LimitsApplied,
    RunEnded,
    Verdict,
    VerdictGiven,
    encode_event,
)
from stream.identity import Place, event_key, sample_key
from stream.wire.batches import encode_batch
from stream.worker.checkpoint import Checkpoint
from stream.worker.estimation import Estimation

PLACE = Place("plant", "bench")
SECOND_NS = 10**9
RATE_HZ = 10
STABILITY = Limit(characteristic="bias_stability", signal="rate", tau_s=1.0, upper=0.6, unit_of_measure="deg/h")
ALLAN = Limit(characteristic="allan_deviation", signal="rate", tau_s=10.0, upper=0.3, unit_of_measure="deg/h")
RNG = np.random.default_rng(11)
QUIET: FloatArray = RNG.standard_normal(6000)  # 0.32 deg/h in averages of 1 s, 0.1 in those of 10 s
WARM_UP: FloatArray = np.linspace(500.0, 0.0, 3000)


class Worker:
    """The estimators of a worker, given messages one after the other."""

    def __init__(self) -> None:
        self.documents: list[AnyDocument] = []
        self.estimation = self._fresh()
        self._events = self._samples = 0

    def _fresh(self) -> Estimation:
        return Estimation(20 * SECOND_NS, default_estimators(), lambda _, document: self.documents.append(document))

    def send(self, document: AnyDocument) -> None:
        self.estimation.take(event_key(PLACE), encode_event(document, "e", self._events))
        self._events += 1

    def samples(self, values: FloatArray, unit: str = "U1") -> None:
        for start in range(0, len(values), 100):
            part = values[start : start + 100]
            t0_ns = (self._samples + start) * SECOND_NS // RATE_HZ
            batch = SampleBatch(
                unit, "rate", "r1", UUID(int=1), self._samples + start, t0_ns, SECOND_NS // RATE_HZ, "deg/h",
                values=part,
            )  # fmt: skip
            self.estimation.take(sample_key(PLACE, unit, "rate"), encode_batch(batch))
        self._samples += len(values)

    @property
    def now_ns(self) -> int:
        return self._samples * SECOND_NS // RATE_HZ

    def record(
        self, *limits: Limit, planned_s: float = 600.0, unit: str | None = "U1", since_ns: int | None = None
    ) -> None:
        """Limits on the record that begins now, or began."""
        now_ns = self.now_ns if since_ns is None else since_ns
        self.send(
            LimitsApplied(
                run="r1", t_ns=now_ns, revision="R", limits=limits, planned_s=planned_s, unit=unit, since_ns=now_ns
            )
        )

    def restart(self) -> None:
        """Resume from a checkpoint, as it is written."""
        packed = msgspec.msgpack.encode(self.estimation.checkpoint("s"))
        self.estimation = self._fresh()
        self.estimation.resume(msgspec.msgpack.decode(packed, type=Checkpoint))

    def verdict(self) -> VerdictGiven:
        self.send(RunEnded(run="r1", t_ns=self.now_ns))
        (found,) = [each for each in self.documents if isinstance(each, VerdictGiven)]
        return found

    def decided(self) -> list[EarlyDecision]:
        return [each for each in self.documents if isinstance(each, EarlyDecision) and each.outcome != "UNDECIDED"]


def test_a_warm_up_before_the_record_fails_no_unit() -> None:
    worker = Worker()
    worker.samples(WARM_UP)
    worker.record(STABILITY, ALLAN)
    worker.samples(QUIET)
    worker.samples(WARM_UP)  # what the unit does when the record is over
    verdict = worker.verdict()
    assert verdict.verdict is Verdict.PASS
    assert [check.value for check in verdict.checks] == pytest.approx([0.32, 0.1], rel=0.3)
    assert {each.outcome for each in worker.decided()} == {"PASS"}
    assert all(each.t_ns >= 300 * SECOND_NS for each in worker.decided())


def test_a_finished_record_that_lacks_samples_is_not_decided_as_passed() -> None:
    """A seventh of it is missing: the verdict is MARGINAL, and no decision says otherwise."""
    worker = Worker()
    worker.record(STABILITY)  # which passes at the end alone
    worker.samples(QUIET[:4000])
    worker._samples += 850
    worker.samples(QUIET[4850:])
    worker.samples(QUIET[:10])
    (check,) = worker.verdict().checks
    assert check.verdict is Verdict.MARGINAL
    assert "85.8 % of the samples of 10 min are there" in (check.reason or "")
    assert "85.8 %" in in_chinese(check.reason or "")
    assert worker.decided() == []


def test_the_same_run_is_failed_where_the_limits_are_on_all_of_it() -> None:
    worker = Worker()
    worker.send(LimitsApplied(run="r1", t_ns=0, revision="R", limits=(STABILITY,), planned_s=900.0))
    worker.samples(WARM_UP)
    worker.samples(QUIET)
    assert worker.verdict().verdict is Verdict.FAIL


def test_a_record_out_of_limits_fails_before_its_end() -> None:
    worker = Worker()
    worker.samples(WARM_UP)
    worker.record(STABILITY)
    worker.samples(4.0 * QUIET)
    first = worker.decided()[0]
    assert (first.outcome, first.rule, first.unit) == ("FAIL", "curtailed", "U1")
    assert 0.1 < first.looked_at_fraction < 0.5  # (0.6/1.26)**2 = 0.23 of the record
    assert worker.verdict().verdict is Verdict.FAIL


def test_a_record_that_is_begun_again_replaces_the_first() -> None:
    worker = Worker()
    worker.record(STABILITY)
    worker.samples(WARM_UP[:1000])
    assert worker.decided()[-1].outcome == "FAIL"
    worker.record(STABILITY)
    worker.samples(QUIET)
    assert worker.verdict().verdict is Verdict.PASS
    assert worker.decided()[-1].outcome == "PASS"


def test_limits_apply_to_the_unit_that_they_name() -> None:
    worker = Worker()
    worker.record(STABILITY, unit="U2")
    worker.samples(4.0 * QUIET)
    verdict = worker.verdict()
    assert (verdict.unit, verdict.verdict) == ("U2", Verdict.NO_DATA)
    assert verdict.checks[0].reason == "no bias_stability_1s of signal rate was published"
    assert worker.decided() == []


@pytest.mark.parametrize("late_s", [1.0, 7.0, 60.0, 400.0])
@pytest.mark.parametrize("is_restarted", [False, True])
@pytest.mark.parametrize("is_second", [False, True], ids=["first record", "begun again"])
@pytest.mark.in_gate("begun again-True-7.0", "first record-False-1.0")
def test_limits_that_come_after_samples_of_their_record_are_on_the_whole_of_it(
    late_s: float, is_restarted: bool, is_second: bool
) -> None:
    """A recorder passes samples and documents on in no order; at a hundred times real time a second is 100 s."""

    def checks(late_s: float) -> list[Check]:
        worker, late = Worker(), round(late_s * RATE_HZ)
        if is_second:
            worker.record(STABILITY, ALLAN)
        worker.samples(WARM_UP)
        since_ns = worker.now_ns
        worker.samples(QUIET[:late])
        if is_restarted:
            worker.restart()
        worker.record(STABILITY, ALLAN, since_ns=since_ns)
        worker.samples(QUIET[late:])
        return list(worker.verdict().checks)

    assert checks(late_s) == checks(0.0)


@pytest.mark.parametrize("is_restarted", [False, True])
def test_limits_that_come_too_late_for_the_start_of_their_record_say_so(is_restarted: bool) -> None:
    worker = Worker()
    worker.samples(WARM_UP)
    since_ns = worker.now_ns
    worker.samples(QUIET[:5000])
    if is_restarted:
        worker.restart()
    worker.record(STABILITY, ALLAN, since_ns=since_ns)
    if is_restarted:
        worker.restart()
    worker.samples(QUIET[5000:])
    checks = worker.verdict().checks
    assert [check.verdict for check in checks] == [Verdict.PASS] * 2
    (unseen,) = {check.reason or "" for check in checks}
    assert (said := re.fullmatch(r"the first (\S+) s of 600 s \(0.1\d of the record\) are not judged: .*", unseen))
    # 4096 samples are kept of 5000, at 10 a second; those of up to 20 s wait to be taken in and are not among the 5000
    assert 70.4 <= float(said[1]) <= 90.4
    assert unseen not in in_chinese(unseen)
    looks = [each for each in worker.documents if isinstance(each, EarlyDecision)]
    assert looks
    assert all(each.reason.endswith(unseen) and "未参与判定" in each.reason_zh for each in looks)


@pytest.mark.long
@pytest.mark.parametrize("at", [0, 1500, 3000, 4500, 8000])
def test_a_worker_that_resumes_gives_the_same_documents(at: int) -> None:
    def run(worker: Worker, *, is_interrupted: bool) -> list[bytes]:
        values = np.concatenate([WARM_UP, QUIET])
        sent = 0
        for stop in sorted({at, 3000, len(values)}):
            worker.samples(values[sent:stop])
            sent = stop
            if stop == 3000:
                worker.record(STABILITY, ALLAN)
            if stop == at and is_interrupted:
                worker.restart()
        worker.verdict()
        return [
            msgspec.json.encode(each) for each in worker.documents if isinstance(each, EarlyDecision | VerdictGiven)
        ]

    whole = run(Worker(), is_interrupted=False)
    assert len(whole) > 20
    assert run(Worker(), is_interrupted=True) == whole
