"""CPU of a server by kind of request: ``python -m tests.bench.serve_requests [--offer 5] [--seconds 8] [--settle 40]``.

A source offers samples of 1,000 signals to `gyrofleet record`, and `gyrofleet serve` follows. For some seconds nobody
asks; then one client asks for each kind of the viewers' requests in turn (see `serve_viewers`), of another unit each
time, as often as 50 viewers do. What a request costs is the CPU of the threads that answer, those of DuckDB included;
the threads that follow the log, and open views and metrics beforehand, are counted apart.
"""

import argparse
import json
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import httpx

from tests.bench.durable_rate import free_endpoint, line, role
from tests.bench.serve_viewers import BATCH, SIGNALS, TOKEN, VISITS

_EVERY_S = 0.4
_ALL = "all in turn"
_APART = ("floor", "warming", "metrics")  # threads of the server that answer nobody
_SERVER = "--server"


class Meter:
    """CPU seconds of a server that was started with `server`: of the threads `_APART`, and of the others."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process
        self._before: dict[str, float] = {}
        self._since_s = 0.0

    def cores(self) -> dict[str, float]:
        """Cores since the last call."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        now, now_s = json.loads(line(self._process)), time.monotonic()
        found = {name: (now[name] - self._before.get(name, 0.0)) / (now_s - self._since_s) for name in now}
        self._before, self._since_s = now, now_s
        return found


def server(arguments: list[str]) -> None:
    """`gyrofleet serve`; for every line on standard input it prints its CPU by thread."""
    from gyrofleet import front_door

    def tell() -> None:
        for _ in sys.stdin:
            whole_s, apart = time.process_time(), dict.fromkeys(_APART, 0.0)
            for thread in threading.enumerate():
                if thread.name in apart:
                    stat = Path(f"/proc/self/task/{thread.native_id}/schedstat").read_text()
                    apart[thread.name] = int(stat.split()[0]) / 1e9
            print(json.dumps(apart | {"answers": whole_s - sum(apart.values())}), flush=True)

    threading.Thread(target=tell, daemon=True).start()
    sys.argv = ["gyrofleet", "serve", *arguments]
    front_door()


def asked(client: httpx.Client, meter: Meter, paths: list[str], seconds: float) -> dict[str, Any]:
    """Ask for the paths in turn for so long; the server's cores and the times of the answers."""
    rng = random.Random(len(paths))
    meter.cores()
    began_s, took_ms = time.monotonic(), list[float]()
    while (due_s := len(took_ms) * _EVERY_S) < seconds:
        time.sleep(max(0.0, began_s + due_s - time.monotonic()))
        if time.monotonic() - began_s > 2 * seconds:
            break
        url = paths[len(took_ms) % len(paths)].format(unit=f"U{rng.randrange(SIGNALS)}")
        begin_s = time.perf_counter()
        client.get(url).raise_for_status()
        took_ms.append((time.perf_counter() - begin_s) * 1e3)
    cores, wall_s = meter.cores(), time.monotonic() - began_s
    cpu_ms = cores["answers"] * wall_s / len(took_ms) * 1e3
    return {"requests": len(took_ms), "cpu_ms": cpu_ms, "ms": statistics.median(took_ms), "cores": cores}


def measured(
    url: str, meter: Meter, seconds: float, kinds: dict[str, list[str]], settle_s: float = 0.0
) -> dict[str, Any]:
    """Cores while nobody asks, and of each kind of request cores and CPU for one."""
    headers = {"Authorization": f"Bearer {TOKEN}", "Accept": "text/html, application/json;q=0.9"}
    with httpx.Client(base_url=url, headers=headers, timeout=30.0) as client:
        for path, *_ in kinds.values():  # once before, so that no first time counts
            while client.get(path.format(unit=f"U{SIGNALS - 1}")).status_code == 404:  # it has not begun to send
                time.sleep(0.5)
        time.sleep(settle_s)
        found = {name: asked(client, meter, paths, seconds) for name, paths in kinds.items()}
    time.sleep(12.0)  # the views are no longer wanted
    meter.cores()
    time.sleep(seconds)
    return {"nobody": meter.cores(), "kinds": found}


def run(folder: Path, seconds: float, offer_per_s: float, only: list[str], settle_s: float) -> dict[str, Any]:
    """Recorder, source and server; the server's CPU."""
    endpoint, store = free_endpoint(), folder / "store"
    program = str(Path(sys.executable).with_name("gyrofleet"))
    recorder = subprocess.Popen(
        [program, "record", "--listen", endpoint, "--store", str(store), "--json"], stdout=subprocess.PIPE, text=True
    )
    line(recorder)
    own = [sys.executable, "-m", "tests.bench.serve_requests", _SERVER]
    command = [*own, "--store", str(store), "--port", "0", "--token", TOKEN, "--json"]
    serving = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    url = json.loads(line(serving))["url"]
    kinds = {name: [path] for name, path in VISITS if not only or name in only}
    kinds[_ALL] = [path for path, *_ in kinds.values()]
    lasts_s = 35.0 + settle_s + seconds * (len(kinds) + 1)
    sending = role("source", endpoint, BATCH, SIGNALS, lasts_s, offer_per_s)
    try:
        return measured(url, Meter(serving), seconds, kinds, settle_s)
    finally:
        for each in (sending, serving, recorder):
            each.send_signal(signal.SIGTERM)
            each.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--offer", type=float, default=5.0, help="million samples a second")
    parser.add_argument("--seconds", type=float, default=8.0, help="of each kind of request")
    parser.add_argument("--settle", type=float, default=0.0, help="seconds that are sent before the first is asked for")
    parser.add_argument("--only", nargs="*", default=[], help="kinds of requests, as: unit allan")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="gyrofleet-requests-"))
    try:
        found = run(folder, options.seconds, options.offer * 1e6, options.only, options.settle)
    finally:
        shutil.rmtree(folder)
    if options.json:
        print(json.dumps(found))
        return
    print(f"{'nobody asks':60} {_text(found['nobody'])}")
    for name, of in found["kinds"].items():
        print(f"{name:20} {of['cpu_ms']:6.0f} ms of CPU, {of['ms']:6.0f} ms (median) {'':5} {_text(of['cores'])}")


def _text(cores: dict[str, float]) -> str:
    return "cores: " + ", ".join(f"{name} {each:.2f}" for name, each in cores.items())


if __name__ == "__main__":
    if sys.argv[1:2] == [_SERVER]:
        server(sys.argv[2:])
    else:
        main()
