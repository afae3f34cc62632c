"""Viewers beside a recorder: ``python -m tests.bench.serve_viewers [--viewers 50] [--offer 5]``.

A source offers 5 million samples a second of 1,000 signals to `gyrofleet record`. In turn, without and with
`gyrofleet serve` and so many viewers: each listens to the floor, and every two seconds opens a page or asks for a
signal. A recorder that has just started loads what it needs and catches up meanwhile, and the server opens the store;
`--settle` says how long the source sends before viewers come. All of them come within two seconds; the times of the
first four seconds are reported apart as well. What is acknowledged a second with viewers is compared with that
without; the times are those of the viewers' requests.
"""

import argparse
import asyncio
import itertools
import json
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import zlib
from collections import defaultdict
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from tests.bench.durable_rate import ended, free_endpoint, line, role

TOKEN = "bench"
SIGNALS, BATCH = 1000, 1000
_EVERY_S = 2.0
_ARRIVAL_S = 4.0
_PATIENCE_S = 30.0
# where each asks in turn; of a unit of its own
VISITS = (
    ("floor", "/"), ("signal, all", "/api/signals/{unit}/r1/rate?points=1000"), ("units", "/units"),
    ("signal, 200 points", "/api/signals/{unit}/r1/rate?points=200"), ("floor API", "/api/floor"),
    ("unit", "/units/{unit}"), ("runs", "/runs"), ("store", "/store"), ("allan", "/api/allan/{unit}/r1/rate"),
)  # fmt: skip


class Connection:
    """A connection to a server, as one of a browser: answers stay packed, since 50 browsers are on other computers.

    A library for clients takes 9 ms of the processor for a request, a third of what the server does.
    """

    def __init__(self, url: str) -> None:
        split = urlsplit(url)
        self._address = split.hostname, split.port
        self._head = (
            f" HTTP/1.1\r\nHost: {split.netloc}\r\nAuthorization: Bearer {TOKEN}\r\n"
            "Accept: text/html, application/json;q=0.9\r\nAccept-Encoding: gzip\r\n\r\n"
        )
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def ask(self, path: str) -> tuple[int, dict[str, str]]:
        """Status and headers of an answer, whose body follows."""
        if self._streams is None:
            self._streams = await asyncio.open_connection(*self._address, limit=1 << 24)
        reader, writer = self._streams
        writer.write(f"GET {path}{self._head}".encode())
        first, *lines = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
        headers = {name.lower(): value for name, _, value in (text.partition(": ") for text in lines)}
        return int(first.split()[1]), headers

    async def get(self, path: str) -> tuple[int, bytes]:
        """Status and body of an answer; asked again if the server has closed the connection meanwhile."""
        try:
            code, headers = await self.ask(path)
        except (asyncio.IncompleteReadError, ConnectionError):
            self._streams = None
            code, headers = await self.ask(path)
        assert self._streams is not None
        reader = self._streams[0]
        if (size := headers.get("content-length")) is not None:
            return code, await reader.readexactly(int(size))
        return code, b"".join([part async for part in self.parts()])

    async def parts(self) -> AsyncIterator[bytes]:
        """The parts of a body of unknown length."""
        assert self._streams is not None
        reader = self._streams[0]
        while size := int(await reader.readline(), 16):
            yield await reader.readexactly(size)
            await reader.readline()
        await reader.readline()


class Viewers:
    """Clients of a server, in a thread of their own.

    `took` are seconds by kind of request, `arriving` those of the first seconds, and `settled` those after them.
    """

    def __init__(self, url: str, count: int) -> None:
        self.took: dict[str, list[float]] = defaultdict(list)
        self.arriving: list[float] = []
        self.settled: list[float] = []
        self.failed: dict[str, int] = defaultdict(int)
        self.events = 0
        self._url, self._count = url, count
        self._ends = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End."""
        self._ends.set()
        self._thread.join()

    async def _run(self) -> None:
        self._began_s = time.perf_counter()
        listening = [asyncio.create_task(self._listen()) for _ in range(self._count)]
        await asyncio.gather(*(self._visit(number) for number in range(self._count)))
        for each in listening:
            each.cancel()
        await asyncio.gather(*listening, return_exceptions=True)

    async def _listen(self) -> None:
        connection = Connection(self._url)
        _, headers = await connection.ask("/api/live")
        opened = zlib.decompressobj(31) if headers.get("content-encoding") == "gzip" else None
        last = b"\n"
        async for part in connection.parts():
            text = part if opened is None else opened.decompress(part)
            self.events += (last + text).count(b"\nevent:")
            last = (last + text)[-7:]

    async def _visit(self, number: int) -> None:
        client, rng = Connection(self._url), random.Random(number)
        await asyncio.sleep(rng.uniform(0, _EVERY_S))
        for name, path in itertools.islice(itertools.cycle(VISITS), number % len(VISITS), None):
            if self._ends.is_set():
                return
            url = path.format(unit=f"U{rng.randrange(SIGNALS)}")
            begin = time.perf_counter()
            code, body = await asyncio.wait_for(client.get(url), _PATIENCE_S)
            self.took[name].append(time.perf_counter() - begin)
            by_time = self.arriving if begin - self._began_s < _ARRIVAL_S else self.settled
            by_time.append(self.took[name][-1])
            if code != 200:
                why = "" if code == 404 else f": {body[:200]!r}"  # 404: it has not begun to send
                self.failed[f"{name} {code}{why}"] += 1
            await asyncio.sleep(max(0.0, _EVERY_S - (time.perf_counter() - begin)) * rng.uniform(0.5, 1.5))


def run(folder: Path, seconds: float, offer_per_s: float, viewers: int, settle_s: float) -> dict[str, Any]:
    """One run; its rate and the viewers' times."""
    endpoint, store = free_endpoint(), folder / "store"
    program = str(Path(sys.executable).with_name("gyrofleet"))
    recorder = subprocess.Popen(
        [program, "record", "--listen", endpoint, "--store", str(store), "--json"], stdout=subprocess.PIPE, text=True
    )
    line(recorder)
    server: subprocess.Popen[str] | None = None
    seen: Viewers | None = None
    if viewers:
        command = [program, "serve", "--store", str(store), "--port", "0", "--token", TOKEN, "--json"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        seen = Viewers(json.loads(line(server))["url"], viewers)
    own_cpu_s = 0.0
    sending = role("source", endpoint, BATCH, SIGNALS, settle_s + seconds, offer_per_s)
    if seen is not None:
        time.sleep(settle_s)
        own_cpu_s = time.process_time()
        seen.start()
    sent = json.loads(line(sending))
    if seen is not None:
        seen.stop()
        own_cpu_s = time.process_time() - own_cpu_s
    sending_cpu_s = ended(sending)[1]
    found: dict[str, Any] = {"samples": sent["samples"], "samples_per_s": sent["samples"] / sent["seconds"]}
    if server is not None and seen is not None:
        server.terminate()
        memory_mb, cpu_s = ended(server)
        found |= {
            "server_mb": memory_mb, "server_cores": cpu_s / (settle_s + seconds), "events": seen.events,
            "viewers_cores": own_cpu_s / seconds, "source_cores": sending_cpu_s / (settle_s + seconds),
            "requests": sum(map(len, seen.took.values())), "failed": {k: n for k, n in seen.failed.items() if n},
            "ms": {name: _of(times) for name, times in seen.took.items()}
            | {"all": _of(seen.arriving + seen.settled), "first 4 s": _of(seen.arriving), "after": _of(seen.settled)},
        }  # fmt: skip
    recorder.send_signal(signal.SIGINT)
    memory_mb, cpu_s = ended(recorder)
    return found | {"recorder_mb": memory_mb, "recorder_cpu_s": cpu_s}


def _of(times: list[float]) -> dict[str, float]:
    ms = np.array(times) * 1e3
    return {"n": len(ms), "median": float(np.median(ms)), "p95": float(np.quantile(ms, 0.95)), "most": float(ms.max())}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--viewers", type=int, default=50)
    parser.add_argument("--offer", type=float, default=5.0, help="million samples a second")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--settle", type=float, default=30.0, help="seconds that are sent before viewers come")
    parser.add_argument("--turns", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rates: dict[int, list[float]] = {0: [], options.viewers: []}
    last: dict[str, Any] = {}
    for _ in range(options.turns):
        for viewers in rates:
            folder = Path(tempfile.mkdtemp(prefix="gyrofleet-viewers-"))
            try:
                found = run(folder, options.seconds, options.offer * 1e6, viewers, options.settle)
            finally:
                shutil.rmtree(folder)
            rates[viewers].append(found["samples_per_s"])
            last = found if viewers else last
    ratio = float(np.mean(rates[options.viewers]) / np.mean(rates[0]))
    if options.json:
        print(json.dumps({"ratio": ratio, "rates": rates, **last}))
        return
    print(f"recorder: {ratio:.3f} of {np.mean(rates[0]) / 1e6:.2f} M samples/s without viewers; each run: {rates}")
    print(f"server: {last['server_cores']:.2f} cores, {last['server_mb']:.0f} MB; {last['events']} events of the floor")
    print(f"source: {last['source_cores']:.2f} cores, viewers: {last['viewers_cores']:.2f}")
    print(f"{last['requests']} requests, failed: {last['failed'] or 'none'}")
    for name, times in last["ms"].items():
        print(f"{name:24} {'  '.join(f'{what} {each:,.0f}' for what, each in times.items())} ms")


if __name__ == "__main__":
    main()
