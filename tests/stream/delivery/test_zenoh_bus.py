"""Subscriptions that end while messages arrive."""

import threading

from stream.transport.zenoh_bus import ZenohBus


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
