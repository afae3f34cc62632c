"""A bus over Zenoh whose subscriptions end while messages arrive."""

import threading
import time

from stream.transport.zenoh_bus import ZenohBus


def test_a_subscription_ends_while_messages_arrive() -> None:
    """No thread of a subscription fails (which pytest reports as a warning, an error here)."""
    ended = threading.Event()
    arrived: list[str] = []
    with ZenohBus() as bus:

        def publish() -> None:
            while not ended.is_set():
                bus.publish("a/b", bytes(100))

        publishers = [threading.Thread(target=publish) for _ in range(2)]
        for each in publishers:
            each.start()
        for _ in range(150):
            bus.subscribe("a/**", lambda key, _payload: arrived.append(key))
            time.sleep(0.002)
            bus.unsubscribe("a/**")
        ended.set()
        for each in publishers:
            each.join()
    assert set(arrived) == {"a/b"}
