"""How long a recorder takes to stop after a few samples of very many signals.

    .venv/bin/python -m tests.bench.many_signals [--signals 200000] [--samples 5] [--json]

A source sends one batch of each signal to `gyrofleet record`; once all are acknowledged the recorder gets Ctrl-C. It
prints the seconds until the log is complete, and until the lake has everything as well.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from uuid import uuid4

import numpy as np

from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.identity import Place, sample_key
from stream.transport.zenoh_bus import ZenohBus

ENDPOINT = "tcp/127.0.0.1:17449"
_SIGNALS_OF_UNIT = 20


def send(signals: int, samples: int) -> None:
    """One batch of each signal, each acknowledged."""
    counts = np.arange(samples, dtype=np.int32)
    epoch = uuid4()
    with ZenohBus(connect=[ENDPOINT]) as bus, DurablePublisher(bus) as publisher:
        for at in range(signals):
            unit, name = f"U{at // _SIGNALS_OF_UNIT}", f"rate_{at % _SIGNALS_OF_UNIT}"
            batch = SampleBatch(unit, name, "r1", epoch, 0, 0, 10_000_000, "deg/s", counts=counts, scale=0.01)
            publisher.send_batch(sample_key(Place("plant", "bench"), unit, name), batch)
        publisher.drain()


def main() -> None:
    parser = argparse.ArgumentParser(description="How long a recorder of very many signals takes to stop.")
    parser.add_argument("--signals", type=int, default=200_000)
    parser.add_argument("--samples", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "store"
        command = [sys.executable, "-m", "gyrofleet", "record", "--store", str(store), "--listen", ENDPOINT]
        recorder = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert recorder.stderr is not None
        recorder.stderr.readline()
        send(asked.signals, asked.samples)
        began = time.monotonic()
        recorder.send_signal(signal.SIGINT)
        for line in recorder.stderr:
            if line.startswith("the log is complete"):
                break
        log_s = time.monotonic() - began
        recorder.stderr.read()
        _, status, usage = os.wait4(recorder.pid, 0)
        reported = {
            "signals": asked.signals,
            "samples": asked.samples,
            "log_complete_s": round(log_s, 1),
            "stopped_s": round(time.monotonic() - began, 1),
            "recorder_cpu_s": round(usage.ru_utime + usage.ru_stime, 1),
            "peak_mb": round(usage.ru_maxrss / 1024),
            "exit_status": status,
        }
    print(json.dumps(reported) if asked.json else "  ".join(f"{name} {value}" for name, value in reported.items()))


if __name__ == "__main__":
    main()
