"""Recorders that stand still, a router that is gone, and a consumer that is slow: nothing is lost, and all catch up."""

import signal
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

RATE_HZ = 1000
UNITS = 2
SPEED = 75  # 150,000 samples a second; in the gate a fifteenth of them
SLOW = """
import sys, threading, time
from stream.transport.zenoh_bus import ZenohBus
seen = 0
def slow(key, payload):
    global seen
    seen += 1
    print(seen, flush=True)
    time.sleep(1.0)
with ZenohBus(connect=[sys.argv[1]]) as bus:
    bus.subscribe("gyrofleet/**", slow)
    print(seen, flush=True)
    threading.Event().wait()
"""


class Bench:
    """Stores, each with a recorder and a source of its own."""

    def __init__(self, gyrofleet: Any, start: Any, start_program: Any, free_endpoint: Any, folder: Path) -> None:
        self.gyrofleet = gyrofleet
        self.start = start
        self.start_program = start_program
        self.free_endpoint = free_endpoint
        self.speed = SPEED
        self._folder = folder

    def service(self, event: str, *arguments: object) -> Any:
        """A command in the background, once it says that it is ready."""
        service = self.start(*arguments, "--json")
        service.said(event)
        return service

    def source(self, store: str, endpoint: str, lasts_s: float, *, is_paced: bool = True) -> Any:
        """A run that lasts so long, or as many samples as fast as they go."""
        hours = lasts_s * self.speed / 3600
        return self.service(
            "running", "run-simulated", "--run", "r1", "--simulate", UNITS, "--rate-hz", RATE_HZ, "--hours", hours,
            "--speed", self.speed if is_paced else 0, "--store", self._folder / store, "--connect", endpoint,
        )  # fmt: skip

    def is_whole(self, store: str, lasts_s: float) -> None:
        """Every sample once, in a store that is sound."""
        (row,) = self.gyrofleet(
            "sql", "select count(*) as n, count(distinct (unit, t_ns)) as moments, count(distinct epoch) as epochs "
            "from samples where signal = 'rate'", "--json", "--store", store,
        ).json  # fmt: skip
        n = UNITS * RATE_HZ * round(lasts_s * self.speed)
        assert row == {"n": n, "moments": n, "epochs": UNITS}
        verified = self.gyrofleet("verify", "--json", "--store", store)
        assert verified.code == 0, verified.out


@pytest.fixture
def bench(
    gyrofleet: Callable[..., Any],
    start: Callable[..., Any],
    start_program: Callable[..., Any],
    free_endpoint: Callable[[], str],
    tmp_path: Path,
) -> Bench:
    return Bench(gyrofleet, start, start_program, free_endpoint, tmp_path)


def stall(bench: Bench, stall_s: float, lasts_s: float) -> float:
    """Stop a recorder in mid-run for so long; how much later than due its source has everything recorded."""
    store, endpoint = f"stalled-{stall_s:g}", bench.free_endpoint()
    record = bench.service("recording", "record", "--listen", endpoint, "--store", store)
    source = bench.source(store, endpoint, lasts_s)
    due = time.monotonic() + lasts_s
    time.sleep(1.5)
    record.send(signal.SIGSTOP)
    time.sleep(stall_s)
    assert source.process.poll() is None, "the run was to be caught in its middle"
    record.send(signal.SIGCONT)
    assert source.ended(90) == 0, source.errors
    late_s = time.monotonic() - due
    reported = source.said("ended")
    assert (reported["starts"], reported["gap_s"]) == (1, 0.0)
    record.stop()
    assert record.process.returncode == 0, record.errors
    return late_s


def lose_router(bench: Bench, gone_s: float, lasts_s: float) -> float:
    """Kill a router in mid-run, and start another so much later; how much later than due everything is recorded."""
    store, endpoint = "routed", bench.free_endpoint()
    router = bench.service("routing", "router", "--listen", endpoint)
    record = bench.service("recording", "record", "--connect", endpoint, "--store", store)
    source = bench.source(store, endpoint, lasts_s)
    due = time.monotonic() + lasts_s
    time.sleep(1.5)
    router.kill()
    time.sleep(gone_s)
    router = bench.service("routing", "router", "--listen", endpoint)
    assert source.ended(90) == 0, source.errors
    late_s = time.monotonic() - due
    assert source.said("ended")["starts"] == 1
    for service in (record, router):
        service.stop()
        assert service.process.returncode == 0, service.errors
    return late_s


# 6 s and 30 s are beyond the 5 s after which Zenoh by itself gives up
@pytest.mark.parametrize(
    ("stalls", "router", "speed"),
    [
        ({6.0: 9.0}, (6.0, 10.0), SPEED // 15),
        pytest.param({1.0: 5.0, 6.0: 11.0, 30.0: 36.0}, (10.0, 18.0), SPEED, marks=pytest.mark.long),
    ],
)
def test_stalls_of_a_recorder_and_the_loss_of_a_router_cost_nothing(
    bench: Bench, stalls: dict[float, float], router: tuple[float, float], speed: int
) -> None:
    bench.speed = speed
    with ThreadPoolExecutor(4) as pool:
        waiting = [pool.submit(stall, bench, stall_s, lasts_s) for stall_s, lasts_s in stalls.items()]
        waiting.append(pool.submit(lose_router, bench, *router))
        late = [each.result() for each in waiting]
    for stall_s, lasts_s in stalls.items():
        bench.is_whole(f"stalled-{stall_s:g}", lasts_s)
    bench.is_whole("routed", router[1])
    # caught up soon after the end that was due: a source asks at the latest 10 s after the last answer
    assert max(late) < 20.0, late


@pytest.mark.long
def test_a_slow_consumer_beside_a_recorder_does_not_hold_it_up(bench: Bench) -> None:
    lasts_s = 40.0  # at its pace: 6 M samples, sent as fast as they go

    def took(store: str, *, is_slow: bool) -> float:
        endpoint = bench.free_endpoint()
        record = bench.service("recording", "record", "--listen", endpoint, "--store", store, "--no-lake")
        consumer = bench.start_program(sys.executable, "-c", SLOW, endpoint) if is_slow else None
        if consumer is not None:
            consumer.until(lambda line: line == 0)
        began = time.monotonic()
        source = bench.source(store, endpoint, lasts_s, is_paced=False)
        assert source.ended(120) == 0, source.errors
        seconds = time.monotonic() - began
        record.stop()
        said = record.said("ended")
        assert said["samples"] == UNITS * (RATE_HZ + 1) * round(lasts_s * bench.speed)
        if consumer is not None:
            assert 0 < consumer.lines[-1] <= seconds + 3, "the consumer was to be slow"
            consumer.kill()
        return seconds

    alone_s = min(took(f"alone-{number}", is_slow=False) for number in range(2))
    beside_s = min(took(f"beside-{number}", is_slow=True) for number in range(2))
    assert beside_s < 1.5 * alone_s, (beside_s, alone_s)
