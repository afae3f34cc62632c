"""An object store that takes connections and never answers: roles end soon after a signal all the same."""

import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from storage.object_lake.bucket import Bucket, Unanswered
from storage.store import writer_is_active
from stream.roles.patience import GivenUp, answered
from stream.terminal.console import until_stopped
from tests.free_ports import free_endpoint
from tests.storage.replication.plants import plant

_SOON_S = 12.0


class Silent:
    """A server that takes connections and never answers; `asked` is set once one has sent a request."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._server.getsockname()[1]}"
        self.asked = threading.Event()
        self._taken: list[socket.socket] = []
        threading.Thread(target=self._take, daemon=True).start()

    def _take(self) -> None:
        while True:
            try:
                taken, _ = self._server.accept()
            except OSError:
                return
            self._taken.append(taken)
            threading.Thread(target=self._hear, args=(taken,), daemon=True).start()

    def _hear(self, taken: socket.socket) -> None:
        if taken.recv(1):
            self.asked.set()

    def close(self) -> None:
        for each in (self._server, *self._taken):
            each.close()


@pytest.fixture
def silent(monkeypatch: pytest.MonkeyPatch) -> Iterator[Silent]:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_REGION"):
        monkeypatch.setenv(name, "x")
    server = Silent()
    yield server
    server.close()


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("replicate", "--from", "night", "--to", "s3://gyros/night", "--watch"), 0),
        (("replicate", "--from", "night", "--to", "s3://gyros/night"), 1),
        (("replicate", "--from", "s3://gyros/night", "--to", "F", "--watch"), 0),
        (("lake", "--store", "night", "--lake", "s3://gyros/lake"), 0),
        (("lake", "--store", "night", "--once", "--lake", "s3://gyros/lake"), 1),
        (("sql", "select 1", "--lake", "s3://gyros/lake"), None),
    ],
)
def test_a_role_ends_soon_where_the_store_is_silent(
    words: tuple[str, ...], code: int | None, number: signal.Signals, tmp_path: Path, silent: Silent,
    spawn: Callable[..., subprocess.Popen[str]],
) -> None:  # fmt: skip
    plant(tmp_path / "night", 1)
    process = spawn(*words, "--endpoint-url", silent.url)
    assert silent.asked.wait(60.0)
    time.sleep(0.5)
    assert process.poll() is None
    process.send_signal(number)
    began = time.monotonic()
    _, err = process.communicate(timeout=100)
    assert time.monotonic() - began < _SOON_S
    assert "Traceback" not in err, err
    if code is None:  # a command for people ends at once
        assert process.returncode == (130 if number == signal.SIGINT else -signal.SIGTERM)
        return
    assert process.returncode == code, err
    assert "no answer yet, and this process is to end" in " ".join(err.split())
    assert not writer_is_active(tmp_path / "night")


@pytest.mark.long
@pytest.mark.parametrize(("every", "code"), [((), 1), (("--every-h", "1"), 0)])
def test_a_silent_time_stamp_authority_holds_up_no_end(
    every: tuple[str, ...], code: int, tmp_path: Path, silent: Silent, spawn: Callable[..., subprocess.Popen[str]]
) -> None:
    """The attestation is kept without a stamp, and a message says so."""
    plant(tmp_path / "night", 1)
    process = spawn("attest", "--store", "night", "--key", "k.pem", "--timestamp-url", silent.url, *every)
    assert silent.asked.wait(60.0)
    process.send_signal(signal.SIGTERM)
    began = time.monotonic()
    _, err = process.communicate(timeout=100)
    assert time.monotonic() - began < _SOON_S
    assert process.returncode == code, err
    assert "attested without a time stamp: the time stamp authority" in err
    assert len(list((tmp_path / "night/attestations").glob("*.json"))) == 1


def test_a_request_that_is_answered_in_time_is_not_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stream.roles.patience._GRACE_S", 0.4)
    assert answered(lambda: 7) == 7
    with pytest.raises(ValueError, match="of the request"):
        answered(lambda: int("of the request"))
    with until_stopped() as stop:
        stop.asked_at = time.monotonic()
        forever = threading.Event()
        assert answered(lambda: forever.wait(0.2)) is False
        began = time.monotonic()
        with pytest.raises(GivenUp):
            answered(forever.wait)
        with pytest.raises(GivenUp):  # nothing more is begun
            answered(forever.set)
        assert time.monotonic() - began < 3.0
        assert not forever.is_set()
        forever.set()
    assert answered(lambda: 9) == 9


@pytest.mark.long
def test_what_went_wrong_is_called_by_its_name(silent: Silent) -> None:
    def said(endpoint: str) -> str:
        with pytest.raises(Unanswered) as caught:
            Bucket("s3://gyros/a", endpoint, timeout_s=0.5, retries=0).get("x")
        return str(caught.value)

    closed = free_endpoint().removeprefix("tcp/")
    assert "x: connection refused; check the network" in said(f"http://{closed}")
    assert "x: the name of its host is not known; check" in said("http://gyrofleet.invalid")
    assert "x: no answer in time; check" in said(silent.url)
