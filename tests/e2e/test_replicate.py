"""The command `gyrofleet replicate`: passes, following, serving, recall, and what it refuses."""

import json
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from storage.fleet_store import FleetStore
from tests.storage.replication.plants import plant, segments_of
from tests.storage.verified_store import damage_last_chunk, fill

Command = Callable[..., Any]
Spawn = Callable[..., "subprocess.Popen[str]"]


def following(process: "subprocess.Popen[str]") -> dict[str, Any]:
    assert process.stdout is not None
    found: dict[str, Any] = json.loads(process.stdout.readline())
    return found


@pytest.mark.long
def test_a_served_plant_is_followed_and_the_status_says_so(
    tmp_path: Path, gyrofleet: Command, spawn: Spawn, endpoint: str
) -> None:
    store = plant(tmp_path / "night", 2)
    server = spawn("replicate", "--serve", "--store", "night", "--plant", "hangzhou", "--listen", endpoint, "--json")
    assert following(server) == {"event": "serving", "plants": ["hangzhou"], "listen": endpoint}
    watch = spawn("replicate", "--from", endpoint, "--to", "F", "--watch", "--json")
    assert following(watch)["added"] == 2
    fill(store, range(4, 6))
    assert following(watch)["added"] == 1
    server.kill()
    server.communicate()
    (gone,) = following(watch)["plants"]
    assert (gone["plant"], "answer" in gone["trouble"]) == ("hangzhou", True)
    watch.send_signal(signal.SIGINT)
    assert watch.wait(60) == 0
    (found,) = gyrofleet("status", "--store", "F", "--json").json["plants"]
    assert (found["plant"], found["segments"], found["segments_not_in_lake"]) == ("hangzhou", 3, 0)
    assert found["lag"] == {"segments": 0, "bytes": 0, "seconds": 0.0}
    copy = FleetStore.open(tmp_path / "F").replica("hangzhou").store
    assert segments_of(copy) == segments_of(store)
    assert "fleet store's copy of a plant" in gyrofleet("recover", "--store", copy.folder).err


def test_recall_brings_segments_back_in_both_directions(tmp_path: Path, gyrofleet: Command) -> None:
    store = plant(tmp_path / "night", 3)
    assert gyrofleet("replicate", "--from", "night", "--to", "F").code == 0
    before = segments_of(store)
    (store.log / "00000001.mcap").unlink()
    back = gyrofleet("replicate", "--recall", "--from", "F", "--to", "night", "--json")
    assert (back.code, back.json["segments"], back.json["intact"]) == (0, ["00000001.mcap"], 2)
    assert segments_of(store) == before
    damage_last_chunk(FleetStore.open(tmp_path / "F").replica("night").store.log / "00000002.mcap")
    assert gyrofleet("verify", "--store", "F").code == 1
    again = gyrofleet("replicate", "--recall", "--from", "night", "--to", "F", "--json")
    assert (again.code, again.json["added"]) == (0, 1)
    assert gyrofleet("verify", "--store", "F", "--json").json["sound"]
    whole = gyrofleet("replicate", "--recall", "--from", "F", "--to", "new", "--plant", "night")
    assert (whole.code, "3 segments of night came back" in whole.out) == (0, True)
    assert gyrofleet("verify", "--store", "new").code == 0


@pytest.mark.long
def test_what_is_refused_is_named_and_the_exit_code_is_1(tmp_path: Path, gyrofleet: Command) -> None:
    store = plant(tmp_path / "night", 3)
    damage_last_chunk(store.log / "00000002.mcap")
    found = gyrofleet("replicate", "--from", "night", "--to", "F", "--json")
    assert (found.code, found.json["added"]) == (1, 2)
    (refusal,) = found.json["plants"][0]["refused"]
    assert (refusal["plant"], refusal["kind"], refusal["segment"]) == ("night", "bad_hash", "00000002.mcap")
    assert "00000002.mcap" in gyrofleet("status", "--store", "F").err
    for words in (
        ("--from", "night"),
        ("--serve", "--from", "night"),
        ("--from", "nowhere", "--to", "F"),
        ("--from", "night", "--to", "night"),
        ("--recall", "--from", "F", "--to", "new"),
        ("--from", "night", "--to", "F", "--plant", "../x"),
        ("--from", "tcp/127.0.0.1:1", "--to", "F"),
    ):
        assert gyrofleet("replicate", *words).code == 1, words
