"""The bus over Zenoh. No other file imports zenoh.

By default nothing listens and nothing is announced: no multicast scouting, no gossip, no endpoint.
A session that listens is a router, so that its clients see each other's messages. Without security the bus reaches
this computer only; with it every link is mutual TLS, and who listens admits what the site's roles may do.
"""

import json
import re
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import zenoh

from stream.bounds import MAX_MESSAGE_BYTES
from stream.closing import Closing
from stream.errors import BusError, GyrofleetError
from stream.security.credentials import BusSecurity, Credentials, process_security
from stream.security.endpoint import DEFAULT_ENDPOINT as DEFAULT_ENDPOINT
from stream.security.endpoint import check_plain_endpoint, secured_endpoint
from stream.security.rights import ACCESS_KEY, check_right, principal_of
from stream.security.zenoh_settings import access_control, tls_settings
from stream.transport.bus import Handler, call_handlers
from stream.transport.reach import why_unreachable
from stream.transport.scheduling import threads_waiting_for_turn, wait_for_turn

# Zenoh closes a transport that its other side has stalled for so long, and messages that wait there are lost without
# an error; whoever needs them requests them again. A source waits about as long as the lease (10 s), after which the
# other side has given up too: waiting longer only delays its reconnection. A router does not wait for a slow consumer,
# which blocks all others meanwhile.
_WAIT_BEFORE_CLOSE = "transport/link/tx/queue/congestion_control/block/wait_before_close"
Answerer = Callable[[str, bytes], bytes]

_QUEUED_MESSAGES = 256
_MESSAGE_ROOM_BYTES = 4 << 20  # so that a message slightly too large arrives, and is counted and reported
_PATIENCE_S = 5.0
_ACCESS_PATIENCE_S = 2.0
_SOURCE_WAITS_US = 8_000_000
# A key with a publisher travels as a number, and is looked up and admitted once where it arrives: without security 5 us
# less of both sides for each message, with it 10 us. A publisher takes half a millisecond of both, more with each that
# there is, so that few are declared at a time.
_SENT_BEFORE_PUBLISHER = 64
_MOST_PUBLISHERS = 1000
_DECLARED_EVERY_S = 0.002
_ROUTER_WAITS_US = 200_000


class ZenohBus(Closing):
    """A session on Zenoh with endpoints, such as ``tcp/127.0.0.1:7447``; without any the bus is inside the process.

    `security` is that of this process by default; `credentials` are its credentials, None on a bus without. With
    `is_embedded` sources and recorder are of this process, and whoever connects may only read. Raises a BusError if an
    endpoint cannot be listened on or reached, an InsecureBus if it must not be without security.

    >>> import time
    >>> with ZenohBus() as bus:
    ...     seen = []
    ...     bus.subscribe("gyrofleet/**", lambda key, payload: seen.append((key, payload)))
    ...     bus.publish("gyrofleet/plant/chamber-2/event", b"hello")
    ...     while not seen: time.sleep(0.001)
    >>> seen
    [('gyrofleet/plant/chamber-2/event', b'hello')]
    """

    def __init__(
        self, listen: Sequence[str] = (), connect: Sequence[str] = (), *, security: BusSecurity | None = None,
        is_embedded: bool = False,
    ) -> None:  # fmt: skip
        protection = process_security() if security is None and (listen or connect) else security or BusSecurity()
        own = protection.credentials
        for endpoint in (*listen, *connect):
            if own is None:
                is_listening = endpoint in listen
                check_plain_endpoint(endpoint, is_listening=is_listening, is_insecure=protection.is_insecure)
        if own is not None:
            listen, connect = [secured_endpoint(each) for each in listen], [secured_endpoint(each) for each in connect]
        self._own = own if listen or connect else None
        self._is_trusted = bool(listen) or is_embedded  # its own messages pass no link that would refuse them
        self.credentials: Credentials | None = None if is_embedded else self._own
        zenoh.try_init_log_from_env()  # type: ignore[no-untyped-call]
        config = zenoh.Config()
        settings: dict[str, Any] = {
            "mode": "router" if listen else ("client" if connect else "peer"),
            "listen/endpoints": list(listen),
            "connect/endpoints": list(connect),
            "connect/timeout_ms": 5000,
            # a broken connection is retried soon and for ever
            "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5},
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            # no faster than the loopback, 40 MB more, and left behind by a killed process
            "transport/shared_memory/enabled": False,
            "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES + _MESSAGE_ROOM_BYTES,
            _WAIT_BEFORE_CLOSE: _ROUTER_WAITS_US if listen else _SOURCE_WAITS_US,
        }
        if own is not None and (listen or connect):
            settings |= tls_settings(own, listens=bool(listen))
        if own is not None and listen:
            settings["access_control"] = access_control(own, is_read_only=is_embedded)
        try:
            for key, value in settings.items():
                config.insert_json5(key, json.dumps(value))
            with threads_waiting_for_turn():
                self._session = zenoh.open(config)
        except zenoh.ZError as error:
            wanted = ", ".join([*(f"listen on {e}" for e in listen), *(f"connect to {e}" for e in connect)])
            asked = "is the address right and free, and the other side running?"
            if own is not None:
                asked += f" Both sides need valid certificates of one site; {own.describe()}"
            elif connect:
                asked += " Does it require certificates (--security)?"
            why = why_unreachable(connect) or _message_of(error)
            raise BusError(f"cannot {wanted or 'open a bus'}: {why}; {asked}") from error
        self._has_publishers = bool(connect) and not listen
        self._sent: dict[str, int] = {}
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._declared_at = 0.0
        self._subscribers: dict[str, tuple[Any, threading.Thread]] = {}
        self._handlers: dict[str, list[Handler]] = {}
        self._lock = threading.Lock()
        if self._own is not None and listen:
            self.answer(ACCESS_KEY, self._answer_access)

    def why_refused(self) -> str:
        """Why the other side refuses this one, as the end of a sentence; empty if it does not, or does not answer."""
        if self._own is None or self._is_trusted:
            return ""
        try:
            found = self.ask(ACCESS_KEY, self._own.principal.common_name.encode(), _ACCESS_PATIENCE_S).all()
        except BusError as error:
            return f"; {error}"
        reasons = [content.decode(errors="replace") for _, content in found if content]
        return f"; it is refused there: {reasons[0]}" if reasons else ""

    def _answer_access(self, _key: str, payload: bytes) -> bytes:
        assert self._own is not None
        try:
            principal = principal_of(payload.decode())
        except ValueError as error:
            raise BusError(f"no common name: {error}") from error
        return (self._own.access.reason_against(principal) or "").encode()

    def _check_right(self, action: str, key: str) -> None:
        if self._own is not None and not self._is_trusted:
            check_right(self._own.principal, action, key)

    def publish(self, key: str, payload: bytes) -> None:
        """Send `payload` under `key`; waits where the bus is congested; a BusError if the session is closed."""
        publisher = self._publishers.get(key)
        try:
            if publisher is not None:  # its right was checked when it was declared
                publisher.put(payload)
                return
            self._check_right("publish", key)
            self._session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
            if self._has_publishers and len(self._publishers) < _MOST_PUBLISHERS:
                self._count(key)
        except zenoh.ZError as error:
            raise BusError(f"cannot publish {key}: {_message_of(error)}") from error

    def _count(self, key: str) -> None:
        """Declare a publisher for a key under which much is sent."""
        sent = self._sent[key] = self._sent.get(key, 0) + 1
        if sent < _SENT_BEFORE_PUBLISHER:
            return
        with self._lock:
            now = time.monotonic()
            if key not in self._publishers and now - self._declared_at >= _DECLARED_EVERY_S:
                self._declared_at = now
                self._publishers[key] = self._session.declare_publisher(
                    key, congestion_control=zenoh.CongestionControl.BLOCK
                )

    def subscribe(self, key_expression: str, handler: Handler) -> None:
        """Call `handler` with (key, payload) for every message that matches."""
        self._check_right("read", key_expression)
        with self._lock:
            handlers = self._handlers.get(key_expression)
            if handlers is not None:
                # one subscription for all handlers: the payload is copied out of Zenoh once
                handlers.append(handler)
                return
            handlers = self._handlers[key_expression] = [handler]

        # the default queue between Zenoh and Python has no bound; a full one blocks the sender
        subscriber = self._session.declare_subscriber(key_expression, zenoh.handlers.FifoChannel(_QUEUED_MESSAGES))
        # not through the subscriber: another thread may be undeclaring it, which then cannot be read
        channel = subscriber.handler

        def take() -> None:
            wait_for_turn()
            for first in channel:
                # all that is there, without waiting or switching threads in between
                sample: zenoh.Sample | None = first
                while sample is not None:
                    call_handlers(handlers, str(sample.key_expr), sample.payload.to_bytes())
                    try:
                        sample = channel.try_recv()
                    except zenoh.ZError:  # undeclared meanwhile
                        return

        thread = threading.Thread(target=take, name=f"gyrofleet-bus {key_expression}", daemon=True)
        thread.start()
        self._subscribers[key_expression] = subscriber, thread

    def unsubscribe(self, key_expression: str) -> None:
        """Call no handler of that key expression any more."""
        with self._lock:
            self._handlers.pop(key_expression, None)
            found = self._subscribers.pop(key_expression, None)
        if found is not None:
            _end(*found)

    def answer(self, key: str, answerer: Answerer) -> None:
        """Answer every request that matches a key by ``answerer(key, payload)``; its error is sent to who asks."""
        self._check_right("answer", key)
        queryable = self._session.declare_queryable(key, zenoh.handlers.FifoChannel(_QUEUED_MESSAGES))
        channel = queryable.handler

        def take() -> None:
            for query in channel:
                with query:
                    payload = b"" if query.payload is None else query.payload.to_bytes()
                    try:
                        content = answerer(key, payload)
                    except GyrofleetError as error:
                        query.reply_err(str(error))
                    except Exception as error:  # noqa: BLE001  a mistake of this answerer alone
                        query.reply_err(f"{type(error).__name__}: {error}")
                    else:
                        with suppress(zenoh.ZError):  # who asked has gone
                            query.reply(key, content)

        thread = threading.Thread(target=take, name=f"gyrofleet-answers {key}", daemon=True)
        thread.start()
        self._subscribers[f"answers {key}"] = queryable, thread

    def ask(
        self, key_expression: str, payload: bytes = b"", timeout_s: float = 10.0, *, asks_all: bool = False
    ) -> "Answers":
        """Send a request, to the nearest that answers or to all; its answers can be waited for later.

        A BusError if the session is closed.
        """
        self._check_right("query", key_expression)
        try:
            replies = self._session.get(
                key_expression, payload=payload, timeout=timeout_s, congestion_control=zenoh.CongestionControl.BLOCK,
                target=zenoh.QueryTarget.ALL if asks_all else zenoh.QueryTarget.BEST_MATCHING,
            )  # fmt: skip
            return Answers(replies)
        except zenoh.ZError as error:
            raise BusError(f"cannot ask {key_expression}: {_message_of(error)}") from error

    def close(self) -> None:
        """Leave the bus."""
        for found in list(self._subscribers.values()):
            _end(*found)
        self._session.close()  # type: ignore[no-untyped-call]


class Answers:
    """The answers to a request, waited for when they are first read."""

    def __init__(self, replies: Any) -> None:
        self._replies = replies

    def all(self) -> list[tuple[str, bytes]]:
        """Key and content of each answer; none if nobody has answered in time. A Refused if only errors came."""
        found, errors = [], []
        for reply in self._replies:
            if reply.ok is not None:
                found.append((str(reply.ok.key_expr), reply.ok.payload.to_bytes()))
            elif reply.err is not None:
                errors.append(reply.err.payload.to_string())
        if not found and errors:
            if errors[0] == "Timeout":
                return []
            raise Refused(errors[0])
        return found


class Refused(BusError):
    """The other side answers a request with an error."""


def _end(subscriber: Any, thread: threading.Thread) -> None:
    subscriber.undeclare()
    if thread is not threading.current_thread():
        thread.join(_PATIENCE_S)


def _message_of(error: Exception) -> str:
    """Zenoh's message without the places in its own source."""
    return re.sub(r"\s+at \S+\.rs:\d+\.?", "", str(error).splitlines()[0])
