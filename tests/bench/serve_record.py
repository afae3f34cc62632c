"""Pages over large records: ``python -m tests.bench.serve_record fleet|month``.

`fleet` makes a store of 1e9 samples of 1,000 units and opens pages in Chromium: the time until the first paint of what
was asked for, until its picture is drawn, and all bytes over the wire, in a server that has just started and in one
that has answered before. `month` makes a month of one signal at 1 kHz (2.6e9 samples) with spikes of a single sample,
asks for stretches of many widths, and zooms in the page by a key: the time until the new curve is drawn. It looks for
each spike in the answers and in the pixels of the page.
"""

import argparse
import http.client
import json
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import numpy as np

from storage.lake.builder import builder_lock
from storage.lake.channel_buffer import ChannelBuffer
from storage.lake.segment_content import channel_id
from storage.store import Store
from stream.batch import SampleBatch
from stream.events import AnyDocument, PowerOn, RunEnded, RunStarted
from stream.identity import sample_key
from stream.wire.batches import encode_batch, read_raw_batch
from tests.analytics.serve.test_in_browser import PIXELS
from tests.bench.fleet_lake import DAY_NS, PLACE, SECOND_NS, START_NS, epoch_of, put_part, write_raw_day
from tests.bench.page_paint import HOOK, Wire, opened
from tests.browser import Browser

TOKEN = "bench"
UNIT, RUN = "FOG-1", "month"
RATE_HZ, SIZE = 1000, 10_000
SPIKE_COUNTS = 5000  # a hundred times the standard deviation of the noise
WIDTHS_S = (30 * 86_400, 7 * 86_400, 86_400, 6 * 3600, 3600, 900, 60, 10, 1, 0.1)
ZOOM = """(async () => {
  const plot = document.querySelector('#signal-plot .plot'), begin = performance.now();
  const drawn = new Promise(done => new MutationObserver((_, own) => {
    own.disconnect();
    requestAnimationFrame(() => setTimeout(() => done(performance.now() - begin)));
  }).observe(plot, {attributes: true}));
  plot.dispatchEvent(new KeyboardEvent('keydown', {key: '%s'}));
  return await drawn;
})()"""


def write_month(folder: Path, days: int) -> list[int]:
    """A store of a month in which a unit stands still, a part a day; the times of its spikes."""
    store, rng = Store.create(folder), np.random.default_rng(3)
    dt_ns, epoch = SECOND_NS // RATE_HZ, epoch_of(RUN, 1)
    n = 86_400 * RATE_HZ
    pool = np.round(rng.normal(0, 50.0, (997, SIZE))).astype(np.int32)
    spikes = [day * n + int(rng.integers(n)) for day in range(days)]
    with builder_lock(store):
        for day in range(days):
            found: ChannelBuffer | None = None
            for first in range(day * n, (day + 1) * n, SIZE):
                counts = pool[int(rng.integers(len(pool)))] + int(20 * np.sin(first / n))
                if first <= spikes[day] < first + SIZE:
                    counts[spikes[day] - first] += SPIKE_COUNTS
                t0_ns = START_NS + first * dt_ns
                batch = SampleBatch(UNIT, "rate", RUN, epoch, first, t0_ns, dt_ns, "deg/h", counts=counts, scale=1e-3)
                if found is None:
                    found = ChannelBuffer(channel_id(sample_key(PLACE, UNIT, "rate"), batch), PLACE, batch)
                found.add(read_raw_batch(encode_batch(batch)), batch.last_ns + 10**6)
            documents: list[AnyDocument] = []
            if day == 0:
                documents.append(RunStarted(run=RUN, t_ns=START_NS, units=(UNIT,)))
                documents.append(PowerOn(run=RUN, t_ns=START_NS, unit=UNIT, epoch=str(epoch)))
            if day == days - 1:
                documents.append(RunEnded(run=RUN, t_ns=START_NS + days * DAY_NS))
            assert found is not None
            put_part(store, day + 1, documents, gathered=[found])
            print(f"day {day + 1} of {days}", file=sys.stderr, flush=True)
    return [START_NS + spike * dt_ns for spike in spikes]


@contextmanager
def serving(store: Path) -> Iterator[tuple[str, float]]:
    """A server of a store: its URL, and the seconds from its start until it listens."""
    program = str(Path(sys.executable).with_name("gyrofleet"))
    begin = time.perf_counter()
    process = subprocess.Popen(
        [program, "serve", "--store", str(store), "--port", "0", "--token", TOKEN, "--json"],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        threading.Thread(target=process.stdout.read, daemon=True).start()
        yield ready["url"], time.perf_counter() - begin
    finally:
        process.terminate()
        process.wait()


def fleet(folder: Path, units: int, hours: int) -> dict[str, Any]:
    """First paint of pages over a store of many units."""
    if not (folder / "store").exists():
        write_raw_day(folder / "store", units, 100, hours)
    found: dict[str, Any] = {"samples": units * hours * 360_000, "units": units}
    pages = {
        "floor": "/", "units": "/units", "unit": "/units/FOG-00500", "run": "/runs/raw",
        "signal": "/signals/FOG-00500/raw/rate", "trends": "/trends", "diagnosis": "/diagnosis", "sql": "/sql",
        "events": "/events", "store": "/store",
    }  # fmt: skip
    with Browser() as browser:
        browser.before_pages(HOOK)
        for name, path in pages.items():
            with serving(folder / "store") as (url, ready_s), Wire(urlsplit(url).port or 0) as wire:
                near = f"http://127.0.0.1:{wire.port}"
                browser.open(f"{near}/static/gyrofleet.css")  # the browser itself is awake
                log_in(browser, near)
                for when in ("just started", "again"):
                    found[f"{name}, {when}"] = opened(browser, wire, path)
            found[f"{name}, just started"]["listens_s"] = ready_s
    return found


def log_in(browser: Browser, url: str) -> None:
    """Give the browser a session, without a page that would warm the server."""
    browser.command("Network.enable")
    answer = httpx.post(
        f"{url}/login", data={"token": TOKEN}, headers={"Sec-Fetch-Site": "same-origin"}, follow_redirects=False
    )
    ((name, value),) = answer.cookies.items()
    browser.command("Network.setCookie", name=name, value=value, url=url)


def month(folder: Path, days: int) -> dict[str, Any]:
    """Answers for stretches of many widths around spikes, and what the page shows of them."""
    known = folder / "spikes.json"
    if not known.exists():
        known.write_text(json.dumps(write_month(folder / "store", days)))
    spikes = json.loads(known.read_text())
    first_ns, stop_ns = START_NS, START_NS + days * DAY_NS
    path, rng = f"/api/signals/{UNIT}/{RUN}/rate", np.random.default_rng(4)
    found: dict[str, Any] = {"samples": days * 86_400 * RATE_HZ}
    with serving(folder / "store") as (url, _):
        connection = http.client.HTTPConnection(urlsplit(url).netloc)
        _asked(connection, f"{path}?points=1000")
        for width_s in WIDTHS_S:
            took, seen, sources = [], 0, set()
            for spike in spikes:
                width_ns = min(round(width_s * 1e9), stop_ns - first_ns)
                from_ns = max(first_ns, min(spike - round(width_ns * rng.uniform(0.1, 0.9)), stop_ns - width_ns))
                asked = f"{path}?from={from_ns}&to={from_ns + width_ns}&points={rng.integers(900, 1100)}"
                seconds, answer = _asked(connection, asked)
                took.append(seconds)
                seen += max(answer["max"]) > 0.9e-3 * SPIKE_COUNTS
                sources.add(answer["source"])
            found[f"{width_s:,.4g} s wide"] = {
                "median_ms": float(np.median(took)) * 1e3, "most_ms": max(took) * 1e3,
                "spikes_seen": f"{seen} of {len(spikes)}", "from": "+".join(sorted(sources)),
            }  # fmt: skip
        connection.close()
        found |= _drawn(url, spikes, first_ns, stop_ns)
    return found


def _asked(connection: http.client.HTTPConnection, path: str) -> tuple[float, dict[str, Any]]:
    begin = time.perf_counter()
    connection.request("GET", path, headers={"Authorization": f"Bearer {TOKEN}"})
    response = connection.getresponse()
    content = response.read()
    took = time.perf_counter() - begin
    assert response.status == 200, content
    return took, json.loads(content)


def _drawn(url: str, spikes: list[int], first_ns: int, stop_ns: int) -> dict[str, Any]:
    """Time from a key that zooms to this width until the new curve is drawn; pixels of the spike in the upper fifth."""
    found: dict[str, Any] = {}
    with Browser() as browser:
        browser.open(f"{url}/login?token={TOKEN}")
        for width_s in WIDTHS_S[1:]:
            took, pixels = [], []
            for spike in spikes[2 :: max(len(spikes) // 4, 1)]:
                half_ns = round(width_s * 1e9)  # of twice the width
                from_ns, to_ns = max(first_ns, spike - half_ns), min(stop_ns, spike + half_ns)
                browser.open(f"{url}/signals/{UNIT}/{RUN}/rate?from={from_ns}&to={to_ns}", width=1280)
                deadline = time.monotonic() + 30
                while not browser.ask("!!document.querySelector('#signal-plot canvas')"):
                    assert time.monotonic() < deadline
                    time.sleep(0.05)
                time.sleep(0.5)
                took.append(browser.ask(ZOOM % "+"))
                pixels.append(browser.ask(PIXELS))
                browser.ask(ZOOM % "-")  # what the page has shown is kept
                took.append(browser.ask(ZOOM % "-"))
                pixels.append(browser.ask(PIXELS))
            found[f"page, {width_s:,.4g} s wide"] = {
                "median_ms": float(np.median(took)), "most_ms": max(took), "least_pixels_of_the_spike": min(pixels),
            }  # fmt: skip
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mode", choices=("fleet", "month"))
    parser.add_argument("--units", type=int, default=1000)
    parser.add_argument("--hours", type=int, default=3)
    parser.add_argument("--days", type=int, default=30)
    parser.add_argument("--folder", type=Path, help="where the store is made, or has been; kept")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="gyrofleet-pages-"))
    folder.mkdir(exist_ok=True, parents=True)
    try:
        is_fleet = options.mode == "fleet"
        found = fleet(folder, options.units, options.hours) if is_fleet else month(folder, options.days)
    finally:
        if options.folder is None:
            shutil.rmtree(folder)
    if options.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        figures = value if isinstance(value, dict) else {"": value}
        shown = (
            f"{what} {each:,.4g}" if isinstance(each, float | int) else f"{what} {each}"
            for what, each in figures.items()
        )
        print(f"{name:28} {'  '.join(shown)}")


if __name__ == "__main__":
    main()
