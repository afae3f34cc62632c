"""Durable throughput on a secured bus beside one without security: mutual TLS, access control, proofs of the source.

    .venv/bin/python -m tests.bench.secure_rate [--batch 1000] [--signals 200] [--seconds 5] [--rounds 3] [--json]

A source process sends counts as fast as a `gyrofleet record` process acknowledges them as durable, in turn without and
with security, so that both have the same machine; the ratio is that of the medians.
"""

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from stream.security.certificate_authority import Site
from stream.security.credentials import VARIABLE
from stream.security.rights import Role
from tests.bench.durable_rate import ended, free_endpoint, line, role

STATION = "bench"  # as the source of durable_rate.py names it


def measured(folder: Path, arguments: argparse.Namespace, site: Path | None) -> dict[str, float]:
    """One run: the rate of samples acknowledged, and CPU seconds a million samples of both processes."""
    endpoint, store = free_endpoint(), folder / "store"
    secured = [] if site is None else ["--security", str(site / "recorder/recorder")]
    program = str(Path(sys.executable).with_name("gyrofleet"))
    command = [program, "record", "--listen", endpoint, "--store", str(store), "--json", "--no-lake", *secured]
    recorder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        line(recorder)
        os.environ.pop(VARIABLE, None)
        if site is not None:
            os.environ[VARIABLE] = str(site / "station" / STATION)
        sending = role("source", endpoint, arguments.batch, arguments.signals, arguments.seconds, 0.0)
        sent = json.loads(line(sending))
        _, source_cpu_s = ended(sending)
        recorder.send_signal(signal.SIGINT)
        assert recorder.stdout is not None
        done = json.loads(recorder.stdout.read().splitlines()[-1])
        _, recorder_cpu_s = ended(recorder)
    finally:
        os.environ.pop(VARIABLE, None)
        if recorder.poll() is None:
            recorder.kill()
    assert (done["samples"], done["rejected"]) == (sent["samples"], 0), (done, sent)
    log_bytes = sum(path.stat().st_size for path in (store / "log").glob("*.mcap"))
    millions = sent["samples"] / 1e6
    return {
        "samples_per_s": sent["samples"] / sent["seconds"],
        "source_cpu_s_per_million": source_cpu_s / millions,
        "recorder_cpu_s_per_million": recorder_cpu_s / millions,
        "bytes_per_sample": log_bytes / sent["samples"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batch", type=int, default=1000)
    parser.add_argument("--signals", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    found: dict[str, list[dict[str, float]]] = {"plain": [], "secured": []}
    with tempfile.TemporaryDirectory() as folder:
        site = Site.create(Path(folder) / "site")
        site.add(Role.RECORDER, "recorder", days=1.0)
        site.add(Role.STATION, STATION, days=1.0)
        for turn in range(arguments.rounds):
            for name, of_site in (("plain", None), ("secured", site.folder)):
                with tempfile.TemporaryDirectory(dir=folder) as inner:
                    found[name].append(measured(Path(inner), arguments, of_site))
                print(f"round {turn + 1}, {name}: {found[name][-1]['samples_per_s'] / 1e6:.2f} M/s", file=sys.stderr)
    medians = {
        name: {each: statistics.median(row[each] for row in rows) for each in rows[0]} for name, rows in found.items()
    }
    ratio = medians["secured"]["samples_per_s"] / medians["plain"]["samples_per_s"]
    if arguments.json:
        print(json.dumps({"ratio": ratio, **medians}))
        return
    for name, row in medians.items():
        print(
            f"{name}: {row['samples_per_s'] / 1e6:.2f} M samples/s durable; CPU seconds a million samples: source "
            f"{row['source_cpu_s_per_million']:.3f}, recorder {row['recorder_cpu_s_per_million']:.3f}; "
            f"{row['bytes_per_sample']:.3f} bytes a sample in the log"
        )
    print(f"with security {ratio:.0%} of without, {arguments.batch} samples a batch")


if __name__ == "__main__":
    main()
