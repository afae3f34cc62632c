"""Subscriptions that end while messages arrive, and keys under which so much is sent that they have a publisher."""

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path

import pytest

from stream.transport.zenoh_bus import ZenohBus
from tests.secured_sites import make_site, session

KEY, OTHER = "gyrofleet/plant/c1/U1/rate", "gyrofleet/plant/c2/U1/rate"


def test_a_subscription_ends_while_messages_arrive() -> None:
    """No thread of it fails, which the handler of unhandled exceptions would turn into a failure of this test."""
    received = [0]

    def count(_key: str, _payload: bytes) -> None:
        received[0] += 1

    with ZenohBus() as bus:
        over = threading.Event()

        def publish() -> None:
            while not over.is_set():
                bus.publish("gyrofleet/test", b"x")

        publisher = threading.Thread(target=publish)
        publisher.start()
        try:
            for subscription in range(1, 101):
                bus.subscribe("gyrofleet/test", count)
                while received[0] < 20 * subscription:
                    over.wait(0.0005)
                bus.unsubscribe("gyrofleet/test")
        finally:
            over.set()
            publisher.join()


@pytest.mark.parametrize("is_secured", [False, True])
def test_what_is_sent_often_arrives_in_order_also_after_the_listener_has_started_again(
    tmp_path: Path, endpoint: str, *, is_secured: bool
) -> None:
    site = tmp_path / "site"
    if is_secured:
        make_site(site)

    def opened(who: str, listen: str | None = None, connect: str | None = None) -> AbstractContextManager[ZenohBus]:
        if is_secured:
            return session(site, who, listen=listen, connect=connect)
        return ZenohBus([listen] if listen else [], [connect] if connect else [])

    received: list[int] = []
    with ExitStack() as stack:
        with opened("recorder:recorder", listen=endpoint) as listener:
            listener.subscribe("gyrofleet/**", lambda _key, payload: received.append(int(payload)))
            source = stack.enter_context(opened("station:c1", connect=endpoint))
            _send_until(source, 0, lambda: bool(received))
            for number in range(1000, 3000):
                source.publish(KEY, str(number).encode())
            _wait_for(lambda: received[-1] == 2999)
            assert received[received.index(1000) :] == list(range(1000, 3000))
        received.clear()
        with opened("recorder:recorder", listen=endpoint) as again:
            again.subscribe("gyrofleet/**", lambda _key, payload: received.append(int(payload)))
            _send_until(source, 3000, lambda: bool(received))


def test_no_right_comes_of_sending_often(tmp_path: Path, endpoint: str) -> None:
    make_site(tmp_path)
    received: set[str] = set()
    with (
        session(tmp_path, "recorder:recorder", listen=endpoint) as recorder,
        session(tmp_path, "station:c1", connect=endpoint, asks_itself=False) as forger,
    ):
        recorder.subscribe("gyrofleet/**", lambda key, _payload: received.add(key))
        time.sleep(0.3)
        for _ in range(200):
            forger.publish(OTHER, b"0")
        for _ in range(200):
            forger.publish(KEY, b"0")
        _wait_for(lambda: KEY in received)
        time.sleep(0.2)
        assert received == {KEY}


def _send_until(bus: ZenohBus, number: int, is_done: Callable[[], bool]) -> None:
    until = time.monotonic() + 20.0
    while not is_done():
        assert time.monotonic() < until, "nothing arrives"
        bus.publish(KEY, str(number).encode())
        time.sleep(0.01)


def _wait_for(is_done: Callable[[], bool]) -> None:
    until = time.monotonic() + 20.0
    while not is_done() and time.monotonic() < until:
        time.sleep(0.01)
