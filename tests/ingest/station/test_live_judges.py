"""Limits that nobody judges while a run is recorded: the run and its status say so."""

import time
from collections.abc import Callable

import numpy as np
import pytest

import ingest.station.run_limits as limits_module
from ingest.run.run_path import TroubleWatch, _listen
from ingest.station.run_limits import LimitReport
from storage.specifications.live_limits import UnitLimits
from stream.delivery.publisher import DurablePublisher
from stream.events import Verdict, VerdictGiven, encode_event
from stream.identity import Place, estimate_key, sample_key
from stream.transport.bus import LocalBus
from stream.transport.zenoh_bus import ZenohBus

PLACE = Place("plant", "c1")


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits_module, "_SILENT_S", 0.2)


def verdict(unit: str) -> VerdictGiven:
    return VerdictGiven(run="r1", t_ns=1, unit=unit, verdict=Verdict.PASS)


def test_a_record_without_estimates_is_named_until_one_comes() -> None:
    texts: list[str] = []
    decisions = LimitReport(texts.append, ["U1", "U2"])
    with DurablePublisher(LocalBus()) as publisher:
        watch = TroubleWatch(publisher, texts.append, lambda: decisions.silence)
        time.sleep(0.25)
        watch.look()
        assert texts == [], "no record has begun"
        decisions.begin_record(0)
        watch.look()
        assert texts == []
        time.sleep(0.25)
        watch.look()
        watch.look()
        (text,) = texts
        assert "the limits of 2 of them are not judged while they are recorded" in text
        assert "`gyrofleet estimate`" in text
        decisions.estimate_arrived()
        watch.look()
        assert texts[1:] == ["estimates of these units come"]
        time.sleep(0.25)
        decisions.see(verdict("U1"))
        assert "the limits of 1 of them" in str(decisions.silence)
        decisions.see(verdict("U2"))
        assert decisions.silence is None, "all of them are judged"


def test_a_run_whose_limits_are_judged_afterwards_or_here_waits_for_nobody() -> None:
    decisions = LimitReport(lambda _text: None)
    decisions.begin_record(0)
    time.sleep(0.25)
    assert decisions.silence is None


def test_estimates_of_the_runs_own_units_count(until: Callable[..., None]) -> None:
    heard: list[int] = []
    decided: list[object] = []
    with ZenohBus() as bus:
        _listen(bus, "r1", ["U1"], decided.append, lambda: heard.append(1))
        bus.publish(estimate_key(PLACE, "U2", "rate", "allan_deviation"), b"of another unit")
        bus.publish(sample_key(PLACE, "U1", "rate"), np.zeros(3).tobytes())
        bus.publish(estimate_key(PLACE, "U1", "rate", "allan_deviation"), b"")
        until(lambda: len(heard) == 1)
        bus.publish(estimate_key(PLACE, "U1", "rate", "verdict"), encode_event(verdict("U1"), "e", 0))
        until(lambda: len(decided) == 1)
        assert len(heard) == 2


def test_a_pass_names_the_limits_that_are_judged_after_the_run() -> None:
    texts: list[str] = []
    units = {unit: UnitLimits("FOG-A", (), after) for unit, after in (("U1", ("bias",)), ("U2", ()))}
    decisions = LimitReport(texts.append, (), units)
    for unit in units:
        decisions.see(verdict(unit))
    assert texts == [
        "unit U1: PASS by the live limits; open until the run is judged: bias",
        "unit U2: PASS by the live limits",
    ]
