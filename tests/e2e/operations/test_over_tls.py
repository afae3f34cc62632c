"""Commands over mutual TLS from end to end: import, replicate and run; what may not be is refused, named and logged."""

import json
import shutil
import subprocess
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import BusError
from stream.security.credentials import BusSecurity
from stream.security.rights import MissingRight
from stream.transport.zenoh_bus import ZenohBus
from stream.wire.batches import encode_batch
from tests.e2e.conftest import Bench, finish
from tests.secured_sites import credentials, make_site, session
from tests.storage.recording.test_forgeries import BATCH

Spawn = Callable[..., subprocess.Popen[str]]
RECORDER = ("--security", "site/recorder/recorder")


@pytest.fixture
def site(tmp_path: Path) -> Path:
    make_site(tmp_path / "site")
    make_site(tmp_path / "foreign")
    return tmp_path / "site"


def count(folder: Path) -> int:
    with Catalog(Store.open(folder)) as catalog:
        return int(catalog.rows("select count(*) from samples")[0][0])


def connected(site: Path, who: str, endpoint: str) -> ZenohBus:
    """A session, as soon as somebody listens."""
    until = time.monotonic() + 60.0
    while True:
        try:
            return ZenohBus(connect=[endpoint], security=BusSecurity(credentials(site, who)))
        except BusError:
            assert time.monotonic() < until
            time.sleep(0.05)


def test_an_import_lets_those_of_the_site_read_and_nobody_write(
    site: Path, tmp_path: Path, spawn: Spawn, gyrofleet: Callable[..., Any], endpoint: str
) -> None:
    n = 2_000_000
    table = pa.table({"time[s]": np.arange(n) / 1000.0, "rate[deg/s]": np.sin(np.arange(n))})
    pq.write_table(table, tmp_path / "a.parquet")
    words = ("import", "a.parquet", "--unit", "U1", "--run", "r1", "--store", "S", "--listen", endpoint)
    refused = gyrofleet(*words, "--security", "site/station/c1")
    assert refused.code == 1
    assert "station c1 may not listen" in refused.err
    assert not (tmp_path / "S").exists()
    process = spawn(*words, *RECORDER)
    seen: list[str] = []
    with connected(site, "estimator:e1", endpoint) as reader, connected(site, "recorder:recorder", endpoint) as forger:
        reader.subscribe("gyrofleet/**", lambda key, _payload: seen.append(key))
        forger._is_trusted = True  # it tries what it may not
        forger.publish("gyrofleet/plant/c1/U2/rate", encode_batch(BATCH))
        for security in (BusSecurity(is_insecure=True), BusSecurity(credentials(tmp_path / "foreign", "estimator:e1"))):
            with pytest.raises(BusError, match="cannot connect"):
                ZenohBus(connect=[endpoint], security=security)
        _, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
    assert "gyrofleet/local/files/U1/rate" in seen
    with Catalog(Store.open(tmp_path / "S")) as catalog:
        assert catalog.rows("select unit, count(*)::int from samples group by all") == [("U1", n)]


@pytest.mark.long
def test_a_plant_is_replicated_to_the_fleets_certificate_alone(
    site: Path, tmp_path: Path, spawn: Spawn, gyrofleet: Callable[..., Any], endpoint: str
) -> None:
    (tmp_path / "a.csv").write_text("time[s],rate[deg/s]\n" + "".join(f"{i / 10},{i % 3}\n" for i in range(500)))
    assert gyrofleet("import", "a.csv", "--unit", "U1", "--run", "r1", "--store", "S").code == 0
    station = gyrofleet("replicate", "--serve", "--store", "S", "--listen", endpoint, "--security", "site/station/c1")
    assert station.code == 1
    assert "this command needs a certificate of role fleet or recorder" in station.err
    server = spawn("replicate", "--serve", "--store", "S", "--plant", "hz", "--listen", endpoint, "--json", *RECORDER)
    assert server.stdout is not None
    assert json.loads(server.stdout.readline())["event"] == "serving"
    pull = ("replicate", "--from", endpoint, "--to", "F", "--json")
    refused = gyrofleet(*pull, "--security", "site/station/c1")
    assert "this command needs a certificate of role fleet or recorder" in refused.out
    foreign = gyrofleet(*pull, "--security", "foreign/fleet/head")
    assert foreign.code == 1
    assert "Both sides need valid certificates of one site; this side is fleet head" in foreign.out
    plain = gyrofleet(*pull)
    assert plain.code == 1
    assert "Does it require certificates (--security)?" in plain.out
    done = gyrofleet(*pull, "--security", "site/fleet/head")
    assert done.code == 0, (done.out, done.err)
    assert done.json["plants"][0]["segments"] > 0
    assert count(tmp_path / "F/plants/hz") == 500
    server.terminate()
    assert server.wait(timeout=30) == 0


@pytest.fixture
def secured_bench(tmp_path: Path, simulated: Callable[..., Bench], site: Path) -> Iterator[Bench]:
    """A station whose file says that its bus is secured, with its certificate beside the file."""
    bench = simulated(tmp_path / "bench", "--speed", 1000, "--rate-hz", 1)
    file = bench.folder / "station.toml"
    text = file.read_text()
    file.write_text(text.replace("[station]\n", '[station]\nsecurity = "mtls"\n', 1))
    yield bench
    finish(bench)


@pytest.mark.long
def test_a_station_sends_as_its_file_says(
    secured_bench: Bench, site: Path, tmp_path: Path, spawn: Spawn, gyrofleet: Callable[..., Any], endpoint: str
) -> None:
    recorder = spawn("record", "--store", "S", "--listen", endpoint, "--json", *RECORDER)
    assert recorder.stdout is not None
    assert json.loads(recorder.stdout.readline())["event"] == "recording"
    words = ("run", "static_bias", *secured_bench.files, "--yes", "--connect", endpoint, "--json", "--set",
             "bias_record_s=600")  # fmt: skip
    without = gyrofleet(*words)
    assert without.code == 1
    assert "security is 'mtls', and there is no" in without.out
    other = secured_bench.folder / "security"
    shutil.copytree(site / "station/c1", other)
    named = gyrofleet(*words)
    name = _name_of(secured_bench)
    assert named.code == 1
    assert f"station c1 may not publish gyrofleet/simulated/{name}/event" in named.out + named.err
    shutil.rmtree(other)
    added = gyrofleet("site", "add-station", "site", name)
    assert added.code == 0, added.err
    recorder.terminate()  # it reads the access list when it begins
    assert recorder.wait(timeout=60) == 0
    recorder = spawn("record", "--store", "S", "--listen", endpoint, "--json", *RECORDER)
    assert recorder.stdout is not None
    assert json.loads(recorder.stdout.readline())["event"] == "recording"
    shutil.copytree(site / "station" / name, other)
    done = gyrofleet(*words)
    assert done.code == 0, (done.out, done.err)
    recorder.terminate()
    assert recorder.wait(timeout=60) == 0
    assert count(tmp_path / "S") > 0


def _name_of(bench: Bench) -> str:
    return str(tomllib.loads((bench.folder / "station.toml").read_text())["station"]["name"])


@pytest.mark.long
def test_what_is_refused_is_named_and_logged_on_our_side(
    site: Path, tmp_path: Path, spawn: Spawn, endpoint: str
) -> None:
    """Where Zenoh drops, the sender names the right; what passes a link and is refused, the recorder logs at once."""
    recorder = spawn("record", "--store", "S", "--listen", endpoint, "--log-format", "json", *RECORDER)
    assert recorder.stderr is not None
    lines = (json.loads(line) for line in recorder.stderr)
    assert next(each for each in lines if each["event"] == "recording")["level"] == "info"
    with session(site, "station:c1", connect=endpoint) as station:
        with pytest.raises(MissingRight, match="station c1 may not publish gyrofleet/plant/c2/U2/rate"):
            station.publish("gyrofleet/plant/c2/U2/rate", encode_batch(BATCH))
        station.publish("gyrofleet/plant/c1/U1/rate", encode_batch(BATCH))  # its own key, without a proof
        refused = next(each for each in lines if each["event"] == "refused")
    assert refused["level"] == "warning"
    assert "gyrofleet/plant/c1/U1/rate: it has no proof of its source" in refused["text"]
    recorder.terminate()
    ended = next(each for each in lines if each["event"] == "ended")
    assert ended["rejected"] == 1
    assert recorder.wait(timeout=60) == 0
