"""A program of one version and a recorder of another: answers about runs are refused, everything else works."""

import msgspec
import pytest

from storage.recording.client import RecorderClient
from storage.recording.knowledge import KnownRuns, KnownSignal, KnownStep
from stream.errors import StoreError
from stream.transport.zenoh_bus import ZenohBus
from stream.wire import requests


def test_fields_of_answers_change_with_their_form() -> None:
    fields = (KnownSignal._fields, KnownStep._fields, KnownRuns._fields)
    expected = (
        ("unit", "run", "signal", "unit_of_measure", "t_first_ns", "t_last_ns", "samples"),
        ("unit", "run", "uid", "words", "t_start_ns", "t_end_ns"),
        ("dated", "open", "uids", "mounted", "stated", "steps", "excluded"),
    )
    assert (requests.FORM, fields) == (2, expected)


def test_a_recorder_of_another_version_is_named(endpoint: str) -> None:
    with ZenohBus(listen=[endpoint]) as recorder, ZenohBus(connect=[endpoint]) as source:

        def answer(_key: str, payload: bytes) -> None:
            asked = msgspec.msgpack.decode(payload)
            is_hello = asked["question"]["type"] == "Hello"
            reply = {"id": asked["id"], "store": "old", "answer": "/srv/store" if is_hello else [{}, []], "error": ""}
            recorder.publish(f"gyrofleet/@reply/{asked['id']}", msgspec.msgpack.encode(reply))

        recorder.subscribe("gyrofleet/@request", answer)
        client = RecorderClient(source)
        assert client.store == "old"
        for ask in (client.runs, client.signals):
            with pytest.raises(
                StoreError, match=r"form 0, this program reads 2; install one version of gyrofleet at both"
            ):
                ask(["night"])
