"""Durable end to end: source process -> Zenoh -> recorder process, with live estimates of every signal.

    .venv/bin/python tests/bench/durable_rate.py [--batch 1000] [--signals 1000] [--seconds 15] [--no-spectrum]
        [--no-estimates] [--json]

A source sends counts like those of a fibre-optic gyro (Gaussian, standard deviation 50 counts, entropy 0.96 bytes) as
fast as they are taken. `gyrofleet record` writes them, with fdatasync and acknowledgement every 100 ms. A third process
keeps all default estimators of every signal, Allan deviation and bias stability among them. The rate counts from the
first sample sent to the last one both acknowledged as durable and estimated from. Beside it, in turn, runs a peer that
promises nothing: a plain Zenoh publisher, and a subscriber that hands every message to the MCAP library's writer.
"""

import argparse
import atexit
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from uuid import uuid4

import numpy as np

POOL = 8192  # more than a chunk has, so that no batch comes twice in one
HERE = Path(__file__).resolve()


def source(endpoint: str, batch: int, signals: int, seconds: float, offer_per_s: float, *, plain: bool) -> None:
    """Send for so long, at most so many samples a second; prints how much and how fast."""
    from stream.batch import SampleBatch
    from stream.delivery.publisher import DurablePublisher
    from stream.identity import Place, sample_key
    from stream.transport.zenoh_bus import ZenohBus
    from stream.wire.batches import encode_batch

    rng = np.random.default_rng(1)
    pool = np.round(rng.normal(0, 50, (max(64, POOL * 1000 // batch // 8), batch))).astype(np.int32)
    keys = [sample_key(Place("plant", "bench"), f"U{i}", "rate") for i in range(signals)]
    units = [f"U{i}" for i in range(signals)]
    epoch, seq, turn = uuid4(), 0, 0
    batch_s = batch / offer_per_s if offer_per_s else 0.0
    with ZenohBus(connect=[endpoint]) as bus, DurablePublisher(bus) as publisher:
        time.sleep(1.0)
        began = time.perf_counter()
        while time.perf_counter() - began < seconds:
            for unit, key in zip(units, keys, strict=True):
                counts = pool[turn % len(pool)]
                turn += 1
                if batch_s and turn % 16 == 0:
                    time.sleep(max(0.0, began + turn * batch_s - time.perf_counter()))
                made = SampleBatch(
                    unit, "rate", "r1", epoch, seq, seq * 5_000_000, 5_000_000, "deg/s", counts=counts, scale=0.01
                )
                if plain:
                    bus.publish(key, encode_batch(made))
                else:
                    publisher.send_batch(key, made)
            seq += batch
        if not plain:
            publisher.drain()
        took = time.perf_counter() - began
        print(json.dumps({"samples": seq * signals, "seconds": took, "at": time.time(), "cpu_s": time.process_time()}))
        sys.stdout.flush()
        if plain:
            time.sleep(5.0)


def estimator(endpoint: str, store: str, *, spectrum: bool) -> None:
    """Keep the estimators of every signal; for every line on standard input, say when that many samples were seen."""
    from storage.log.tail import LogTail
    from storage.store import Store
    from stream.delivery.publisher import DurablePublisher
    from stream.transport.zenoh_bus import ZenohBus
    from stream.worker.worker import EstimationWorker

    with ZenohBus(connect=[endpoint]) as bus, DurablePublisher(bus) as publisher:
        worker = EstimationWorker(
            bus, publisher, every_s=600.0, log=LogTail(Store.open(Path(store))), spectrum=spectrum
        )
        print("ready", flush=True)
        wanted = int(sys.stdin.readline())
        while worker.counts.samples < wanted and worker.failure is None:
            time.sleep(0.02)
        counts = worker.counts
        reported = {"at": time.time(), "samples": counts.samples, "recalled": counts.recalled, "lost": counts.lost}
        print(json.dumps(reported | {"cpu_s": time.process_time()}), flush=True)
        worker.kill()


def peer(endpoint: str, path: str) -> None:
    """Record as one does by hand: every message to the library's writer as it comes."""
    import zenoh
    from mcap.writer import CompressionType, Writer

    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with Path(path).open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start("peer", "peer")
        channels: dict[str, int] = {}
        seen = [0, 0.0]

        def on(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr)
            channel = channels.get(key)
            if channel is None:
                channel = channels[key] = writer.register_channel(key, "protobuf", 0)
            now = time.time_ns()
            writer.add_message(channel, now, sample.payload.to_bytes(), now)
            seen[0] += 1
            seen[1] = time.time()

        session = zenoh.open(config)
        subscriber = session.declare_subscriber("gyrofleet/**", on)
        print("ready", flush=True)
        sys.stdin.readline()
        subscriber.undeclare()  # type: ignore[no-untyped-call]
        writer.finish()  # type: ignore[no-untyped-call]
        print(json.dumps({"messages": seen[0], "at": seen[1], "cpu_s": time.process_time()}), flush=True)
        session.close()  # type: ignore[no-untyped-call]


def role(*arguments: object) -> subprocess.Popen[str]:
    """One of the roles above as a process of its own."""
    command = [sys.executable, str(HERE), "--role", *(str(each) for each in arguments)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    atexit.register(process.kill)
    return process


def line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    read = process.stdout.readline()
    if not read:
        raise SystemExit(f"{process.args!r} ended with {process.wait()} before it said anything")
    return read


def say(process: subprocess.Popen[str], text: object) -> None:
    assert process.stdin is not None
    process.stdin.write(f"{text}\n")
    process.stdin.flush()


def ended(process: subprocess.Popen[str]) -> tuple[float, float]:
    """Peak memory in MB and CPU seconds of a process that has ended."""
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
    return usage.ru_maxrss / 1024, usage.ru_utime + usage.ru_stime


def free_endpoint() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


def ours(
    folder: Path,
    batch: int,
    signals: int,
    seconds: float,
    offer: float,
    *,
    with_lake: bool,
    spectrum: bool,
    estimates: bool = True,
) -> dict[str, float]:
    """One run of the whole path."""
    endpoint, store = free_endpoint(), folder / "store"
    program = str(Path(sys.executable).with_name("gyrofleet"))
    command = [program, "record", "--listen", endpoint, "--store", str(store), "--json"]
    recorder = subprocess.Popen(
        command + ([] if with_lake else ["--no-lake"]), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    atexit.register(recorder.kill)
    line(recorder)
    worker = role("estimator", endpoint, store, "spectrum" if spectrum else "") if estimates else None
    if worker is not None:
        line(worker)
    sending = role("source", endpoint, batch, signals, seconds, offer)
    sent = json.loads(line(sending))
    seen = {"samples": sent["samples"], "at": sent["at"], "recalled": 0}
    if worker is not None:
        say(worker, sent["samples"])
        seen = json.loads(line(worker))
    source_mb, source_cpu = ended(sending)
    worker_mb, worker_cpu = (0.0, 0.0) if worker is None else ended(worker)
    recorder.send_signal(signal.SIGINT)
    done = json.loads(recorder.stdout.read().splitlines()[-1]) if recorder.stdout else {}
    recorder_mb, recorder_cpu = ended(recorder)
    assert done["samples"] == sent["samples"] == seen["samples"], (done, sent, seen)
    began = sent["at"] - sent["seconds"]
    log_bytes = sum(path.stat().st_size for path in (store / "log").glob("*.mcap"))
    whole = max(sent["at"], seen["at"]) - began
    return {
        "samples_per_s": sent["samples"] / whole,
        "durable_samples_per_s": sent["samples"] / sent["seconds"],
        "samples": sent["samples"],
        "behind_s": max(0.0, seen["at"] - sent["at"]),
        "recalled_share": seen["recalled"] / sent["samples"],
        "bytes_per_sample": log_bytes / sent["samples"],
        "source_mb": source_mb,
        "recorder_mb": recorder_mb,
        "estimator_mb": worker_mb,
        "source_cpu_share": source_cpu / whole,
        "recorder_cpu_share": recorder_cpu / whole,
        "estimator_cpu_share": worker_cpu / whole,
    }


def theirs(folder: Path, batch: int, signals: int, seconds: float, offer: float) -> dict[str, float]:
    """One run of the peer."""
    endpoint, path = free_endpoint(), folder / "peer.mcap"
    recorder = role("peer", endpoint, path)
    line(recorder)
    sending = role("plain", endpoint, batch, signals, seconds, offer)
    sent = json.loads(line(sending))
    ended(sending)
    say(recorder, "end")
    seen = json.loads(line(recorder))
    peak_mb, _ = ended(recorder)
    messages = sent["samples"] // batch
    whole = max(sent["at"], seen["at"]) - sent["at"] + sent["seconds"]
    return {
        "samples_per_s": seen["messages"] * batch / whole,
        "lost_share": 1 - seen["messages"] / messages,
        "recorder_mb": peak_mb,
        "bytes_per_sample": path.stat().st_size / max(1, seen["messages"] * batch),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batch", type=int, default=1000)
    parser.add_argument("--signals", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--offer", type=float, default=0.0, help="most million samples a second that are sent")
    parser.add_argument("--with-lake", action="store_true", help="the recorder makes the lake as well, meanwhile")
    parser.add_argument("--no-spectrum", action="store_true", help="Allan deviation and bias stability only")
    parser.add_argument("--no-estimates", action="store_true", help="a source and a recorder only")
    parser.add_argument("--no-peer", action="store_true")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--role", nargs="+", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    match arguments.role:
        case ["source" | "plain" as how, endpoint, batch, signals, seconds, offer]:
            source(endpoint, int(batch), int(signals), float(seconds), float(offer), plain=how == "plain")
        case ["estimator", endpoint, store, spectrum]:
            estimator(endpoint, store, spectrum=bool(spectrum))
        case ["peer", endpoint, path]:
            peer(endpoint, path)
        case _:
            with tempfile.TemporaryDirectory() as folder:
                shape = (arguments.batch, arguments.signals, arguments.seconds, arguments.offer * 1e6)
                found = ours(
                    Path(folder), *shape, with_lake=arguments.with_lake, spectrum=not arguments.no_spectrum,
                    estimates=not arguments.no_estimates,
                )  # fmt: skip
                beside = None if arguments.no_peer else theirs(Path(folder), *shape)
            tell(arguments, found, beside)


def tell(arguments: argparse.Namespace, found: dict[str, float], beside: dict[str, float] | None) -> None:
    if arguments.json:
        print(json.dumps({"gyrofleet": found, "peer": beside}))
        return
    print(f"{arguments.signals} signals, {arguments.batch} samples a batch, {found['samples'] / 1e6:.0f} M samples")
    print(
        f"durable, acknowledged and estimated: {found['samples_per_s'] / 1e6:.2f} M samples/s "
        f"(acknowledged alone {found['durable_samples_per_s'] / 1e6:.2f}; "
        f"the estimates {found['behind_s']:.2f} s behind it)"
    )
    print(
        f"memory: source {found['source_mb']:.0f}, recorder {found['recorder_mb']:.0f}, estimator "
        f"{found['estimator_mb']:.0f} MB; cores: {found['source_cpu_share']:.2f}, {found['recorder_cpu_share']:.2f}, "
        f"{found['estimator_cpu_share']:.2f}; log {found['bytes_per_sample']:.3f} bytes a sample; "
        f"{found['recalled_share']:.1%} of the samples read again in the log"
    )
    if beside is None:
        return
    ratio = found["samples_per_s"] / beside["samples_per_s"]
    print(
        f"{ratio:.2f} times the peer (plain Zenoh, the MCAP library's writer, no acknowledgement, no estimates): "
        f"{beside['samples_per_s'] / 1e6:.2f} M samples/s, {beside['lost_share']:.1%} lost, "
        f"{beside['recorder_mb']:.0f} MB, {beside['bytes_per_sample']:.3f} bytes a sample"
    )


if __name__ == "__main__":
    main()
