"""The floor's page with 10,000 units: ``python -m tests.bench.serve_floor [--units 10000] [--changes 1000]``.

A source sends estimates of that many units, so many a second, to `gyrofleet record`; `gyrofleet serve` follows the log
of that recorder, and the page of the floor is open in Chromium. A unit of its own changes its verdict twice a second:
its moments in the page, after the frame is drawn, are compared with the moments of sending and of acknowledgement. Main
thread and memory are those that Chromium's DevTools protocol reports. `--replay` then lets the page take a day of such
changes, one a second, as fast as it can.
"""

import argparse
import json
import resource
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

import numpy as np

from stream.delivery.publisher import DurablePublisher
from stream.events import (
    EstimatePoint,
    EstimatePublished,
    Limit,
    LimitsApplied,
    RunStarted,
    StepStarted,
    StepWords,
    UnitMounted,
    Verdict,
    VerdictGiven,
)
from stream.identity import ACKNOWLEDGEMENT_KEY, EventKey, Place, estimate_key, event_key, parse_key
from stream.transport.zenoh_bus import ZenohBus
from stream.wire.acknowledgement import decode_acknowledgement
from stream.worker.limit_checks import estimator_key
from tests.browser import Browser
from tests.free_ports import free_endpoint

TOKEN = "bench"
PLACE, PROBE_PLACE = Place("plant", "floor"), Place("plant", "probe")
RUN, PROBE_RUN, PROBE = "floor-1", "probe-1", "PROBE"
LIMIT = Limit(characteristic="bias_stability", signal="rate", tau_s=10.0, upper=0.5, unit_of_measure="deg/h")
_TURN_S = 0.05
# times each message of the page's event stream: script, and the frame after it
HOOK = """
window.told = [];
const Plain = EventSource;
window.EventSource = class extends Plain { constructor(...given) { super(...given); window.source = this; } };
const add = EventSource.prototype.addEventListener;
EventSource.prototype.addEventListener = function (kind, take, ...others) {
  if (kind !== "change") return add.call(this, kind, take, ...others);
  return add.call(this, kind, event => {
    const begin = performance.now();
    take(event);
    const script = performance.now() - begin, found = JSON.parse(event.data);
    requestAnimationFrame(() => setTimeout(() => window.told.push({
      script, drawn: performance.timeOrigin + performance.now(), sent: found.time_ns / 1e6, bytes: event.data.length,
      states: found.states.length,
      probe: found.states.filter(state => state[0] === window.probe).map(state => state[1]),
    })));
  }, ...others);
};
"""


class Source:
    """Sends changes of the units, and of the probe; `probed` are its changes: moment of sending, of acknowledgement."""

    def __init__(self, endpoint: str, units: int, changes_per_s: float) -> None:
        self.units = [f"FOG-{number:05d}" for number in range(units)]
        self.probed: list[list[float]] = []
        self.sent = 0
        self._changes_per_s = changes_per_s
        self._bus = ZenohBus(connect=[endpoint])
        self._publisher = DurablePublisher(self._bus, resend_after_s=5.0)
        self._probe = DurablePublisher(self._bus, resend_after_s=5.0)
        self._probe_from = 0
        self._bus.subscribe(ACKNOWLEDGEMENT_KEY, self._on_acknowledgement)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._send)

    def begin(self) -> None:
        """Send what a run begins with, and wait until it is durable."""
        key, now_ns = event_key(PLACE), time.time_ns()
        self._publisher.send_event(key, RunStarted(run=RUN, t_ns=now_ns, procedure="night", operator="A. Li"))
        limits = LimitsApplied(run=RUN, t_ns=now_ns, revision="R1", limits=(LIMIT,), planned_s=36_000.0)
        self._publisher.send_event(key, limits)
        words = StepWords(step="rest", temperature_command_deg_c=25.0)
        for number, unit in enumerate(self.units):
            slot = f"{number // 100}/{number % 100}"
            mounted = UnitMounted(run=RUN, t_ns=now_ns, unit=unit, product="FOG-70", slot=slot)
            self._publisher.send_event(key, mounted)
            self._publisher.send_event(key, StepStarted(run=RUN, t_ns=now_ns, unit=unit, words=words))
        self._publisher.drain()
        probe = event_key(PROBE_PLACE)
        self._probe.send_event(probe, RunStarted(run=PROBE_RUN, t_ns=now_ns))
        self._probe.send_event(probe, UnitMounted(run=PROBE_RUN, t_ns=now_ns, unit=PROBE))
        self._probe.drain()
        self._probe_from = 2

    def start(self) -> None:
        """Begin to change units."""
        self._thread.start()

    def close(self) -> None:
        """Send no more."""
        if self._stop.is_set():
            return
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        for publisher in (self._publisher, self._probe):
            publisher.drain()
            publisher.close()
        self._bus.close()

    def _send(self) -> None:
        rng = np.random.default_rng(1)
        began, turn = time.monotonic(), 0
        while not self._stop.wait(max(0.0, began + turn * _TURN_S - time.monotonic())):
            turn += 1
            if turn % 10 == 0:
                verdict = (Verdict.PASS, Verdict.FAIL)[len(self.probed) % 2]
                self.probed.append([time.time() * 1e3, float("nan")])
                given = VerdictGiven(run=PROBE_RUN, t_ns=time.time_ns(), unit=PROBE, verdict=verdict)
                self._probe.send_event(event_key(PROBE_PLACE), given)
            due = round(turn * _TURN_S * self._changes_per_s)
            for at in rng.integers(len(self.units), size=due - self.sent):
                self._publisher.send_event(*self._estimate(self.units[at], float(rng.uniform(0.1, 0.9))))
            self.sent = due

    def _estimate(self, unit: str, value: float) -> tuple[str, EstimatePublished]:
        key = estimator_key(LIMIT)
        point = EstimatePoint(tau_s=10.0, value=value, lo=0.9 * value, hi=1.1 * value, edf=50.0, n=100)
        return estimate_key(PLACE, unit, "rate", key), EstimatePublished(
            run=RUN, t_ns=time.time_ns(), unit=unit, signal="rate", estimator=key, unit_of_measure="deg/h",
            confidence=0.95, samples=1000, missing=0, sample_interval_s=0.01, points=(point,),
        )  # fmt: skip

    def _on_acknowledgement(self, _key: str, payload: bytes) -> None:
        now_ms = time.time() * 1e3
        for position in decode_acknowledgement(payload).positions:
            key = parse_key(position.key)
            if isinstance(key, EventKey) and key.place == PROBE_PLACE:
                for each in self.probed[: max(0, position.next_seq - self._probe_from)]:
                    if each[1] != each[1]:
                        each[1] = now_ms


@contextmanager
def roles(folder: Path) -> Iterator[tuple[str, str, subprocess.Popen[str]]]:
    """A recorder and a server of its store: the recorder's endpoint, the server's URL and process."""
    program, endpoint, store = str(Path(sys.executable).with_name("gyrofleet")), free_endpoint(), folder / "store"
    commands = (
        [program, "record", "--listen", endpoint, "--store", str(store), "--json"],
        [program, "serve", "--store", str(store), "--port", "0", "--token", TOKEN, "--json"],
    )
    started: list[subprocess.Popen[str]] = []
    out = (folder / "out").open("w")
    try:
        lines = []
        for command in commands:
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=out, text=True)
            started.append(process)
            assert process.stdout is not None
            lines.append(process.stdout.readline())
            threading.Thread(target=process.stdout.read, daemon=True).start()
        yield endpoint, json.loads(lines[1])["url"], started[1]
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait()
        out.close()


def figures(browser: Browser) -> dict[str, float]:
    """Seconds of the main thread, and bytes of scripts after a collection of garbage."""
    browser.command("HeapProfiler.collectGarbage")
    found = browser.command("Performance.getMetrics")["metrics"]
    return {each["name"]: each["value"] for each in found}


def cpu_s(process: subprocess.Popen[str]) -> float:
    """CPU seconds of a process so far."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / 100


def rss_mb(process: subprocess.Popen[str]) -> float:
    """Resident memory of a process."""
    pages = int(Path(f"/proc/{process.pid}/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def measure(folder: Path, units: int, changes_per_s: float, seconds: float, days: float) -> dict[str, Any]:
    with roles(folder) as (endpoint, url, server):
        source = Source(endpoint, units, changes_per_s)
        source.begin()
        try:
            with Browser() as browser:
                browser.command("Performance.enable")
                browser.before_pages(HOOK)
                browser.open(f"{url}/login?token={TOKEN}")
                browser.open(url, width=1280)
                _until_drawn(browser, units + 1)
                rows = browser.ask("fetch('/api/floor').then(answer => answer.json())")["units"]
                probe = next(row[0] for row in rows if row[1] == PROBE)
                browser.ask(f"window.probe = {probe}")
                source.start()
                time.sleep(5.0)
                browser.ask("window.told.length = 0")
                before, cpu_before, sent_before = figures(browser), cpu_s(server), source.sent
                resident_mb = []
                for _ in range(6):
                    time.sleep(seconds / 6)
                    resident_mb.append(rss_mb(server))
                after, cpu_after, sent_after = figures(browser), cpu_s(server), source.sent
                told = browser.ask("window.told")
                probed = list(source.probed)
                found = _summary(told, probed, before, after) | {
                    "changes_per_s": (sent_after - sent_before) / seconds,
                    "server_cores": (cpu_after - cpu_before) / seconds,
                    **{f"server_mb_at_{sixth}_of_6": each for sixth, each in enumerate(resident_mb, 1)},
                }
                if days:
                    source.close()
                    found |= _replayed(browser, units, changes_per_s, days)
                return found
        finally:
            source.close()


def _until_drawn(browser: Browser, units: int) -> None:
    deadline = time.monotonic() + 60
    label = "document.querySelector('canvas')?.getAttribute('aria-label')"
    while f"{units} units" not in str(browser.ask(label)):
        assert time.monotonic() < deadline
        time.sleep(0.2)


def _summary(
    told: list[dict[str, Any]], probed: list[list[float]], before: dict[str, float], after: dict[str, float]
) -> dict[str, Any]:
    script = np.array([each["script"] for each in told])
    delivered = np.array([each["drawn"] - each["sent"] for each in told])
    seen = [(each["drawn"], code) for each in told for code in each["probe"]]
    since_sent, since_durable = [], []
    for at, (sent_ms, durable_ms) in enumerate(probed):
        drawn = next((drawn for drawn, code in seen if drawn > sent_ms and code == 1 + at % 2), None)
        if drawn is not None and durable_ms == durable_ms and drawn - sent_ms < 5000 and sent_ms > told[0]["drawn"]:
            since_sent.append(drawn - sent_ms)
            since_durable.append(drawn - durable_ms)
    busy_ms = (after["TaskDuration"] - before["TaskDuration"]) * 1e3
    return {
        "updates": len(told),
        "changes_an_update": float(np.mean([each["states"] for each in told])),
        "bytes_an_update": float(np.mean([each["bytes"] for each in told])),
        "main_thread_ms_an_update": busy_ms / len(told),
        **{
            f"of_that_{name.lower()}_ms": (after[f"{name}Duration"] - before[f"{name}Duration"]) * 1e3 / len(told)
            for name in ("Script", "Layout", "RecalcStyle")
        },
        "script_ms_median": float(np.median(script)),
        "script_ms_p95": float(np.quantile(script, 0.95)),
        "told_to_drawn_ms_median": float(np.median(delivered)),
        "told_to_drawn_ms_p95": float(np.quantile(delivered, 0.95)),
        "probes": len(since_durable),
        "acknowledged_to_drawn_ms_median": float(np.median(since_durable)),
        "acknowledged_to_drawn_ms_p95": float(np.quantile(since_durable, 0.95)),
        "sent_to_drawn_ms_median": float(np.median(since_sent)),
        "heap_mb": after["JSHeapUsedSize"] / 2**20,
        "heap_growth_mb": (after["JSHeapUsedSize"] - before["JSHeapUsedSize"]) / 2**20,
        "nodes": after["Nodes"],
        "node_growth": after["Nodes"] - before["Nodes"],
    }


REPLAY = """(async () => {
  const {numbers, updates, changes} = %s, random = count => Math.floor(Math.random() * count);
  for (let at = 0; at < updates; at++) {
    const states = Array.from({length: changes}, () =>
      [numbers[random(numbers.length)], random(4), 0, random(2), 0, random(36000), Math.random(), 1.8e9 + at]);
    const data = JSON.stringify({version: 1e6 + at, time_ns: 1.8e18 + at * 1e9, steps: {}, runs: [], units: [], states,
      gone: []});
    window.source.dispatchEvent(new MessageEvent("change", {data}));
    if (at %% 20 === 0) await new Promise(resolve => setTimeout(resolve));
    window.told.length = 0;
  }
  return performance.now();
})()"""


def _replayed(browser: Browser, units: int, changes_per_s: float, days: float) -> dict[str, float]:
    """Memory of the page before, and at each sixth of the changes of some days."""
    rows = browser.ask("fetch('/api/floor').then(answer => answer.json())")["units"]
    pieces = 6 * 40  # each shorter than the browser's patience
    updates = round(days * 86_400 / pieces)
    content = {"numbers": [row[0] for row in rows], "updates": updates, "changes": round(changes_per_s)}
    began_s = time.monotonic()
    heaps = [figures(browser)]
    for piece in range(pieces):
        browser.ask(REPLAY % json.dumps(content))
        if (piece + 1) % 40 == 0:
            heaps.append(figures(browser))
            print(f"{piece + 1} of {pieces} pieces", file=sys.stderr, flush=True)
    return {
        "replayed_updates": updates * pieces,
        "replay_s": time.monotonic() - began_s,
        "replay_node_growth": heaps[-1]["Nodes"] - heaps[1]["Nodes"],
        "replay_listener_growth": heaps[-1]["JSEventListeners"] - heaps[1]["JSEventListeners"],
        **{f"replay_heap_mb_at_{sixth}_of_6": each["JSHeapUsedSize"] / 2**20 for sixth, each in enumerate(heaps)},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=10_000)
    parser.add_argument("--changes", type=float, default=1000.0)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--replay", type=float, default=0.0, metavar="DAYS")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="gyrofleet-floor-"))
    try:
        found = measure(folder, options.units, options.changes, options.seconds, options.replay)
    finally:
        shutil.rmtree(folder)
    if options.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        print(f"{name:36} {value:12,.3f}")


if __name__ == "__main__":
    main()
